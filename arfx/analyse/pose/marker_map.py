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
    """m markers in n frames. seen : (n, m) corners, in the axes of each, with weight 0 where
    it is not seen;  poses : (n, m) camera_from_marker
    """

    seen: Observed
    poses: PlanarPoses

    def take(self, index: Any) -> Prints:
        return Prints(self.seen.take(index), self.poses.take(index))

    @property
    def known(self) -> ndarray:
        """(n, m, 2) bool: which of both poses"""
        return self.poses.known & (self.seen.weight[..., :1] > 0)

    @property
    def there(self) -> ndarray:
        """(n, m) bool"""
        return self.known[..., 0]


class MarkerMap(NamedTuple):
    """world_from_marker by key;  unmapped keys;  frames used;  rms_px of the adjustment, 0
    without one;  condition : of the reduced normal matrix, None without one, or infinite
    """

    world_from_marker: dict[str, Pose]
    unmapped: tuple[str, ...] = ()
    frames: int = 0
    rms_px: float = 0.0
    condition: float | None = None


def map_markers(prints: Prints, keys: Sequence[str]) -> MarkerMap:
    """keys : of the markers, configured order."""
    there = prints.there
    present = np.flatnonzero(there.any(0)).tolist()
    if not present:
        return MarkerMap({})
    start = _spanning_tree(prints, present)
    unmapped = tuple(keys[k] for k in present if k not in start)
    if len(start) == 1:
        return MarkerMap({keys[present[0]]: Pose.identity()}, unmapped)
    placed = list(start)
    shared = np.flatnonzero(there[:, placed].sum(1) > 1)
    chosen = _evenly(shared, MAX_FRAMES)
    for k in placed:
        if not there[chosen, k].any():
            chosen = np.append(chosen, _evenly(shared[there[shared, k]], _FEW))
    poses = {keys[k]: pose for k, pose in start.items()}
    return _adjust(prints.take((chosen[:, None], placed)), poses, unmapped)


def _evenly(items: ndarray, most: int) -> ndarray:
    at = np.linspace(0, len(items) - 1, most).round().astype(int)
    return items[np.unique(at)]


def _spanning_tree(prints: Prints, present: Sequence[int]) -> dict[int, Pose]:
    """Grow the map from the first marker along the pairs that agree best."""

    @cache
    def edge(a: int, b: int) -> tuple[float, Pose]:
        return _relative_pose(prints, a, b)

    out = {present[0]: Pose.identity()}
    while True:
        ends = ((edge(a, b)[0], a, b) for a in out for b in present if b not in out)
        misfit, a, b = min(ends, default=(np.inf, 0, 0))
        if misfit == np.inf:
            return out
        out[b] = out[a] @ edge(a, b)[1]


def _relative_pose(prints: Prints, first: int, second: int) -> tuple[float, Pose]:
    """(misfit, pose of the second in the first): the candidate under which its corners fit
    best in the other frames, medians of px.

    The misfit is divided by the root of the number of frames, so that a pair often seen
    together is preferred."""
    both = np.flatnonzero(prints.there[:, [first, second]].all(1))
    if not len(both):
        return np.inf, Pose.identity()
    frames = _evenly(both, _VOTERS)
    a, b = (prints.poses.take((frames, k)) for k in (first, second))
    apart = b.translation[:, None] - a.translation[:, :, None]
    known = a.known[:, :, None] & b.known[:, None]
    a_from_camera = np.swapaxes(a.rotation, -1, -2)[:, :, None]
    turn = (a_from_camera @ b.rotation[:, None])[known]
    shift = (a_from_camera @ apart[..., None])[known][..., 0]
    # every solution of a, in every frame, with every candidate
    turned = a.rotation[:, :, None] @ turn
    moved = np.einsum("nsij,kj->nski", a.rotation, shift) + a.translation[:, :, None]
    seen = prints.seen.take((np.repeat(frames, 2 * len(turn)), second))
    off = residuals(turned.reshape(-1, 3, 3), moved.reshape(-1, 3), seen)
    missed = rms_px(off, seen.weight)
    # an error of the first one's own solution counts as well, infinite where there is none
    missed = missed.reshape(len(frames), 2, len(turn)) + a.error_px[..., None]
    typical = np.median(missed.min(1), axis=0)
    best = int(typical.argmin())
    return float(typical[best] / np.sqrt(len(both))), Pose(turn[best], shift[best])


