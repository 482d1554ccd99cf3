"""Smooths the poses of one shot with past and future, in the metric of the measurement:
Gauss-Newton on SE(3).

Axes: rotation about the camera's x, y, z; the position of the markers' centre as x/z, y/z and ln z.
Each linearised problem is a chain (chain.py), its noise by maximum likelihood. State per
frame: 6 position-like and 6 velocity-like numbers, each axis accelerated by noise of its
own density; a seventh density accelerates several axes at once (Chain.shake).
Source: docs/methods/pose.md#smoothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy import ndarray

from arfx.analyse.pose.chain import (
    Chain,
    covariances,
    information_of_noise,
    least_density,
    smooth_chain,
    typical_information,
)
from arfx.analyse.pose.planar import Observed, huber_cost, jacobian, residuals
from arfx.core.parallel import parallel_map
from arfx.core.pose import rotation_from_rotvec, rotvec_from_rotation, skew

# Of each axis, the group that shares its noise: turning about the picture's two axes, about
# the line of sight; sideways; distance; and the camera's turning about itself (Chain.shake),
# which turns the marker and moves it sideways at once.
GROUP = [0, 0, 1, 2, 2, 3, 4]
TURN, ROLL, SIDEWAYS, DISTANCE, SHAKE = range(5)
# (rad, 1)^2 / s^3. Least: drifts by 2e-4 in ten seconds, below anything visible. Most: 1e4
# turns a frame by 20 degrees.
LEAST, MOST = 1e-10, 1e4
# nats: values beyond one so much worse than the best are not tried; nor those below one
# that makes no difference
_LOST, _FLAT = 5.0, 1e-3
_BLOCK, _BLOCKS = 160, 3  # frames of a long shot from which its own value is taken
_WINDOW, _CONTEXT = 24, 18  # frames
# frames of a long shot that are smoothed at once, and beside them; what lies farther off
# counts for what hardly moves, and there by less than its noise. About so many on each side
# of the border fade from one piece to the next.
_PIECE, _BESIDE, _FADE = 1200, 200, 100
# A window has little evidence on its own: each factor of ten away from the shot's value
# costs this much (nats).
_HOLD = 1.0
# nats by which a camera that shakes must explain the shot better than a marker that moves:
# one number more
_EARNED = 3.0
# Between two frames: what moves is unknown after ten seconds as after a day, whose cube
# leaves no digits for the corners.
LONGEST_STEP_S = 10.0
# A camera of 250 frames a second: what hardly moves in less is so firm that rounding leaves
# nothing of the corners.
SHORTEST_STEP_S = 4e-3
PASSES = 4  # linearisations between two estimates of the motion's noise
_STIFF = np.array(
    [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-6, LEAST]
)  # start of the second attempt: hardly any motion but sideways
# covariance where nothing is seen: a radian, a metre
_UNKNOWN = np.eye(6)
# typical error of a raw tilt, which is what is known least, above which a frame may lie in a
# wrong valley
_UNSURE_RAD = 0.006


def _density_over_time(chain: Chain, shot: ndarray) -> ndarray:
    """(1 or n - 1, 7) densities: those of the shot (groups,), and how they change with time."""
    n = len(chain.information)
    if n <= _WINDOW + _CONTEXT:
        return shot[None, GROUP]
    centres = np.unique(
        np.linspace(_WINDOW / 2, n - 1 - _WINDOW / 2, max(2, round(n / _WINDOW)))
    )

    def of_window(centre: float) -> ndarray:
        reach = _WINDOW / 2 + _CONTEXT / 2
        part = chain.part(max(0, int(centre - reach)), int(centre + reach) + 1)

        def total(trial: ndarray) -> float:
            return (
                smooth_chain(part, trial[GROUP]).evidence
                - _HOLD * np.abs(np.log10(trial / shot)).sum()
            )

        return _ascend(total, shot, range(SHAKE + 1), 10)[1]

    values = np.log(parallel_map(of_window, centres.tolist()))
    at = np.arange(n - 1) + 0.5
    smooth = np.stack([np.interp(at, centres, v) for v in values.T], -1)
    return np.exp(smooth)[:, GROUP]


def _ascend(
    total: Callable[[ndarray], float],
    value: ndarray,
    order: Iterable[int],
    step: float,
) -> tuple[float, ndarray]:
    """Total and values (groups,) when one group after the other has taken its best.

    step : factor between two trials of a value

    Both ways the trials end where the total has fallen by _LOST: evidence has one peak for
    each density, and at most a plateau below it."""
    best = total(value)
    for i in order:
        start = value
        for factor in (1 / step, step):
            trial, reached = start.copy(), best
            while reached >= best - _LOST and LEAST < trial[i] * factor < MOST:
                trial[i] *= factor
                before, reached = reached, total(trial)
                if reached > best:
                    best, value = reached, trial.copy()
                if factor < 1 and abs(reached - before) < _FLAT:
                    break
    return best, value


def _density_of_shot(chain: Chain) -> ndarray:
    """(groups,) one value each for a shot: the likelier of a marker that moves on its own
    and of a camera that shakes.
    """
    n = len(chain.information)
    if n < 3:
        return np.full(SHAKE + 1, 1e-2)
    blocks = [chain]
    if n > _BLOCK * _BLOCKS:
        starts = np.linspace(0, n - _BLOCK, _BLOCKS).astype(int).tolist()
        blocks = [chain.part(a, a + _BLOCK) for a in starts]

    def total(trial: ndarray) -> float:
        return sum(smooth_chain(b, trial[GROUP]).evidence for b in blocks)

    start = np.array([1e-3, 1e-3, 1e-3, 1e-3, LEAST])
    moving, shot = _ascend(total, start, 2 * [*range(SHAKE)], 10)
    # what was sideways motion is now the shake: from the one peak no single number leads to
    # the other
    start = shot.copy()
    start[SHAKE], start[SIDEWAYS], start[TURN] = shot[SIDEWAYS], LEAST, LEAST
    order = [SIDEWAYS, TURN, DISTANCE, SHAKE, ROLL, SIDEWAYS, TURN]
    shaking, other = _ascend(total, start, order, 10)
    order = [TURN, ROLL, SIDEWAYS, DISTANCE]
    if shaking > moving + _EARNED:
        shot, order = other, [SHAKE, ROLL, DISTANCE, SIDEWAYS, TURN]
    return _ascend(total, shot, 2 * order, 10**0.5)[1]


def smooth_poses(
    rotation: ndarray,
    translation: ndarray,
    seen: Observed,
    times_s: ndarray,
    strength: float = 1.0,
) -> tuple[ndarray, ndarray, ndarray]:
    """Smooth n frames of one shot: rotation (n, 3, 3), translation (n, 3), covariance
    (n, 6, 6) of the left perturbation [rad, m] in the camera frame.

    rotation, translation : start, also in frames without corners (any sensible in-between)
    seen : corners, weight 0 where none;  times_s : (n,) increasing;  strength : factor on
    the time scale, > 0
    A long shot is smoothed piece by piece, each with some frames more on both sides: memory
    does not grow with its length. A piece in which nothing is seen stays as it is.
    """
    n = len(times_s)
    borders = np.linspace(0, n, -(-n // _PIECE) + 1).astype(int)
    raw = rotation, translation, np.broadcast_to(_UNKNOWN, (n, 6, 6))
    out = [a.copy() for a in raw]
    for first, end in pairwise(borders.tolist()):
        around = slice(max(first - _BESIDE, 0), end + _BESIDE)
        part, piece = seen.take(around), [a[around] for a in raw]
        if part.weight.any():
            poses = piece[0], piece[1]
            piece = [*_smooth_piece(*poses, part, times_s[around], strength)]
        share = (np.arange(n)[around] + 0.5 - first) / (2 * _FADE) + 0.5
        share = np.clip(share, float(not first), 1.0)
        for whole, mixed in zip(
            out, blended([a[around] for a in out], piece, share), strict=True
        ):
            whole[around] = mixed
    turned, moved, covariance = out
    return turned, moved, covariance


def blended(
    before: Sequence[ndarray], after: Sequence[ndarray], share: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Rotations, translations and covariances of k frames between some (share (k,) 0) and
    others (1): the shortest rotation, and straight lines."""
    (rotation, translation, covariance), (turned, moved, covariance_after) = (
        before,
        after,
    )
    share = share[:, None]
    later = share[..., None]
    turn = rotvec_from_rotation(np.swapaxes(rotation, 1, 2) @ turned)
    return (
        rotation @ rotation_from_rotvec(share * turn),
        (1 - share) * translation + share * moved,
        (1 - later) * covariance + later * covariance_after,
    )


