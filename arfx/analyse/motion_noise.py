"""How restless is the motion? Noise densities of the smoother's chain by maximum likelihood, changing with time.

Candidates are compared by the evidence of the chain, one axis group after the other: first one value for the whole shot,
then one per window of about a second, held near the shot's. A marker at rest thereby stands rock-steady in the same
clip in which it moves fast at another time. A shot is taken for one of a camera that shakes in the hand if that explains it
better than a marker that moves on its own: the shake is then seen in where the marker is, far more exactly than in its tilt.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.analyse.chain import Links, evidence

# Axes whose noise is one number: turning about the picture's two axes, about the line of sight; sideways; distance; and
# the camera's turning about itself (chain.Links.shake), which turns the marker and moves it sideways at once.
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
    blocks = _blocks(len(measured))

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


def _blocks(n: int) -> list[tuple[int, int]]:
    if n <= _BLOCK * _BLOCKS:
        return [(0, n)]
    return [(int(a), int(a) + _BLOCK) for a in np.linspace(0, n - _BLOCK, _BLOCKS)]


def _axes(groups: np.ndarray) -> np.ndarray:
    """(..., groups) to (..., AXES)."""
    out = np.empty((*groups.shape[:-1], AXES))
    for i, g in enumerate(GROUPS):
        out[..., list(g)] = groups[..., i : i + 1]
    return out


def _evidence(measured: np.ndarray, pull: np.ndarray, links: Links, a: int, b: int, trial: np.ndarray) -> np.ndarray:
    density = np.broadcast_to(_axes(trial)[:, None], (len(trial), b - a - 1, AXES))
    return evidence(measured[a:b], pull[a:b], links.part(a, b), density)