def camera_poses(
    prints: Prints, turn: ndarray, shift: ndarray
) -> tuple[ndarray, ndarray]:
    """camera_from_world by each planar pose of all prints: rotation (n, m, 2, 3, 3),
    translation (n, m, 2, 3). turn, shift : world_from_marker of every marker"""
    rotation = prints.poses.rotation @ np.swapaxes(turn, -1, -2)[:, None]
    moved = (rotation @ shift[:, None, :, None])[..., 0]
    return rotation, prints.poses.translation - moved


def _adjust(
    prints: Prints, start: Mapping[str, Pose], unmapped: tuple[str, ...]
) -> MarkerMap:
    """Gauss-Newton over the map alone: every frame has the pose that fits best, and what this
    explains of its corners is projected out (QR). start : of the markers, in their order"""
    from scipy.linalg import block_diag

    turn, shift = arrays([*start.values()])
    n, m = prints.there.shape
    # from the planar solution that fits all its markers best
    known = prints.known
    rotation, translation = (a[known] for a in camera_poses(prints, turn, shift))
    frame = np.nonzero(known)[0]
    one = observe(prints, turn, shift).take(frame)
    misfit, _ = huber_cost(residuals(rotation, translation, one), one.weight)
    first = best_of_each(frame, misfit)
    rotation, translation = rotation[first], translation[first]
    cost = np.inf
    for _ in range(30):
        seen = observe(prints, turn, shift)
        rotation, translation, misfit = refine_poses(rotation, translation, seen)
        r = residuals(rotation, translation, seen)
        before, cost = cost, float(misfit.sum())
        if before - cost < 1e-10 * (1 + cost):
            break
        root = np.sqrt(seen.weight * huber_cost(r, seen.weight)[1])[..., None]
        frame_j = jacobian(rotation, translation, seen)
        # px per left perturbation, in world axes, of the marker that carries the corner
        map_j = frame_j[..., 3:] @ rotation[:, None] @ lever(seen.points_m)
        own, _ = np.linalg.qr((frame_j * root[..., None]).reshape(n, -1, 6))
        of_map = (map_j * root[..., None]).reshape(n, m, 8, 6)
        shared = np.einsum("nmai,nmaj->nimj", own.reshape(of_map.shape), of_map)
        shared = shared.reshape(6 * n, 6 * m)
        own_blocks = np.einsum("nmai,nmaj->mij", of_map, of_map)
        normal = block_diag(*own_blocks) - shared.T @ shared
        right = np.einsum("nmai,nma->mi", of_map, (r * root).reshape(n, m, 8))
        reduced = normal[6:, 6:]  # the first marker is the world: it stays
        step = np.append(np.zeros(6), -np.linalg.solve(reduced, right.ravel()[6:]))
        turn, shift = apply_step(turn, shift, step.reshape(m, 6))
    rms = float(np.sqrt(np.mean(rms_px(r, seen.weight) ** 2)))
    poses = dict(zip(start, map(Pose, turn, shift), strict=True))
    weakness = condition(reduced)
    told = weakness if np.isfinite(weakness) else None
    return MarkerMap(poses, unmapped, n, rms, told)


def arrays(poses: Sequence[Pose]) -> tuple[ndarray, ndarray]:
    """Rotation (n, 3, 3), translation (n, 3)."""
    matrices = np.array([p.matrix for p in poses]).reshape(-1, 4, 4)
    return matrices[:, :3, :3], matrices[:, :3, 3]


def observe(prints: Prints, turn: ndarray, shift: ndarray) -> Observed:
    """The corners of n frames in world axes, four places for each marker.

    turn, shift : world_from_marker of every marker"""
    n, m = prints.there.shape
    world = prints.seen.points_m @ np.swapaxes(turn, 1, 2) + shift[:, None]
    rows = prints.seen._replace(points_m=world)
    return Observed(*(a.reshape(n, 4 * m, *a.shape[3:]) for a in rows))