def _smooth_piece(
    rotation: ndarray,
    translation: ndarray,
    seen: Observed,
    times_s: ndarray,
    strength: float,
) -> tuple[ndarray, ndarray, ndarray]:
    """As of smooth_poses."""
    on = seen.weight > 0
    centre = seen.points_m[on].mean(0)
    dt = np.clip(np.diff(times_s), SHORTEST_STEP_S, LONGEST_STEP_S)
    paths, attempts = [_Path(rotation, translation, seen, dt, centre)], []
    # Twice: from the raw poses, and from a path that hardly moves. Where the corners do not
    # fix a tilt (a frontal
    # marker) raw poses lie in the wrong valleys, each sure of itself, and only the stiff
    # path finds the one between.
    if typical_information(paths[0].chain.information) < _UNSURE_RAD**-2:
        paths.append(paths[0].iterated(_STIFF, 2 * PASSES))
    while paths:
        path = paths.pop()
        shot = _density_of_shot(path.chain)
        path = path.iterated(shot[GROUP], PASSES)
        density = _density_over_time(path.chain, shot)
        path = path.iterated(density, PASSES)
        likelihood = path.likelihood(density)
        attempts.append((likelihood, path.rotation, path.translation, density))
    _, rotation, translation, density = max(attempts, key=lambda a: a[0])
    density = np.clip(density / max(strength**3, 1e-200), LEAST, MOST)
    path = _Path(rotation, translation, seen, dt, centre).iterated(density, PASSES)
    covariance = covariances(smooth_chain(path.chain, density).factor)
    to_left = _to_left(_position(path.rotation, path.translation, centre)[0])
    covariance = to_left @ covariance[:, :6, :6] @ np.swapaxes(to_left, 1, 2)
    return path.rotation, path.translation, covariance


