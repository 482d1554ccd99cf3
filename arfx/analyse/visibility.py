"""Where in each frame the model can be seen, and how much its place in the picture trembles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene

_HULL_POINTS = 400  # above this many vertices their convex hull is taken once: it projects to the same box


def with_model(facts: Sequence[FrameFacts], scene: Scene, camera: Camera | None = None) -> tuple[FrameFacts, ...]:
    """The facts with `model_box` and `depth_range_m` filled in.

    scene : holds the model and its place;  camera : in place of the scene's, if given
    model_box covers the projection of every vertex with a pixel to spare, clipped to the frame; EMPTY where the model is
    out of view. A model that reaches behind the camera may cover the whole frame.
    """
    camera = camera or scene.camera
    points = _outline(scene.model_points_m)
    out = []
    for f in facts:
        if f.camera_from_world is None:
            out.append(f.with_(model_box=EMPTY, depth_range_m=(0.0, 0.0)))
            continue
        box, depth = _seen_box(f.camera_from_world.apply(points), camera)
        out.append(f.with_(model_box=box, depth_range_m=depth))
    return tuple(out)


def corner_jitter_px(facts: Sequence[FrameFacts], points_m: np.ndarray, camera: Camera, raw: bool) -> dict[str, float]:
    """Trembling of projected points: length of the second difference over three successive frames, px.

    points_m : (n, 3) world, for instance scene.model_corners_m;  raw : of the poses before smoothing
    "relative" figures are of the place relative to the centre of the markers as they were measured: what is left of the
    trembling once the footage's own motion, which the object has to follow, is taken out.
    Only unbroken triples of one shot in which raw and smoothed poses both exist and the frames are evenly spaced (to 20 %).
    Returns {"median", "p95", "rms", "relative_median", "relative_rms", "triples"}; zeros without a triple.
    """
    rows, relative = [], []
    for three in zip(facts, facts[1:], facts[2:], strict=False):
        a, b, c = three
        if any(f.camera_from_world is None or f.raw_camera_from_world is None or f.shot != a.shot for f in three):
            continue
        first, second = b.time_s - a.time_s, c.time_s - b.time_s
        if abs(first - second) > 0.2 * max(first, second):
            continue
        place = [camera.project(_pose(f, raw).apply(points_m)) for f in three]
        d = np.linalg.norm(place[0] - 2 * place[1] + place[2], axis=-1)
        keys = set.intersection(*({m.key for m in f.markers} for f in three))
        if not np.isfinite(d).any() or not keys:
            continue
        rows.append(float(np.sqrt(np.nanmean(d * d))))
        centre = [np.mean([m.corners_px for m in f.markers if m.key in keys], axis=(0, 1)) for f in three]
        d = np.linalg.norm(place[0] - 2 * place[1] + place[2] - (centre[0] - 2 * centre[1] + centre[2]), axis=-1)
        relative.append(float(np.sqrt(np.nanmean(d * d))))
    if not rows:
        return {"median": 0.0, "p95": 0.0, "rms": 0.0, "relative_median": 0.0, "relative_rms": 0.0, "triples": 0}
    r, s = np.array(rows), np.array(relative)
    return {
        "median": float(np.median(r)), "p95": float(np.quantile(r, 0.95)), "rms": float(np.sqrt((r * r).mean())),
        "relative_median": float(np.median(s)), "relative_rms": float(np.sqrt((s * s).mean())), "triples": len(r),
    }  # fmt: skip


def _pose(f: FrameFacts, raw: bool) -> Pose:
    pose = f.raw_camera_from_world if raw else f.camera_from_world
    assert pose is not None
    return pose


def _outline(points: np.ndarray) -> np.ndarray:
    """Vertices of the convex hull; the points themselves where they are few or flat."""
    if len(points) <= _HULL_POINTS:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all in one plane or line: no volume, and no need
        return points


def _seen_box(q: np.ndarray, camera: Camera) -> tuple[Rect, tuple[float, float]]:
    """Box and depth range of points (n, 3) in camera coordinates."""
    ahead = q[:, 2] > EPS_DEPTH_M
    if not ahead.any():
        return EMPTY, (0.0, 0.0)
    px = camera.project(q)
    good = np.isfinite(px).all(1) if not np.isfinite(px).all() else np.ones(len(px), bool)
    box = Rect.around(px, 1.0)
    if not good.all():
        # behind the camera or beyond the lens's fold: such a point says nothing about where the surface between it and
        # a visible one ends, so the frame bounds it. If none is visible the model is out of view or around the camera.
        box = camera.rect if good.any() or (~ahead).any() else EMPTY
    box = box.clip(camera.rect)
    depth = q[ahead, 2]
    return box, (0.0, 0.0) if box.empty else (float(depth.min()), float(depth.max()))
