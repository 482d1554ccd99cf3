"""A Gauss-Markov chain over one shot: Kalman filter, Rauch-Tung-Striebel smoother, and its noise by maximum likelihood.

State per frame: 6 position-like and 6 velocity-like numbers, each axis accelerated by noise of its own density; a seventh density
accelerates several axes at once (Links.shake). Measurements are information on the first six numbers. Covariance form: regular
for a density of nearly zero, and for directions that no measurement fixes. Source: docs/methods/pose.md#smoothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.pose import kernels
from arfx.analyse.pose.kernels import DIM

# What is known before the first frame: nothing. Standard deviations of 10 (radians, or e-folds of distance) and of
# 100 per second lie beyond anything filmed, and their squares times the information of a corner still leave digits.
_START = np.diag([1e2] * 6 + [1e4] * 6)
# Axes whose noise is one number: turning about the picture's two axes, about the line of sight; sideways; distance; and
# the camera's turning about itself (Links.shake), which turns the marker and moves it sideways at once.
GROUPS = ((0, 1), (2,), (3, 4), (5,), (6,))
TURN, ROLL, SIDEWAYS, DISTANCE, SHAKE = range(5)
AXES = 7
# (rad, 1)^2 / s^3. Least: drifts by 1e-5 in ten seconds, below anything visible. Most: 1e4 turns a frame by 20 degrees.
LEAST, MOST = 1e-12, 1e4
_GRID = 10.0 ** np.arange(-12, 5)
# Factors on a value, for what is tried beside it.
_FAR, _NEAR, _NEXT = 10.0 ** np.arange(-5, 6), 10.0 ** np.arange(-2, 3), 10.0 ** np.array([-1, -0.5, 0, 0.5, 1])
_BLOCK, _BLOCKS = 160, 3  # frames of a long shot from which its own value is taken
_WINDOW, _CONTEXT = 24, 18  # frames
# A window has little evidence on its own: each factor of ten away from the shot's value costs this much (nats).
_HOLD = 1.0
_EARNED = 3.0  # nats by which a camera that shakes must explain the shot better than a marker that moves: one number more


@dataclass(frozen=True)
class Links:
    """How a state follows from the one before: x_k+1 = move_k x_k + shift_k + noise_k, noise through `gate_k`.

    move, gate : (n - 1, 12, 12);  shift : (n - 1, 12);  dt_s : (n - 1,)
    shake : (n - 1, 6, 6) covariance, per unit of its density, of what turns and moves the marker at once
    Only the turns' blocks (3 x 3, of angles and of their velocities) are free: the other axes have constant velocity.
    """

    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    dt_s: np.ndarray
    shake: np.ndarray

    def part(self, first: int, end: int) -> Links:
        """The links between frames first .. end - 1."""
        s = slice(first, end - 1)
        return Links(self.move[s], self.gate[s], self.shift[s], self.dt_s[s], self.shake[s])


def link(before: np.ndarray, after: np.ndarray, offset: np.ndarray, dt_s: np.ndarray, shake: np.ndarray) -> Links:
    """Links from residuals before_k x_k + after_k x_k+1 + offset_k = noise_k."""
    gate = np.linalg.inv(after) if len(after) else after
    return Links(-gate @ before, gate, -np.einsum("nij,nj->ni", gate, offset), dt_s, shake)


def smooth_chain(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, 12) and covariance (n, 12, 12) of every state given all measurements.

    measured : (n, 6, 6) information;  pull : (n, 6) information times measured value;  density : (n - 1, 7)
    """
    n = len(measured)
    means, covs = np.empty((n, DIM)), np.empty((n, DIM, DIM))
    kernels.filter_and_smooth(_chain(measured, pull, links), np.array(density, float, order="C"), means, covs)
    if not (np.isfinite(means).all() and np.isfinite(covs).all()):
        raise np.linalg.LinAlgError("the smoother's chain is singular")
    return means, covs


