"""Choosing one of several poses per frame for a whole clip: Viterbi with a motion cost.

The cost of a path is the sum of the poses' own misfit and of a robust cost of every move. A flip of a planar pose
moves the marker's normal by tens of degrees and back; a path through the wrong solution has to pay that twice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.analyse.geometry import stack
from arfx.core.numerics import divide
from arfx.core.pose import Pose, rotvec_from_rotation

TURN_RAD_S = 1.0  # a hand turns a marker, or a camera, about this fast; faster is possible, and costs more
TURN_FLOOR_RAD = 0.01  # noise of a tilt between two frames that nothing moved in
SHIFT_SHARE_S = 1.0  # the same for the distance, as a share of it per second
SHIFT_FLOOR = 0.005
MOVE_CAP = 40.0  # above this a move is no less likely than any other: a cut or a glitch must not bend the path


def choose_path(candidates: Sequence[Sequence[Pose]], costs: Sequence[Sequence[float]], times_s: Sequence[float]) -> list[int]:
    """Index of the chosen candidate in every frame.

    candidates : per frame, one or more poses;  costs : their misfit, half of chi squared;  times_s : frame times
    O(frames * candidates^2). An empty sequence gives an empty path.
    """
    if not candidates:
        return []
    count = np.array([len(c) for c in candidates])
    first = np.cumsum(count) - count
    rotation, translation = stack([p for c in candidates for p in c])
    # every move there is, priced at once: row by row from each candidate of a frame to each of the next
    before = [np.repeat(np.arange(a, a + n), m) for a, n, m in zip(first, count, count[1:], strict=False)]
    after = [np.tile(np.arange(b, b + m), n) for b, n, m in zip(first[1:], count, count[1:], strict=False)]
    dt = np.repeat(np.diff(np.asarray(times_s, float)), count[:-1] * count[1:])
    i, j = (np.concatenate([np.zeros(0, int), *part]) for part in (before, after))
    prices = np.split(move_costs(rotation[i], translation[i], rotation[j], translation[j], dt), np.cumsum(count[:-1] * count[1:]))
    total = np.asarray(costs[0], float)
    back: list[np.ndarray] = []
    for k in range(1, len(candidates)):
        every = total[:, None] + prices[k - 1].reshape(count[k - 1], count[k])
        back.append(every.argmin(0))
        total = every.min(0) + np.asarray(costs[k], float)
    path = [int(total.argmin())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return path[::-1]


def move_costs(r0: np.ndarray, t0: np.ndarray, r1: np.ndarray, t1: np.ndarray, dt_s: np.ndarray | float) -> np.ndarray:
    """(n,) cost of the moves from rotation r0 (n, 3, 3), translation t0 (n, 3) to r1, t1: half of chi squared, at most
    MOVE_CAP."""
    turn = np.linalg.norm(rotvec_from_rotation(r1 @ np.swapaxes(r0, -1, -2)), axis=-1)
    shift, distance = np.linalg.norm(t1 - t0, axis=-1), np.linalg.norm(t1, axis=-1)
    dt = np.maximum(dt_s, 0.0)
    a = turn / (TURN_FLOOR_RAD + TURN_RAD_S * dt)
    b = divide(shift, distance * (SHIFT_FLOOR + SHIFT_SHARE_S * dt), where_zero=np.inf)
    return np.minimum(0.5 * (a * a + b * b), MOVE_CAP)
