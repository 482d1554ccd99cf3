"""One world pose per frame from all mapped markers in it, the right planar solution chosen
over the whole clip (Viterbi).

Source: docs/methods/pose.md#path."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.pose.marker_map import Prints, camera_poses, observe
from arfx.analyse.pose.planar import Observed, best_of_each, refine_poses, residuals
from arfx.core.numerics import divide
from arfx.core.pose import Pose, rotvec_from_rotation

# a hand turns a marker, or a camera, about this fast; faster is possible, and costs more
TURN_RAD_S = 1.0
TURN_FLOOR_RAD = 0.01  # noise of a tilt between two frames that nothing moved in
SHIFT_FRACTION_S = 1.0  # the same for the distance, as a share of it per second
SHIFT_FLOOR = 0.005
# above this a move is no less likely than any other: a cut or a glitch must not bend the
# path
MOVE_CAP = 40.0
FLIP_RAD = np.radians(5.0)  # solutions farther apart than this count as a flip
GATE_SIGMA, GATE_PX = (
    12.0,
    1.5,
)  # a marker that misses the joint pose by more than both is inconsistent
_STARTS = 2  # markers (the largest in the frame) whose solutions start a joint pose


def choose_path(
    rotation: ndarray,
    translation: ndarray,
    cost: ndarray,
    index: ndarray,
    times_s: ndarray,
    shot: ndarray,
) -> list[int]:
    """Which candidate is chosen in every frame that has one.

    rotation (c, 3, 3), translation (c, 3) : of the candidates;  cost (c,) : their misfit,
    half of chi squared;  index (c,) : their frames, rising
    times_s, shot : of every frame; across a cut any move is free
    O(frames * candidates^2)."""
    groups = np.split(np.arange(len(index)), np.flatnonzero(np.diff(index)) + 1)
    total, back = cost[groups[0]], []
    for a, b in pairwise(groups):
        k, m = index[a[0]], index[b[0]]
        dt = times_s[m] - times_s[k]
        move = move_costs(
            rotation[a, None], translation[a, None], rotation[b], translation[b], dt
        )
        every = total[:, None] + (shot[k] == shot[m]) * move
        back.append(every.argmin(0))
        total = every.min(0) + cost[b]
    path = [int(total.argmin())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return [int(g[i]) for g, i in zip(groups, reversed(path), strict=True)]


def move_costs(
    r0: ndarray, t0: ndarray, r1: ndarray, t1: ndarray, dt_s: float
) -> ndarray:
    """(...) cost of the moves from rotation r0 (..., 3, 3), translation t0 (..., 3) to r1,
    t1: half of chi squared, at most MOVE_CAP."""
    turn = np.linalg.norm(rotvec_from_rotation(r1 @ np.swapaxes(r0, -1, -2)), axis=-1)
    shift, distance = np.linalg.norm(t1 - t0, axis=-1), np.linalg.norm(t1, axis=-1)
    dt = max(dt_s, 0.0)
    a = turn / (TURN_FLOOR_RAD + TURN_RAD_S * dt)
    b = divide(
        shift, distance * (SHIFT_FLOOR + SHIFT_FRACTION_S * dt), where_zero=np.inf
    )
    return np.minimum(0.5 * (a * a + b * b), MOVE_CAP)


class WorldPath(NamedTuple):
    """rotation (n, 3, 3), translation (n, 3) of camera_from_world before smoothing,
    identity where not measured
    measured : (n,);  observed : all corners that count;  flips : frames in which the best
    single-frame solution was not
    the right one;  dropped : how many inconsistent sightings"""

    rotation: ndarray
    translation: ndarray
    measured: ndarray
    observed: Observed
    flips: int = 0
    dropped: int = 0


def world_path(
    prints: Prints,
    world_from_marker: Mapping[str, Pose],
    keys: Sequence[str],
    shot: ndarray,
    times_s: ndarray,
) -> WorldPath:
    """keys : of the markers, by number;  shot : number of each frame's shot: no path runs
    across a cut;  times_s : of each frame
    """
    n = len(times_s)
    mapped = [k for k, key in enumerate(keys) if key in world_from_marker]
    layout = [world_from_marker[keys[k]] for k in mapped]
    prints = prints.in_frames(prints.by_frame(n, len(keys))[:, mapped])
    seen = observe(prints, n, layout)
    rotation, translation = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    measured = np.bincount(prints.frame, minlength=n) > 0
    if not measured.any():
        return WorldPath(rotation, translation, measured, seen)
    # the largest of each frame first
    rows = np.lexsort((-np.ptp(prints.seen.ideal, 1).prod(1), prints.frame))
    frame = prints.frame[rows]
    ends = np.searchsorted(frame, np.arange(n + 1))
    starts = rows[np.arange(len(rows)) - ends[frame] < _STARTS]
    r, t, row = camera_poses(prints, starts, layout)
    index = prints.frame[row]
    r, t, cost = refine_poses(r, t, seen.take(index))
    cost = np.where(t[:, 2] > 0, cost, 1e9)
    path = choose_path(r, t, cost, index, times_s, shot)
    rotation[measured], translation[measured] = r[path], t[path]
    alone = r[best_of_each(index, cost)]
    turn = rotvec_from_rotation(r[path] @ np.swapaxes(alone, 1, 2))
    flips = int((np.linalg.norm(turn, axis=1) > FLIP_RAD).sum())
    # Markers that contradict the others of their frame, another print of the id or a misread,
    # lose their weight. Where the joint pose misses a marker, the pose of each single one is
    # asked how many others agree with it; the largest agreement stays, on a tie that of the
    # larger print.
    there = seen.weight[:, ::4] > 0
    missed = (_misses(rotation, translation, seen) > 1).any(1) & (there.sum(1) > 1)
    again, dropped = np.flatnonzero(missed), 0
    for k in again:
        r, t, row = camera_poses(prints, rows[ends[k] : ends[k + 1]], layout)
        # a single marker says less about its neighbours than all together: three times the gate
        agree = _misses(r, t, seen.take(np.full(len(row), k))) <= 3
        best = (agree & there[k]).sum(1).argmax()
        rotation[k], translation[k] = r[best], t[best]
        seen.weight[k] *= agree[best].repeat(4)
        dropped += int((there[k] & ~agree[best]).sum())
    rotation[again], translation[again], _ = refine_poses(
        rotation[again], translation[again], seen.take(again)
    )
    return WorldPath(rotation, translation, measured, seen, flips, dropped)


def _misses(rotation: ndarray, translation: ndarray, seen: Observed) -> ndarray:
    """(n, markers) by how much each misses the pose, in sizes of the gate; 0 where it is
    not there.
    """
    squares = (residuals(rotation, translation, seen) ** 2).sum(2)
    gate = np.maximum(GATE_PX, divide(GATE_SIGMA, np.sqrt(seen.weight[:, ::4])))
    rms = np.sqrt(squares.reshape(*gate.shape, 4).mean(2))
    return np.where(seen.weight[:, ::4] > 0, rms / gate, 0)
