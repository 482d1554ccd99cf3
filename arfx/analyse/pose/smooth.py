"""Smooths the poses of one shot with past and future, in the metric of the measurement:
Gauss-Newton on SE(3).

Axes: rotation about the camera's x, y, z; the position of the markers' centre as x/z, y/z and ln z.
Each linearised problem is a chain (chain.py), its noise by maximum likelihood. State per
frame: 6 position-like and 6 velocity-like numbers, each axis accelerated by noise of its
own density; a seventh density accelerates several axes at once (Links.shake).
Source: docs/methods/pose.md#smoothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.pose.chain import Links, evidence, link, smooth_chain
from arfx.analyse.pose.planar import Observed, huber_cost, residuals, view_jacobian
from arfx.core.parallel import parallel_map
from arfx.core.pose import rotation_from_rotvec, rotvec_from_rotation, skew

# Axes whose noise is one number: turning about the picture's two axes, about the line of
# sight; sideways; distance; and the camera's turning about itself (Links.shake), which
# turns the marker and moves it sideways at once.
GROUPS = ((0, 1), (2,), (3, 4), (5,), (6,))
TURN, ROLL, SIDEWAYS, DISTANCE, SHAKE = range(5)
AXES = 7
# (rad, 1)^2 / s^3. Least: drifts by 1e-5 in ten seconds, below anything visible. Most: 1e4
# turns a frame by 20 degrees.
LEAST, MOST = 1e-12, 1e4
_GRID = 10.0 ** np.arange(-12, 5)
# Factors on a value, for what is tried beside it.
_FAR, _NEAR, _NEXT = (
    10.0 ** np.arange(-5, 6),
    10.0 ** np.arange(-2, 3),
    10.0 ** np.array([-1, -0.5, 0, 0.5, 1]),
)
_BLOCK, _BLOCKS = 160, 3  # frames of a long shot from which its own value is taken
_WINDOW, _CONTEXT = 24, 18  # frames
# A window has little evidence on its own: each factor of ten away from the shot's value
# costs this much (nats).
_HOLD = 1.0
# nats by which a camera that shakes must explain the shot better than a marker that moves:
# one number more
_EARNED = 3.0
# Between two frames: what moves is unknown after ten seconds as after a day, whose cube
# leaves no digits for the corners.
LONGEST_STEP_S = 10.0
PASSES = 4  # linearisations between two estimates of the motion's noise
_STIFF = np.array(
    [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-6, LEAST]
)  # start of the second attempt: hardly any motion but sideways
# share of a shake in which its axes go their own ways: 1e-4 of its size, and nothing is
# singular
_LOOSE = 1e-8
_UNSURE_RAD = (
    0.005  # typical error of a raw tilt above which a frame may lie in a wrong valley
)


def learn_density(
    measured: np.ndarray,
    info_vector: np.ndarray,
    links: Links,
    density: np.ndarray | None,
    local: bool,
) -> np.ndarray:
    """(n - 1, AXES) densities.

    measured, info_vector, links : as for smooth_chain;  density : what was learned for the
    shot, None at first
    local : also let it change with time"""
    n = len(measured)
    if n < 3:
        return np.full((max(n - 1, 0), AXES), 1e-2)
    if density is None:
        shot = _density_of_shot(measured, info_vector, links)
    else:
        shot = np.exp([np.median(np.log(density[:, list(g)])) for g in GROUPS])
    if not local or n <= _WINDOW + _CONTEXT:
        return _axes(np.repeat(shot[None], n - 1, 0))
    centres = np.unique(
        np.linspace(_WINDOW / 2, n - 1 - _WINDOW / 2, max(2, round(n / _WINDOW)))
    )

    def of_window(centre: float) -> np.ndarray:
        a = max(0, int(centre - _WINDOW / 2 - _CONTEXT / 2))
        b = min(n, int(centre + _WINDOW / 2 + _CONTEXT / 2) + 1)
        value = shot.copy()
        for i in range(SHAKE + 1 if shot[SHAKE] > LEAST else SHAKE):
            near = _scaled(shot[i], _FAR)
            trial = np.repeat(value[None], len(near), 0)
            trial[:, i] = near
            total = _evidence(measured, info_vector, links, a, b, trial) - _HOLD * np.abs(
                np.log10(near / shot[i])
            )
            value[i] = near[int(total.argmax())]
        return value

    values = np.stack(parallel_map(of_window, centres.tolist()))
    at = np.arange(n - 1) + 0.5
    smooth = np.stack(
        [np.interp(at, centres, np.log(values[:, i])) for i in range(len(GROUPS))], -1
    )
    return _axes(np.exp(smooth))


def _density_of_shot(
    measured: np.ndarray, info_vector: np.ndarray, links: Links
) -> np.ndarray:
    """(groups,) one value each for a shot: the likelier of a marker that moves on its own
    and of a camera that shakes.
    """
    n = len(measured)
    blocks = [(0, n)]
    if n > _BLOCK * _BLOCKS:
        blocks = [(int(a), int(a) + _BLOCK) for a in np.linspace(0, n - _BLOCK, _BLOCKS)]

    def ascend(
        shot: np.ndarray, order: Sequence[int], grid: np.ndarray | None = None
    ) -> tuple[float, np.ndarray]:
        """Evidence and values when one group after the other has taken its best; grid :
        factors, None = the whole range
        """
        shot, best = shot.copy(), -np.inf
        for i in order:
            near = _GRID if grid is None else _scaled(shot[i], grid)
            trial = np.repeat(shot[None], len(near), 0)
            trial[:, i] = near
            total = np.sum(
                [_evidence(measured, info_vector, links, a, b, trial) for a, b in blocks],
                axis=0,
            )
            shot[i], best = near[int(total.argmax())], float(total.max())
        return best, shot

    _, shot = ascend(np.array([1e-3, 1e-3, 1e-3, 1e-3, LEAST]), range(SHAKE))
    moving, shot = ascend(shot, range(SHAKE), _NEAR)
    # what was sideways motion is now the shake: from the one peak no single number leads to
    # the other
    start = shot.copy()
    start[SHAKE], start[SIDEWAYS], start[TURN] = shot[SIDEWAYS], LEAST, LEAST
    _, other = ascend(start, (SIDEWAYS, TURN, DISTANCE))
    shaking, other = ascend(other, (SHAKE, ROLL, SIDEWAYS, TURN), _NEAR)
    if shaking > moving + _EARNED:
        return ascend(other, 2 * (SHAKE, ROLL, DISTANCE, SIDEWAYS, TURN), _NEXT)[1]
    return ascend(shot, 2 * (TURN, ROLL, SIDEWAYS, DISTANCE), _NEXT)[1]


def _scaled(value: float, factors: np.ndarray) -> np.ndarray:
    return np.unique(np.clip(value * factors, LEAST, MOST))


def _axes(groups: np.ndarray) -> np.ndarray:
    """(..., groups) to (..., AXES)."""
    out = np.empty((*groups.shape[:-1], AXES))
    for i, g in enumerate(GROUPS):
        out[..., list(g)] = groups[..., i : i + 1]
    return out


def _evidence(
    measured: np.ndarray,
    info_vector: np.ndarray,
    links: Links,
    a: int,
    b: int,
    trial: np.ndarray,
) -> np.ndarray:
    density = np.broadcast_to(_axes(trial)[:, None], (len(trial), b - a - 1, AXES))
    return evidence(measured[a:b], info_vector[a:b], links.part(a, b), density)


@dataclass(frozen=True)
class Smoothed:
    """rotation (n, 3, 3), translation_m (n, 3), covariance (n, 6, 6) of the left
    perturbation [rad, m] in the camera frame; density (5,) learned noise, median over the
    shot, of GROUPS."""

    rotation: np.ndarray
    translation_m: np.ndarray
    covariance: np.ndarray
    density: np.ndarray


def smooth_poses(
    rotation: np.ndarray,
    translation: np.ndarray,
    seen: Observed,
    times_s: np.ndarray,
    strength: float = 1.0,
) -> Smoothed:
    """Smooth n frames of one shot.

    rotation, translation : start, also in frames without corners (any sensible in-between)
    seen : corners, weight 0 where none;  times_s : (n,) increasing;  strength : factor on
    the time scale, > 0
    """
    on = seen.weight > 0
    centre = seen.points_m[on].mean(0)
    dt = np.clip(np.diff(times_s), 1e-4, LONGEST_STEP_S)
    raw = _Chain(rotation, translation, seen, dt, centre)
    # Twice: from the raw poses, and from a path that hardly moves. Where the corners do not
    # fix a tilt (a frontal
    # marker) raw poses lie in the wrong valleys, each sure of itself, and only the stiff
    # path finds the one between.
    attempts = []
    for stiff in (False, True) if raw.typical_turn_error() > _UNSURE_RAD else (False,):
        chain, density = raw, None
        if stiff:
            chain = chain.iterated(np.broadcast_to(_STIFF, (len(dt), AXES)), 2 * PASSES)
        for local in (False, True):
            density = learn_density(*chain.measurement, chain.links, density, local)
            chain = chain.iterated(density, PASSES)
        assert density is not None
        attempts.append((chain.likelihood(density), chain, density))
    _, chain, density = max(attempts, key=lambda a: a[0])
    if strength != 1.0:
        density = np.clip(density / max(strength**3, 1e-200), LEAST, MOST)
    chain = chain.iterated(density, PASSES)
    _, covariance = smooth_chain(*chain.measurement, chain.links, density)
    p, _ = _position(chain.rotation, chain.translation, centre)
    to_left = np.zeros(
        (len(p), 6, 6)
    )  # from a step in this module's axes to the left perturbation of the pose
    to_left[:, :3, :3] = np.eye(3)
    to_left[:, 3:, :3] = skew(p)
    to_left[:, 3:, 3:] = _position_jacobian(p)
    covariance = to_left @ covariance[:, :6, :6] @ np.swapaxes(to_left, 1, 2)
    middle = (
        np.array([np.median(density[:, list(group)]) for group in GROUPS])
        if len(dt)
        else np.zeros(len(GROUPS))
    )
    return Smoothed(chain.rotation, chain.translation, covariance, middle)


class _Chain:
    """The problem linearised at one set of poses."""

    def __init__(
        self,
        rotation: np.ndarray,
        translation: np.ndarray,
        seen: Observed,
        dt: np.ndarray,
        centre: np.ndarray,
    ) -> None:
        self.rotation, self.translation, self.seen, self.dt, self.centre = (
            rotation,
            translation,
            seen,
            dt,
            centre,
        )
        self.measurement = _measurement(rotation, translation, seen, centre)
        self.links = _links(rotation, translation, centre, dt)

    def iterated(self, density: np.ndarray, passes: int) -> _Chain:
        """Smoothed and linearised anew, up to `passes` times."""
        chain = self
        for _ in range(passes):
            mean, _ = smooth_chain(*chain.measurement, chain.links, density)
            step = mean[:, :6]
            # linearisation holds for about .3 rad: a frame that wants more gets there in
            # several passes
            size = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
            step = step * np.minimum(1.0, 0.3 / np.maximum(size, 1e-12))
            chain = _Chain(
                *_apply_step(chain.rotation, chain.translation, step, self.centre),
                self.seen,
                self.dt,
                self.centre,
            )
            if (
                np.abs(step).max() < 1e-6
            ):  # rad, or shares of the distance: a thousandth of a pixel
                break
        return chain

    def typical_turn_error(self) -> float:
        """Median over the frames seen of the largest standard deviation of a turn, radians."""
        info = self.measurement[0]
        info = info[np.einsum("nii->n", info) > 0]
        scale = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", info), 1e-30))
        spread = np.linalg.pinv(info * scale[:, :, None] * scale[:, None], hermitian=True)
        return float(
            np.sqrt(np.median((np.einsum("nii->ni", spread) * scale**2)[:, :3].max(1)))
        )

    def likelihood(self, density: np.ndarray) -> float:
        """Log evidence with the true misfit at these poses in place of the linearised one's
        constant.
        """
        r = residuals(self.rotation, self.translation, self.seen)
        cost, _ = huber_cost(r, self.seen.weight)
        return float(evidence(*self.measurement, self.links, density[None])[0] - cost.sum())


def _position(
    rotation: np.ndarray, translation: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Centre in camera coordinates (n, 3) and as x/z, y/z, ln z."""
    p = rotation @ centre + translation
    z = np.maximum(p[:, 2], 1e-4)
    return p, np.stack([p[:, 0] / z, p[:, 1] / z, np.log(z)], -1)


