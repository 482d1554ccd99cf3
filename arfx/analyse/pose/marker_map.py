"""The layout of several markers from the clip: relative poses by vote, then bundle
adjustment, O(frames * markers^2).

world = the axes of the first configured marker that was seen. Source: docs/methods/pose.md#map.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

from arfx.analyse.pose.planar import (
    Observed,
    apply_step,
    huber_cost,
    jacobian,
    refine_poses,
    residuals,
    rms_px,
    stack,
)
from arfx.core.numerics import condition
from arfx.core.pose import Pose, skew

# frames that the adjustment uses, evenly spread over those with two or more markers
MAX_FRAMES = 200
_FEW = 10  # frames of a marker that none of these shows
_VOTERS, _JUDGES = 40, 60
T = TypeVar("T")


@dataclass(frozen=True)
class View:
    """One marker in one frame, as the mapping needs it.

    seen : without the axis of frames;  solutions : its planar poses, best first.
    """

    key: str
    seen: Observed
    solutions: tuple[Pose, ...]


@dataclass(frozen=True)
class MarkerMap:
    """world_from_marker by key;  unmapped keys;  frames used;  rms_px of the adjustment, 0
    without one
    standard_deviation_m : of each marker's centre;  condition : of the reduced normal
    matrix, 1 without one
    """

    world_from_marker: dict[str, Pose]
    unmapped: tuple[str, ...] = ()
    frames: int = 0
    rms_px: float = 0.0
    standard_deviation_m: Mapping[str, float] | None = None
    condition: float = 1.0

    def to_json(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "rms_px": self.rms_px,
            "condition": self.condition if np.isfinite(self.condition) else None,
            "unmapped": list(self.unmapped),
            "sd_m": dict(self.standard_deviation_m or {}),
        }


def map_markers(frames: Sequence[Sequence[View]], keys: Sequence[str]) -> MarkerMap:
    """frames : the markers of each frame;  keys : configured order."""
    present = [k for k in keys if any(v.key == k for views in frames for v in views)]
    if not present:
        return MarkerMap({})
    together = [f for f in ({v.key: v for v in views} for views in frames) if len(f) > 1]
    start = _spanning_tree(together, present)
    unmapped = tuple(k for k in present if k not in start)
    if len(start) == 1:
        return MarkerMap(start, unmapped)
    shared = [f for f in together if sum(k in start for k in f) > 1]
    chosen = _evenly(shared, MAX_FRAMES)
    for key in start:
        if not any(key in f for f in chosen):
            chosen += _evenly([f for f in shared if key in f], _FEW)
    return _adjust([[*f.values()] for f in chosen], start, unmapped)


def _evenly(items: Sequence[T], most: int) -> list[T]:
    at = np.linspace(0, len(items) - 1, most).round().astype(int)
    return [items[k] for k in np.unique(at)]


def _spanning_tree(together: list[dict[str, View]], present: list[str]) -> dict[str, Pose]:
    """Grow the map from the first marker along the pairs that agree best."""

    @cache
    def edge(a: str, b: str) -> tuple[float, Pose]:
        return _relative_pose([f for f in together if a in f and b in f], a, b)

    out = {present[0]: Pose.identity()}
    while True:
        ends = ((edge(a, b)[0], a, b) for a in out for b in present if b not in out)
        misfit, a, b = min(ends, default=(np.inf, "", ""))
        if misfit == np.inf:
            return out
        out[b] = out[a] @ edge(a, b)[1]


def _relative_pose(frames: list[dict[str, View]], a: str, b: str) -> tuple[float, Pose]:
    """(misfit, pose of b in a): the candidate under which b's corners fit best in the other
    frames, medians of px.

    The misfit is divided by the root of the number of frames, so that a pair often seen
    together is preferred."""
    if not frames:
        return np.inf, Pose.identity()
    candidates = [
        pa.inverse() @ pb
        for f in _evenly(frames, _VOTERS)
        for pa in f[a].solutions
        for pb in f[b].solutions
    ]
    # every solution of a, in every frame, with every candidate
    judges = _evenly(frames, _JUDGES)
    count = np.array([len(f[a].solutions) for f in judges])
    rotation, translation = stack([p for f in judges for p in f[a].solutions])
    turn, shift = stack(candidates)
    moved = (rotation[:, None] @ shift[..., None])[..., 0] + translation[:, None]
    seen = observe([[f[b]] for f in judges], {b: Pose.identity()}, [b])
    seen = seen.take(np.repeat(np.arange(len(judges)), count * len(candidates)))
    turned = (rotation[:, None] @ turn).reshape(-1, 3, 3)
    missed = rms_px(residuals(turned, moved.reshape(-1, 3), seen), seen.weight)
    error = np.minimum.reduceat(
        missed.reshape(-1, len(candidates)), np.cumsum(count) - count
    )
    typical = np.median(error, axis=0)
    best = int(typical.argmin())
    return float(typical[best] / np.sqrt(len(frames))), candidates[best]


def camera_poses(
    views: Iterable[View], world_from_marker: Mapping[str, Pose]
) -> list[Pose]:
    """camera_from_world by each planar solution of each mapped marker."""
    return [
        p @ world_from_marker[v.key].inverse()
        for v in views
        if v.key in world_from_marker
        for p in v.solutions
    ]


def _adjust(
    frames: list[list[View]], start: dict[str, Pose], unmapped: tuple[str, ...]
) -> MarkerMap:
    """Gauss-Newton. What a frame's own pose explains of its corners is projected out (QR);
    the rest is for the map."""
    from scipy.linalg import block_diag

    keys = list(start)
    n, m = len(frames), len(keys)
    corners_m = {v.key: v.seen.points_m for views in frames for v in views}
    local = np.stack([corners_m.get(k, np.zeros((4, 3))) for k in keys])
    seen = observe(frames, start, keys)
    first = []
    for k, views in enumerate(
        frames
    ):  # from the planar solution that fits all its markers best
        candidates = camera_poses(views, start)
        one = seen.take(np.full(len(candidates), k))
        misfit, _ = huber_cost(residuals(*stack(candidates), one), one.weight)
        first.append(candidates[int(misfit.argmin())])
    rotation, translation, _ = refine_poses(*stack(first), seen)
    map_r, map_t = stack([*start.values()])
    cost = np.inf
    for _ in range(30):
        world = (local @ np.swapaxes(map_r, 1, 2) + map_t[:, None]).reshape(1, -1, 3)
        seen = seen._replace(points_m=np.broadcast_to(world, seen.points_m.shape))
        r = residuals(rotation, translation, seen)
        rho, factor = huber_cost(r, seen.weight)
        before, cost = cost, float(rho.sum())
        if abs(before - cost) < 1e-10 * (1 + cost):
            break
        root = np.sqrt(seen.weight * factor)[..., None]
        frame_j = jacobian(rotation, translation, seen)
        # px per left perturbation, in world axes, of the marker that carries the corner
        lever = np.concatenate(
            [-skew(world), np.broadcast_to(np.eye(3), (*world.shape, 3))], -1
        )
        map_j = frame_j[..., 3:] @ rotation[:, None] @ lever
        own, upper = np.linalg.qr((frame_j * root[..., None]).reshape(n, -1, 6))
        of_map = (map_j * root[..., None]).reshape(n, m, 8, 6)
        own, missed = own.reshape(n, m, 8, 6), (r * root).reshape(n, m, 8)
        shared = np.einsum("nmai,nmaj->nimj", own, of_map).reshape(6 * n, 6 * m)
        explained = np.einsum("nmai,nma->ni", own, missed).ravel()
        normal = (
            block_diag(*np.einsum("nmai,nmaj->mij", of_map, of_map)) - shared.T @ shared
        )
        right = np.einsum("nmai,nma->mi", of_map, missed).ravel() - shared.T @ explained
        reduced = normal[6:, 6:]  # the first marker is the world: it stays
        step = np.append(np.zeros(6), -np.linalg.solve(reduced, right[6:]))
        frame_step = -np.linalg.solve(upper, (explained + shared @ step).reshape(n, 6, 1))
        map_r, map_t = apply_step(map_r, map_t, step.reshape(m, 6))
        rotation, translation = apply_step(rotation, translation, frame_step[..., 0])
    rms = float(np.sqrt(np.mean(rms_px(r, seen.weight) ** 2)))
    # a centre moves by rotation x centre + translation of the left perturbation
    lever = np.concatenate([-skew(map_t), np.tile(np.eye(3), (m, 1, 1))], 2)
    covariance = np.linalg.pinv(reduced).reshape(m - 1, 6, m - 1, 6)
    square = np.einsum("iaj,ijik,iak->i", lever[1:], covariance, lever[1:])
    spread = dict(zip(keys, [0.0, *np.sqrt(np.maximum(square, 0)).tolist()], strict=True))
    poses = {k: Pose(map_r[i], map_t[i]) for i, k in enumerate(keys)}
    return MarkerMap(poses, unmapped, n, rms, spread, condition(reduced))


def observe(
    frames: Sequence[Iterable[View]],
    world_from_marker: Mapping[str, Pose],
    keys: Sequence[str],
) -> Observed:
    """The corners of these markers, four places per key."""
    n, m = len(frames), max(len(keys), 1)
    out = Observed(*(np.zeros((n, m, 4, *s)) for s in ((3,), (2,), (2, 2), ())))
    for k, views in enumerate(frames):
        for v in views:
            if v.key in keys:
                at = k, keys.index(v.key)
                for whole, one in zip(out, v.seen, strict=True):
                    whole[at] = one
                out.points_m[at] = world_from_marker[v.key].apply(v.seen.points_m)
    return Observed(*(a.reshape(n, 4 * m, *a.shape[3:]) for a in out))
