"""When the object is there: measured frames, bridged gaps, absence and the fades at its
ends; where in each frame the model can be seen, and how much its position in the picture
jitters.

Source: docs/methods/pose.md#presence."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene

MIN_FRAMES = 3
FADE_S = 0.15  # in which the object fades in and out around an absence
# above this many vertices their convex hull is taken once: it projects to the same box
_HULL_POINTS = 400


def visible_intervals(
    measured: ndarray, shot: ndarray, times_s: ndarray, max_gap_s: float
) -> list[tuple[int, int]]:
    """Half-open ranges of frames in which the object is present: from one measured frame to
    another of the same shot, with no gap between two measured frames longer than max_gap_s
    beyond the clip's own frame distance."""
    on = np.flatnonzero(measured)
    a, b = on[:-1], on[1:]
    gap = (b > a + 1) & (times_s[b] - times_s[a] > max_gap_s)
    parts = np.split(on, np.flatnonzero(gap | (shot[a] != shot[b])) + 1)
    return [(int(p[0]), int(p[-1]) + 1) for p in parts if len(p)]


def without_flickers(
    present: Sequence[tuple[int, int]], measured: ndarray, shot: ndarray
) -> list[tuple[int, int]]:
    """The intervals without flickers: fewer than MIN_FRAMES measured frames with absence of
    the same shot on both sides.

    A square of texture that is misread as a marker lasts for a frame or two; an object that
    appears for as long would only flash."""
    n = len(measured)
    return [
        (a, b)
        for a, b in present
        if not (a > 0 and b < n and shot[a - 1] == shot[a] and shot[b] == shot[b - 1])
        or measured[a:b].sum() >= MIN_FRAMES
    ]


def opacities(
    present: Sequence[tuple[int, int]], shot: ndarray, times_s: ndarray
) -> ndarray:
    """(n,) 0..1: 1 inside a stretch, ramping over FADE_S from and to an absence in the same
    shot.

    At the ends of the clip and at cuts the object is there at once: nothing was absent before.
    """
    out = np.zeros(len(shot))
    for first, end in present:
        t, away_s = times_s[first:end], np.full(end - first, FADE_S)
        if first > 0 and shot[first - 1] == shot[first]:
            away_s = np.minimum(away_s, t - times_s[first - 1])
        if end < len(shot) and shot[end] == shot[end - 1]:
            away_s = np.minimum(away_s, times_s[end] - t)
        out[first:end] = away_s / FADE_S
    return out


def with_model(facts: Sequence[FrameFacts], scene: Scene) -> tuple[FrameFacts, ...]:
    """The facts with `model_box` and `depth_range_m` filled in.

    model_box covers the projection of every vertex with a pixel to spare, clipped to the
    frame; EMPTY where the model is out of view. A model that reaches behind the camera may
    cover the whole frame."""
    points = _outline(scene.model_points_m)
    out = []
    for f in facts:
        box, depth = EMPTY, (0.0, 0.0)
        if f.camera_from_world is not None:
            box, depth = _seen_box(f.camera_from_world.apply(points), scene.camera)
        out.append(f.with_(model_box=box, depth_range_m=depth))
    return tuple(out)


def jitter_px(
    facts: Sequence[FrameFacts], points_m: ndarray, camera: Camera, raw: bool
) -> tuple[ndarray, ndarray]:
    """(frames,) root mean square, px, of the second difference over three successive frames
    of points' place in the picture, and the same of their place relative to the centre of
    the markers as measured: there the footage's own motion, which the object has to follow,
    is taken out.

    points_m : (n, 3) world, for instance scene.model_corners_m;  raw : of the poses before
    smoothing
    NaN but for the middle of unbroken triples of one shot in which raw and smoothed poses
    both exist, with a marker that is in all three, and evenly spaced (to 20 %)."""
    position = {}
    for f in facts:
        smoothed, single = f.camera_from_world, f.raw_camera_from_world
        if smoothed is not None and single is not None:
            position[f.index] = camera.project(
                (single if raw else smoothed).apply(points_m)
            )
    moved, relative = np.full((2, len(facts)), np.nan)
    for k, three in enumerate(zip(facts, facts[1:], facts[2:], strict=False), 1):
        a, b, c = three
        if any(f.index not in position or f.shot != a.shot for f in three):
            continue
        first, second = b.time_s - a.time_s, c.time_s - b.time_s
        if abs(first - second) > 0.2 * max(first, second):
            continue
        bend = np.diff([position[f.index] for f in three], 2, axis=0)[0]
        keys = set.intersection(*({m.key for m in f.markers} for f in three))
        if not np.isfinite(bend).any() or not keys:
            continue
        centres = [
            np.mean([m.corners_px for m in f.markers if m.key in keys], axis=(0, 1))
            for f in three
        ]
        moved[k], relative[k] = _rms(bend), _rms(bend - np.diff(centres, 2, axis=0))
    return moved, relative


def _rms(offsets_px: ndarray) -> float:
    """Of the lengths of offsets (n, 2), those that are not known left out."""
    return float(np.sqrt(2 * np.nanmean(offsets_px * offsets_px)))


def _outline(points: ndarray) -> ndarray:
    """Vertices of the convex hull; the points themselves where they are few or flat."""
    if len(points) <= _HULL_POINTS:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        # moved by rounding (QJ), far below a pixel: else Qhull takes the square of points
        # on a circle
        return points[ConvexHull(points, qhull_options="QJ").vertices]
    except QhullError:  # all in one plane or line: no volume, and no need
        return points


def _seen_box(q: ndarray, camera: Camera) -> tuple[Rect, tuple[float, float]]:
    """Box and depth range of points (n, 3) in camera coordinates.

    A point behind the camera or beyond the lens's fold says nothing about where the
    surface between it and a visible one ends, so the frame bounds it. If none is visible
    the model is out of view or around the camera."""
    px, ahead = camera.project(q), q[:, 2] > EPS_DEPTH_M
    known = np.isfinite(px).all(1)
    box = camera.rect if known.any() or not ahead.all() else EMPTY
    if known.all():
        box = Rect.around(px, 1.0).clip(camera.rect)
    if box.empty or not ahead.any():
        return EMPTY, (0.0, 0.0)
    depth = q[ahead, 2]
    return box, (float(depth.min()), float(depth.max()))
