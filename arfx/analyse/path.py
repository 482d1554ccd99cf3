"""Choosing one of several poses per frame for a whole clip: Viterbi with a motion cost.

The cost of a path is the sum of the poses' own misfit and of a robust cost of every move. A flip of a planar pose
moves the marker's normal by tens of degrees and back; a path through the wrong solution has to pay that twice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    total = np.asarray(costs[0], float)
    back: list[np.ndarray] = []
    for k in range(1, len(candidates)):
        move = move_costs(candidates[k - 1], candidates[k], times_s[k] - times_s[k - 1])
        every = total[:, None] + move
        back.append(every.argmin(0))
        total = every.min(0) + np.asarray(costs[k], float)
    path = [int(total.argmin())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return path[::-1]


def move_costs(before: Sequence[Pose], after: Sequence[Pose], dt_s: float) -> np.ndarray:
    """(before, after) cost of each move, half of chi squared, at most MOVE_CAP."""
    r0, r1 = np.stack([p.rotation for p in before]), np.stack([p.rotation for p in after])
    t0, t1 = np.stack([p.translation_m for p in before]), np.stack([p.translation_m for p in after])
    turn = np.linalg.norm(rotvec_from_rotation(r1[None] @ np.swapaxes(r0, -1, -2)[:, None]), axis=-1)
    shift = np.linalg.norm(t1[None] - t0[:, None], axis=-1)
    distance = np.linalg.norm(t1, axis=-1)[None]
    dt = max(dt_s, 0.0)
    a = turn / (TURN_FLOOR_RAD + TURN_RAD_S * dt)
    b = divide(shift, distance * (SHIFT_FLOOR + SHIFT_SHARE_S * dt), where_zero=np.inf)
    return np.minimum(0.5 * (a * a + b * b), MOVE_CAP)