def _position_jacobian(p: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of the camera point with respect to x/z, y/z, ln z."""
    out = np.zeros((len(p), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = p[:, 2]
    out[:, :, 2] = p
    return out


def _apply_step(
    rotation: np.ndarray, translation: np.ndarray, step: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    _, position = _position(rotation, translation, centre)
    position = position + step[:, 3:]
    z = np.exp(position[:, 2])
    p = np.stack([position[:, 0] * z, position[:, 1] * z, z], -1)
    turned = rotation_from_rotvec(step[:, :3]) @ rotation
    return turned, p - turned @ centre


def _measurement(
    rotation: np.ndarray, translation: np.ndarray, seen: Observed, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information (n, 6, 6) and right-hand side (n, 6) of the corners, linearised here."""
    p, _ = _position(rotation, translation, centre)
    arm = np.einsum("nij,npj->npi", rotation, seen.points_m - centre)
    view = seen.px_per_ideal @ view_jacobian(arm + p[:, None])
    j = np.concatenate([view @ -skew(arm), view @ _position_jacobian(p)[:, None]], -1)
    r = residuals(rotation, translation, seen)
    _, factor = huber_cost(r, seen.weight)
    jw = j * (seen.weight * factor)[..., None, None]
    return np.einsum("npki,npkj->nij", jw, j), -np.einsum("npki,npk->ni", jw, r)


def _links(
    rotation: np.ndarray, translation: np.ndarray, centre: np.ndarray, dt: np.ndarray
) -> Links:
    """Constant velocity between frames: Log(R_k+1 R_k^T) and the place's difference, minus
    dt times the velocity.
    """
    n = len(dt)
    _, position = _position(rotation, translation, centre)
    turn = rotvec_from_rotation(rotation[1:] @ np.swapaxes(rotation[:-1], 1, 2))
    bend = (
        skew(turn) / 2
    )  # inverse Jacobians of SO(3), left and right, to second order in the turn between frames
    before, after = np.zeros((n, 12, 12)), np.zeros((n, 12, 12))
    i = np.arange(6)
    after[:, i, i] = 1
    before[:, i, i] = -1
    after[:, :3, :3] -= bend
    before[:, :3, :3] -= bend
    before[:, i, i + 6] = -dt[:, None]
    after[:, i + 6, i + 6] = 1
    before[:, i + 6, i + 6] = -1
    offset = np.zeros((n, 12))
    offset[:, :3], offset[:, 3:6] = turn, np.diff(position, axis=0)
    return link(before, after, offset, dt, _shake((position[1:] + position[:-1]) / 2))


def _shake(position: np.ndarray) -> np.ndarray:
    """(n, 6, 6) covariance of a camera that turns by 1 rad^2 about its own x and y, seen at
    place (n, 3).

    The hand that holds a camera turns it far more than it carries it: the marker turns and
    moves, both at once."""
    x, y, axes = position[:, 0], position[:, 1], np.zeros((len(position), 6, 2))
    axes[:, 0, 0] = axes[:, 1, 1] = 1
    axes[:, 3] = np.stack([-x * y, 1 + x * x], -1)
    axes[:, 4] = np.stack([-1 - y * y, x * y], -1)
    axes[:, 5] = np.stack([y, -x], -1)
    return axes @ np.swapaxes(axes, 1, 2) + _LOOSE * np.eye(6)