def evidence(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> np.ndarray:
    """(c,) log evidence, up to a constant, of c candidates of noise density (c, n - 1, 7) on one chain."""
    out = np.empty(len(density))
    kernels.log_evidence(_chain(measured, pull, links), np.array(density, float, order="C"), out)
    return out


def _chain(measured: np.ndarray, pull: np.ndarray, links: Links) -> kernels.Chain:
    """Of copies, all of one type to the compiler: contiguous and writable."""
    given = (measured, pull, links.move, links.gate, links.shift, links.shake, links.dt_s)
    m, g, move, gate, shift, shake, dt = (np.array(a, float, order="C") for a in given)
    return kernels.Chain(m, g, move, gate, shift, shake, dt, _START)


def learn_density(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray | None, local: bool) -> np.ndarray:
    """(n - 1, AXES) densities.

    measured, pull, links : as for smooth_chain;  density : what was learned for the shot, None at first
    local : also let it change with time
    """
    n = len(measured)
    if n < 3:
        return np.full((max(n - 1, 0), AXES), 1e-2)
    if density is None:
        shot = _of_shot(measured, pull, links)
    else:
        shot = np.exp([np.median(np.log(density[:, list(g)])) for g in GROUPS])
    if not local or n <= _WINDOW + _CONTEXT:
        return _axes(np.repeat(shot[None], n - 1, 0))
    centres = np.unique(np.linspace(_WINDOW / 2, n - 1 - _WINDOW / 2, max(2, round(n / _WINDOW))))
    values = np.repeat(shot[None], len(centres), 0)
    for i in range(SHAKE + 1 if shot[SHAKE] > LEAST else SHAKE):
        for w, centre in enumerate(centres):
            a = max(0, int(centre - _WINDOW / 2 - _CONTEXT / 2))
            b = min(n, int(centre + _WINDOW / 2 + _CONTEXT / 2) + 1)
            near = _around(shot[i], _FAR)
            trial = np.repeat(values[w : w + 1], len(near), 0)
            trial[:, i] = near
            total = _evidence(measured, pull, links, a, b, trial) - _HOLD * np.abs(np.log10(near / shot[i]))
            values[w, i] = near[int(total.argmax())]
    at = np.arange(n - 1) + 0.5
    smooth = np.stack([np.interp(at, centres, np.log(values[:, i])) for i in range(len(GROUPS))], -1)
    return _axes(np.exp(smooth))


def _of_shot(measured: np.ndarray, pull: np.ndarray, links: Links) -> np.ndarray:
    """(groups,) one value each for a shot: the likelier of a marker that moves on its own and of a camera that shakes."""
    n = len(measured)
    blocks = [(0, n)]
    if n > _BLOCK * _BLOCKS:
        blocks = [(int(a), int(a) + _BLOCK) for a in np.linspace(0, n - _BLOCK, _BLOCKS)]

    def climbed(shot: np.ndarray, order: Sequence[int], grid: np.ndarray | None = None) -> tuple[float, np.ndarray]:
        """Evidence and values when one group after the other has taken its best; grid : factors, None = the whole range"""
        shot, best = shot.copy(), -np.inf
        for i in order:
            near = _GRID if grid is None else _around(shot[i], grid)
            trial = np.repeat(shot[None], len(near), 0)
            trial[:, i] = near
            total = np.sum([_evidence(measured, pull, links, a, b, trial) for a, b in blocks], axis=0)
            shot[i], best = near[int(total.argmax())], float(total.max())
        return best, shot

    _, shot = climbed(np.array([1e-3, 1e-3, 1e-3, 1e-3, LEAST]), range(SHAKE))
    moving, shot = climbed(shot, range(SHAKE), _NEAR)
    start = shot.copy()  # what was sideways motion is now the shake: from the one peak no single number leads to the other
    start[SHAKE], start[SIDEWAYS], start[TURN] = shot[SIDEWAYS], LEAST, LEAST
    _, other = climbed(start, (SIDEWAYS, TURN, DISTANCE))
    shaking, other = climbed(other, (SHAKE, ROLL, SIDEWAYS, TURN), _NEAR)
    if shaking > moving + _EARNED:
        return climbed(other, 2 * (SHAKE, ROLL, DISTANCE, SIDEWAYS, TURN), _NEXT)[1]
    return climbed(shot, 2 * (TURN, ROLL, SIDEWAYS, DISTANCE), _NEXT)[1]


def _around(value: float, factors: np.ndarray) -> np.ndarray:
    return np.unique(np.clip(value * factors, LEAST, MOST))


def _axes(groups: np.ndarray) -> np.ndarray:
    """(..., groups) to (..., AXES)."""
    out = np.empty((*groups.shape[:-1], AXES))
    for i, g in enumerate(GROUPS):
        out[..., list(g)] = groups[..., i : i + 1]
    return out


def _evidence(measured: np.ndarray, pull: np.ndarray, links: Links, a: int, b: int, trial: np.ndarray) -> np.ndarray:
    density = np.broadcast_to(_axes(trial)[:, None], (len(trial), b - a - 1, AXES))
    return evidence(measured[a:b], pull[a:b], links.part(a, b), density)
