"""One world pose per frame from all mapped markers in it, the right planar solution chosen
over the whole clip (Viterbi).

Source: docs/methods/pose.md#path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.pose.marker_map import View, observe
from arfx.analyse.pose.planar import Observed, refine_poses, residuals, stack
from arfx.core.numerics import divide
from arfx.core.pose import Pose, rotation_angle_rad, rotvec_from_rotation

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
    candidates: Sequence[Sequence[Pose]],
    costs: Sequence[Sequence[float]],
    times_s: Sequence[float],
) -> list[int]:
    """Index of the chosen candidate in every frame.

    candidates : per frame, one or more poses;  costs : their misfit, half of chi squared;
    times_s : frame times
    O(frames * candidates^2). An empty sequence gives an empty path."""
    if not candidates:
        return []
    poses = [stack([*c]) for c in candidates]
    total = np.asarray(costs[0], float)
    back: list[np.ndarray] = []
    for k in range(1, len(candidates)):
        (r0, t0), (r1, t1) = poses[k - 1], poses[k]
        dt = times_s[k] - times_s[k - 1]
        every = total[:, None] + move_costs(r0[:, None], t0[:, None], r1, t1, dt)
        back.append(every.argmin(0))
        total = every.min(0) + np.asarray(costs[k], float)
    path = [int(total.argmin())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return path[::-1]


def move_costs(
    r0: np.ndarray, t0: np.ndarray, r1: np.ndarray, t1: np.ndarray, dt_s: float
) -> np.ndarray:
    """(...) cost of the moves from rotation r0 (..., 3, 3), translation t0 (..., 3) to r1,
    t1: half of chi squared, at most MOVE_CAP."""
    turn = np.linalg.norm(rotvec_from_rotation(r1 @ np.swapaxes(r0, -1, -2)), axis=-1)
    shift, distance = np.linalg.norm(t1 - t0, axis=-1), np.linalg.norm(t1, axis=-1)
    dt = max(dt_s, 0.0)
    a = turn / (TURN_FLOOR_RAD + TURN_RAD_S * dt)
    b = divide(shift, distance * (SHIFT_FLOOR + SHIFT_FRACTION_S * dt), where_zero=np.inf)
    return np.minimum(0.5 * (a * a + b * b), MOVE_CAP)


@dataclass(frozen=True)
class WorldPath:
    """rotation (n, 3, 3), translation (n, 3) of camera_from_world before smoothing,
    identity where not measured
    measured : (n,);  observed : all corners that count;  flips : frames in which the best
    single-frame solution was not
    the right one;  dropped : (frame, key) of inconsistent sightings"""

    rotation: np.ndarray
    translation: np.ndarray
    measured: np.ndarray
    observed: Observed
    flips: int
    dropped: tuple[tuple[int, str], ...]


def world_path(
    frames: Sequence[Sequence[View]],
    world_from_marker: Mapping[str, Pose],
    keys: Sequence[str],
    shot: np.ndarray,
    times_s: np.ndarray,
) -> WorldPath:
    """frames : markers of each frame;  shot : number of each frame's shot: no path runs
    across a cut.
    """
    mapped = [k for k in keys if k in world_from_marker]
    seen = observe(frames, world_from_marker, mapped)
    owner, start = [], []
    for k, views in enumerate(frames):
        usable = sorted(
            (v for v in views if v.key in world_from_marker and v.solutions), key=_extent
        )
        for v in usable[-_STARTS:]:
            for pose in v.solutions:
                owner.append(k)
                start.append(pose @ world_from_marker[v.key].inverse())
    n = len(frames)
    rotation, translation = np.broadcast_to(np.eye(3), (n, 3, 3)).copy(), np.zeros((n, 3))
    index = np.array(owner, int)
    measured = np.zeros(n, bool)
    if not owner:
        return WorldPath(rotation, translation, measured, seen, 0, ())
    measured[index] = True
    r, t = stack(start)
    r, t, cost = refine_poses(r, t, seen.take(index))
    flips = 0
    frames_of = np.flatnonzero(measured)  # whose candidates follow each other in `index`
    begins = dict(zip(frames_of.tolist(), np.searchsorted(index, frames_of), strict=True))
    ends = dict(
        zip(
            frames_of.tolist(), np.searchsorted(index, frames_of, side="right"), strict=True
        )
    )
    _, first = np.unique(shot[frames_of], return_index=True)  # no shot comes twice
    for part in np.split(frames_of, first[1:]):
        at = part.tolist()
        groups = [np.arange(begins[k], ends[k]) for k in at]
        poses = [[Pose(r[i], t[i]) for i in g] for g in groups]
        costs = [[float(cost[i]) if t[i, 2] > 0 else 1e9 for i in g] for g in groups]
        path = choose_path(poses, costs, [float(times_s[k]) for k in at])
        for k, group, candidates, misfit, pick in zip(
            at, groups, poses, costs, path, strict=True
        ):
            rotation[k], translation[k] = r[group[pick]], t[group[pick]]
            alone = int(np.argmin(misfit))
            flips += int(
                alone != pick
                and rotation_angle_rad(candidates[alone], candidates[pick]) > FLIP_RAD
            )
    dropped = _drop_inconsistent(
        rotation, translation, seen, frames, world_from_marker, mapped, measured
    )
    if dropped:
        again = np.array(sorted({k for k, _ in dropped}))
        rotation[again], translation[again], _ = refine_poses(
            rotation[again], translation[again], seen.take(again)
        )
    return WorldPath(rotation, translation, measured, seen, flips, tuple(dropped))


def _extent(v: View) -> float:
    return float(np.ptp(v.ideal[:, 0]) * np.ptp(v.ideal[:, 1]))


def _drop_inconsistent(
    rotation: np.ndarray,
    translation: np.ndarray,
    seen: Observed,
    frames: Sequence[Sequence[View]],
    world_from_marker: Mapping[str, Pose],
    keys: Sequence[str],
    measured: np.ndarray,
) -> list[tuple[int, str]]:
    """Take the weight from markers that contradict the others of their frame: another print
    of the id, a misread.

    Where the joint pose misses a marker, the pose of each single marker is asked how many
    others agree with it; the largest agreement stays, on a tie that of the larger print.
    Changes the frame's start in rotation and translation."""
    slots = {k: slice(4 * i, 4 * i + 4) for i, k in enumerate(keys)}

    def misses(r: np.ndarray, t: np.ndarray, one: Observed) -> dict[str, float]:
        error = np.linalg.norm(residuals(r[None], t[None], one)[0], axis=-1)
        there = {k: p for k, p in slots.items() if one.weight[0, p].all()}
        gate = {
            k: max(GATE_PX, GATE_SIGMA / float(np.sqrt(one.weight[0, p].mean())))
            for k, p in there.items()
        }
        return {
            k: float(np.sqrt((error[p] ** 2).mean())) / gate[k] for k, p in there.items()
        }

    out: list[tuple[int, str]] = []
    for k in map(int, np.flatnonzero(measured & ((seen.weight > 0).sum(1) > 4))):
        one = seen.take(np.array([k]))
        if max(misses(rotation[k], translation[k], one).values()) <= 1:
            continue
        views = sorted(
            (v for v in frames[k] if v.key in slots and v.solutions),
            key=_extent,
            reverse=True,
        )
        candidates = [
            p @ world_from_marker[v.key].inverse() for v in views for p in v.solutions
        ]
        # a single marker says less about its neighbours than all together: three times the gate
        agree = [
            [key for key, m in misses(p.rotation, p.translation_m, one).items() if m <= 3]
            for p in candidates
        ]
        best = max(range(len(candidates)), key=lambda i: (len(agree[i]), -i))
        rotation[k], translation[k] = (
            candidates[best].rotation,
            candidates[best].translation_m,
        )
        for key, part in slots.items():
            if one.weight[0, part].any() and key not in agree[best]:
                seen.weight[k, part] = 0.0
                out.append((int(k), key))
    return out
