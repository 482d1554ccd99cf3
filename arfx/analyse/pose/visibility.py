"""Where in each frame the model can be seen, and how much its place in the picture trembles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.analyse.fold import Analysis, Fold
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene

_AT_ONCE = 1 << 13  # points that are projected at a time: they stay in the cache
_HULL_POINTS = 400  # above this many vertices their convex hull is taken once: it projects to the same box


class ModelBox(Fold):
    """Where the job's model is in the picture."""

    name = "object"
    needs = ("pose",)

    def finish(self, clip: Analysis) -> Analysis:
        return clip if self.job.scene is None else clip.adding(with_model(clip.facts, self.job.scene(clip)))


def with_model(facts: Sequence[FrameFacts], scene: Scene) -> tuple[FrameFacts, ...]:
    """The facts with `model_box` and `depth_range_m` filled in.

    model_box covers the projection of every vertex with a pixel to spare, clipped to the frame; EMPTY where the model is
    out of view. A model that reaches behind the camera may cover the whole frame.
    """
    points = _outline(scene.model_points_m)
    seen = [f for f in facts if f.camera_from_world is not None]
    places: list[tuple[Rect, tuple[float, float]]] = []
    step = max(_AT_ONCE // len(points), 1)
    for start in range(0, len(seen), step):
        places += _seen_boxes(_seen_from([f.camera_from_world for f in seen[start : start + step]], points), scene.camera)
    found = iter(places)
    nowhere = (EMPTY, (0.0, 0.0))
    out = []
    for f in facts:
        box, depth = nowhere if f.camera_from_world is None else next(found)
        out.append(f.with_(model_box=box, depth_range_m=depth))
    return tuple(out)


def trembling_px(facts: Sequence[FrameFacts], points_m: np.ndarray, camera: Camera, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """(frames,) root mean square, px, of the second difference over three successive frames of points' place in the picture,
    and the same of their place relative to the centre of the markers as measured: there the footage's own motion, which the
    object has to follow, is taken out.

    points_m : (n, 3) world, for instance scene.model_corners_m;  raw : of the poses before smoothing
    NaN but for the middle of unbroken triples of one shot in which raw and smoothed poses both exist, with a marker that is in
    all three, and evenly spaced (to 20 %).
    """
    posed = [f for f in facts if f.camera_from_world is not None and f.raw_camera_from_world is not None]
    projected = camera.project(_seen_from([f.raw_camera_from_world if raw else f.camera_from_world for f in posed], points_m))
    place = dict(zip((f.index for f in posed), projected, strict=True))
    moved, relative = np.full((2, len(facts)), np.nan)
    for k, three in enumerate(zip(facts, facts[1:], facts[2:], strict=False), 1):
        a, b, c = three
        if any(f.index not in place or f.shot != a.shot for f in three):
            continue
        first, second = b.time_s - a.time_s, c.time_s - b.time_s
        if abs(first - second) > 0.2 * max(first, second):
            continue
        bend = place[a.index] - 2 * place[b.index] + place[c.index]
        keys = set.intersection(*({m.key for m in f.markers} for f in three))
        if not np.isfinite(bend).any() or not keys:
            continue
        centre = [_centre(f, keys) for f in three]
        moved[k], relative[k] = _rms(bend), _rms(bend - (centre[0] - 2 * centre[1] + centre[2]))
    return moved, relative


def _rms(offsets_px: np.ndarray) -> float:
    """Of the lengths of offsets (n, 2), those that are not known left out."""
    return float(np.sqrt(2 * np.nanmean(offsets_px * offsets_px)))


def _centre(f: FrameFacts, keys: set[str]) -> np.ndarray:
    corners = [m.corners_px for m in f.markers if m.key in keys]
    return np.sum(corners, axis=(0, 1)) / (4 * len(corners))


def _seen_from(poses: Sequence[Pose | None], points_m: np.ndarray) -> np.ndarray:
    """(poses, n, 3) world points (n, 3) in the coordinates of every camera."""
    known = [p for p in poses if p is not None]
    if not known:
        return np.zeros((0, *np.shape(points_m)))
    out: np.ndarray = np.asarray(points_m) @ np.stack([p.rotation.T for p in known])
    out += np.stack([p.translation_m for p in known])[:, None]
    return out


def _outline(points: np.ndarray) -> np.ndarray:
    """Vertices of the convex hull; the points themselves where they are few or flat."""
    if len(points) <= _HULL_POINTS:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all in one plane or line: no volume, and no need
        return points


def _seen_boxes(q: np.ndarray, camera: Camera) -> list[tuple[Rect, tuple[float, float]]]:
    """Box and depth range of points (frames, n, 3) in camera coordinates, frame by frame."""
    px = camera.project(q)
    # column by column: many times as fast as over the middle axis; not numbers where one point is none
    low, high = (np.stack([edge(px[..., k], 1) for k in (0, 1)], 1) for edge in (np.min, np.max))
    finite_low, finite_high = np.isfinite(low).all(1), np.isfinite(high).all(1)
    near, far = q[..., 2].min(1), q[..., 2].max(1)
    out = []
    for k in range(len(q)):
        if not (finite_low[k] and finite_high[k]):
            out.append(_partly_seen(q[k], px[k], camera))
            continue
        box = Rect.around(np.stack([low[k], high[k]]), 1.0).clip(camera.rect)
        out.append((box, (0.0, 0.0) if box.empty else (float(near[k]), float(far[k]))))
    return out


def _partly_seen(q: np.ndarray, px: np.ndarray, camera: Camera) -> tuple[Rect, tuple[float, float]]:
    """Of one frame in which some points (n, 3) have no place px (n, 2) in the picture.

    Behind the camera or beyond the lens's fold: such a point says nothing about where the surface between it and a visible
    one ends, so the frame bounds it. If none is visible the model is out of view or around the camera.
    """
    ahead = q[:, 2] > EPS_DEPTH_M
    if not ahead.any():
        return EMPTY, (0.0, 0.0)
    box = camera.rect if np.isfinite(px).all(1).any() or (~ahead).any() else EMPTY
    depth = q[ahead, 2]
    return box, (0.0, 0.0) if box.empty else (float(depth.min()), float(depth.max()))