@dataclass
class _Path:
    """Poses of frames that are dt (n - 1,) s apart, and the problem linearised at them."""

    rotation: ndarray
    translation: ndarray
    seen: Observed
    dt: ndarray
    centre: ndarray

    @cached_property
    def chain(self) -> Chain:
        """The corners, linearised here; and constant velocity between frames:
        Log(R_k+1 R_k^T) and the place's difference, minus dt times the velocity.
        """
        rotation, translation, dt = self.rotation, self.translation, self.dt
        p, position = _position(rotation, translation, self.centre)
        missed = residuals(rotation, translation, self.seen)
        _, factor = huber_cost(missed, self.seen.weight)
        j = jacobian(rotation, translation, self.seen) @ _to_left(p)[:, None]
        weighted = j * (self.seen.weight * factor)[..., None, None]
        information = np.einsum("npki,npkj->nij", weighted, j)
        pull = np.einsum("npki,npk->ni", weighted, -missed)
        turn = rotvec_from_rotation(rotation[1:] @ np.swapaxes(rotation[:-1], 1, 2))
        # inverse Jacobians of SO(3), left and right, to second order in the turn between
        # frames
        bend = skew(turn) / 2
        links = np.tile(np.eye(12, 24, k=12) - np.eye(12, 24), (len(dt), 1, 1))
        links[:, :, :12] -= dt[:, None, None] * np.eye(12, k=6)
        links[:, :3, :3] -= bend
        links[:, :3, 12:15] -= bend
        offset = np.hstack([turn, np.diff(position, axis=0), np.zeros((len(dt), 6))])
        firm = information_of_noise(dt)
        least = least_density(information, firm)
        shake = _shake((position[1:] + position[:-1]) / 2)
        return Chain(information, pull, links, offset, firm, shake, least)

    def iterated(self, density: ndarray, passes: int) -> _Path:
        """Smoothed and linearised anew, up to `passes` times."""
        path = self
        for _ in range(passes):
            step = smooth_chain(path.chain, density).mean[:, :6]
            # linearisation holds for about .3 rad: a frame that wants more gets there in
            # several passes
            size = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
            step = step * np.minimum(1.0, 0.3 / np.maximum(size, 1e-12))
            moved = _apply_step(path.rotation, path.translation, step, self.centre)
            path = _Path(*moved, self.seen, self.dt, self.centre)
            if (
                np.abs(step).max() < 1e-6
            ):  # rad, or shares of the distance: a thousandth of a pixel
                break
        return path

    def likelihood(self, density: ndarray) -> float:
        """Log evidence with the true misfit at these poses in place of the linearised one's
        constant.
        """
        r = residuals(self.rotation, self.translation, self.seen)
        cost, _ = huber_cost(r, self.seen.weight)
        _, size = np.linalg.slogdet(self.chain.links[..., 12:])
        return float(
            smooth_chain(self.chain, density).evidence + size.sum() - cost.sum()
        )


def _position(
    rotation: ndarray, translation: ndarray, centre: ndarray
) -> tuple[ndarray, ndarray]:
    """Centre in camera coordinates (n, 3) and as x/z, y/z, ln z."""
    p = rotation @ centre + translation
    z = np.maximum(p[:, 2], 1e-4)
    return p, np.stack([p[:, 0] / z, p[:, 1] / z, np.log(z)], -1)


def _to_left(p: ndarray) -> ndarray:
    """(n, 6, 6) from a step in this module's axes to the left perturbation of the pose.

    p : (n, 3) centre in camera coordinates"""
    out = np.zeros((len(p), 6, 6))
    out[:, :3, :3] = np.eye(3)
    out[:, 3:, :3] = skew(p)
    out[:, 3:, 3:5] = p[:, 2, None, None] * np.eye(3, 2)
    out[:, 3:, 5] = p
    return out


def _apply_step(
    rotation: ndarray,
    translation: ndarray,
    step: ndarray,
    centre: ndarray,
) -> tuple[ndarray, ndarray]:
    _, position = _position(rotation, translation, centre)
    position = position + step[:, 3:]
    z = np.exp(position[:, 2])
    p = np.stack([position[:, 0] * z, position[:, 1] * z, z], -1)
    turned = rotation_from_rotvec(step[:, :3]) @ rotation
    return turned, p - turned @ centre


def _shake(position: ndarray) -> ndarray:
    """(n, 6, 2) this module's axes of a camera that turns about its own x and y, seen at
    place (n, 3).

    The hand that holds a camera turns it far more than it carries it: the marker turns and
    moves, both at once."""
    ray = np.pad(position[:, :2], ((0, 0), (0, 1)), constant_values=1.0)
    return np.linalg.inv(_to_left(ray))[..., :2]
