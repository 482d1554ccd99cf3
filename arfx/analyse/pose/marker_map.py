"""The layout of several markers from the clip: relative poses by vote, then bundle
adjustment, O(frames * markers^2).

world = the axes of the first configured marker that was seen. Source: docs/methods/pose.md#map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.pose.planar import (
    Observed,
    PlanarPoses,
    apply_step,
    best_of_each,
    huber_cost,
    jacobian,
    lever,
    refine_poses,
    residuals,
    rms_px,
)
from arfx.core.numerics import condition
from arfx.core.pose import Pose

# frames that the adjustment uses, evenly spread over those with two or more markers
MAX_FRAMES = 200
_FEW = 10  # frames of a marker that none of these shows
_VOTERS = 40  # frames of a pair, which judge each other's votes


class Prints(NamedTuple):
    """s sightings of prints. frame, marker : (s,) their numbers;  seen : their corners, in the
    axes of each;  poses : camera_from_marker
    """

    frame: ndarray
    marker: ndarray
    seen: Observed
    poses: PlanarPoses

    def in_frames(self, frames: ndarray) -> Prints:
        """What a table of rows (n, m), -1 = none, holds: m markers in n frames."""
        frame, marker = np.nonzero(frames >= 0)
        rows = frames[frame, marker]
        return Prints(frame, marker, self.seen.take(rows), self.poses.take(rows))

    def by_frame(self, frames: int, markers: int) -> ndarray:
        """(frames, markers) row of each marker in each frame, -1 = it is not seen."""
        out = np.full((frames, markers), -1)
        out[self.frame, self.marker] = np.arange(len(self.frame))
        return out


class MarkerMap(NamedTuple):
    """world_from_marker by key;  unmapped keys;  frames used;  rms_px of the adjustment, 0
    without one
    standard_deviation_m : of each marker's centre;  condition : of the reduced normal
    matrix, 1 without one
    """

    world_from_marker: dict[str, Pose]
    unmapped: tuple[str, ...] = ()
    frames: int = 0
    rms_px: float = 0.0
    standard_deviation_m: Mapping[str, float] = {}
    condition: float = 1.0

    def to_json(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "rms_px": self.rms_px,
            "condition": self.condition if np.isfinite(self.condition) else None,
            "unmapped": list(self.unmapped),
            "sd_m": dict(self.standard_deviation_m),
        }


def map_markers(prints: Prints, frames: int, keys: Sequence[str]) -> MarkerMap:
    """frames : how many;  keys : of the markers, configured order."""
    present = np.unique(prints.marker).tolist()
    if not present:
        return MarkerMap({})
    rows = prints.by_frame(frames, len(keys))
    together = rows[(rows >= 0).sum(1) > 1]
    start = _spanning_tree(prints, together, present)
    unmapped = tuple(keys[k] for k in present if k not in start)
    together = together[:, [*start]]
    if len(start) == 1:
        return MarkerMap({keys[present[0]]: Pose.identity()}, unmapped)
    shared = together[(together >= 0).sum(1) > 1]
    chosen = _evenly(shared, MAX_FRAMES)
    for column in range(len(start)):
        if not (chosen[:, column] >= 0).any():
            more = _evenly(shared[shared[:, column] >= 0], _FEW)
            chosen = np.concatenate([chosen, more])
    poses = {keys[k]: pose for k, pose in start.items()}
    return _adjust(prints.in_frames(chosen), len(chosen), poses, unmapped)


def _evenly(items: ndarray, most: int) -> ndarray:
    at = np.linspace(0, len(items) - 1, most).round().astype(int)
    return items[np.unique(at)]


def _spanning_tree(
    prints: Prints, together: ndarray, present: Sequence[int]
) -> dict[int, Pose]:
    """Grow the map from the first marker along the pairs that agree best. together : (n, m)
    rows of `prints` in frames that show several"""

    @cache
    def edge(a: int, b: int) -> tuple[float, Pose]:
        pairs = together[:, [a, b]]
        return _relative_pose(prints, pairs[(pairs >= 0).all(1)])

    out = {present[0]: Pose.identity()}
    while True:
        ends = ((edge(a, b)[0], a, b) for a in out for b in present if b not in out)
        misfit, a, b = min(ends, default=(np.inf, 0, 0))
        if misfit == np.inf:
            return out
        out[b] = out[a] @ edge(a, b)[1]


def _relative_pose(prints: Prints, pairs: ndarray) -> tuple[float, Pose]:
    """(misfit, pose of b in a): the candidate under which b's corners fit best in the other
    frames, medians of px. pairs : (n, 2) rows of a and b

    The misfit is divided by the root of the number of frames, so that a pair often seen
    together is preferred."""
    if not len(pairs):
        return np.inf, Pose.identity()
    rows = _evenly(pairs, _VOTERS)
    a, b = map(prints.poses.take, rows.T)
    apart = b.translation[:, None] - a.translation[:, :, None]
    known = a.known[:, :, None] & b.known[:, None]
    a_from_camera = np.swapaxes(a.rotation, -1, -2)[:, :, None]
    turn = (a_from_camera @ b.rotation[:, None])[known]
    shift = (a_from_camera @ apart[..., None])[known][..., 0]
    # every solution of a, in every frame, with every candidate
    seen = prints.seen.take(rows[:, 1])
    turned = a.rotation[:, :, None] @ turn
    moved = np.einsum("nsij,kj->nski", a.rotation, shift) + a.translation[:, :, None]
    seen = seen.take(np.repeat(np.arange(len(rows)), 2 * len(turn)))
    off = residuals(turned.reshape(-1, 3, 3), moved.reshape(-1, 3), seen)
    missed = rms_px(off, seen.weight)
    missed = missed.reshape(len(rows), 2, len(turn))
    missed[~a.known] = np.inf
    typical = np.median(missed.min(1), axis=0)
    best = int(typical.argmin())
    return float(typical[best] / np.sqrt(len(pairs))), Pose(turn[best], shift[best])


def camera_poses(
    prints: Prints, rows: ndarray, layout: Sequence[Pose]
) -> tuple[ndarray, ndarray, ndarray]:
    """camera_from_world by each planar pose of some prints: rotation (k, 3, 3), translation
    (k, 3), and whose it is (k,). layout : world_from_marker of every marker"""
    turn, shift = (part[prints.marker[rows], None] for part in arrays(layout))
    poses = prints.poses.take(rows)
    rotation = poses.rotation @ np.swapaxes(turn, -1, -2)
    translation = poses.translation - (rotation @ shift[..., None])[..., 0]
    known = poses.known
    return rotation[known], translation[known], rows[np.nonzero(known)[0]]


def _adjust(
    prints: Prints, n: int, start: Mapping[str, Pose], unmapped: tuple[str, ...]
) -> MarkerMap:
    """Gauss-Newton over the map alone: every frame has the pose that fits best, and what this
    explains of its corners is projected out (QR). prints : in n frames;  start : of the
    markers, in their order"""
    from scipy.linalg import block_diag

    keys, layout = list(start), list(start.values())
    m = len(keys)
    local = np.zeros((m, 4, 3))
    local[prints.marker] = prints.seen.points_m
    seen = observe(prints, n, layout)
    # from the planar solution that fits all its markers best
    rotation, translation, row = camera_poses(
        prints, np.arange(len(prints.frame)), layout
    )
    frame = prints.frame[row]
    one = seen.take(frame)
    misfit, _ = huber_cost(residuals(rotation, translation, one), one.weight)
    first = best_of_each(frame, misfit)
    rotation, translation = rotation[first], translation[first]
    map_r, map_t = arrays(layout)
    cost = np.inf
    for _ in range(30):
        world = (local @ np.swapaxes(map_r, 1, 2) + map_t[:, None]).reshape(1, -1, 3)
        seen = seen._replace(points_m=np.broadcast_to(world, seen.points_m.shape))
        rotation, translation, misfit = refine_poses(rotation, translation, seen)
        r = residuals(rotation, translation, seen)
        before, cost = cost, float(misfit.sum())
        if before - cost < 1e-10 * (1 + cost):
            break
        root = np.sqrt(seen.weight * huber_cost(r, seen.weight)[1])[..., None]
        frame_j = jacobian(rotation, translation, seen)
        # px per left perturbation, in world axes, of the marker that carries the corner
        map_j = frame_j[..., 3:] @ rotation[:, None] @ lever(world)
        own, _ = np.linalg.qr((frame_j * root[..., None]).reshape(n, -1, 6))
        of_map = (map_j * root[..., None]).reshape(n, m, 8, 6)
        shared = np.einsum("nmai,nmaj->nimj", own.reshape(of_map.shape), of_map)
        shared = shared.reshape(6 * n, 6 * m)
        own_blocks = np.einsum("nmai,nmaj->mij", of_map, of_map)
        normal = block_diag(*own_blocks) - shared.T @ shared
        right = np.einsum("nmai,nma->mi", of_map, (r * root).reshape(n, m, 8))
        reduced = normal[6:, 6:]  # the first marker is the world: it stays
        step = np.append(np.zeros(6), -np.linalg.solve(reduced, right.ravel()[6:]))
        map_r, map_t = apply_step(map_r, map_t, step.reshape(m, 6))
    rms = float(np.sqrt(np.mean(rms_px(r, seen.weight) ** 2)))
    # a centre moves by rotation x centre + translation of the left perturbation
    moved = lever(map_t[1:])
    covariance = np.linalg.pinv(reduced).reshape(m - 1, 6, m - 1, 6)
    square = np.einsum("iaj,ijik,iak->i", moved, covariance, moved)
    spread = dict(
        zip(keys, [0.0, *np.sqrt(np.maximum(square, 0)).tolist()], strict=True)
    )
    poses = {k: Pose(map_r[i], map_t[i]) for i, k in enumerate(keys)}
    return MarkerMap(poses, unmapped, n, rms, spread, condition(reduced))


def arrays(poses: Sequence[Pose]) -> tuple[ndarray, ndarray]:
    """Rotation (n, 3, 3), translation (n, 3)."""
    turn, shift = ([p.rotation for p in poses], [p.translation_m for p in poses])
    return np.array(turn), np.array(shift)


def observe(prints: Prints, n: int, layout: Sequence[Pose]) -> Observed:
    """The corners of n frames in world axes, four places for each marker.

    layout : world_from_marker of every marker"""
    place, m = (prints.frame, prints.marker), max(len(layout), 1)
    out = Observed(*(np.zeros((n, m, *a.shape[1:])) for a in prints.seen))
    for whole, one in zip(out, prints.seen, strict=True):
        whole[place] = one
    if len(prints.frame):
        turn, shift = (part[prints.marker] for part in arrays(layout))
        world = prints.seen.points_m @ np.swapaxes(turn, 1, 2) + shift[:, None]
        out.points_m[place] = world
    return Observed(*(a.reshape(n, 4 * m, *a.shape[3:]) for a in out))
