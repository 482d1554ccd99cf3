"""Which of camera and marker stands still, from picture corners outside the markers,
followed over about a third of a second.

Corners are taken twice, from the image and from its contrast against the neighbourhood,
which a change of light leaves. Where there is no marker, `RestCheck` looks for the first
picture's corners in later ones, about 2 ms each time.
Source: docs/methods/pose.md#rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.rect import Rect

WIDTH_PX = 320  # of the reduced image
INTERVAL_S = 0.33
MAX_SAMPLES = (
    120  # about so many are taken, evenly over the clip: memory does not grow with it
)
POINTS = 40
LEAST_DEPTH_M = 0.1  # nothing filmed stands closer
NEAREST = 1 / 3  # of the marker's distance: nothing before that is taken for background
# of a point's way by which it may be missed: the patch around it is seen from elsewhere
DRIFT = 0.02
NEAR_PX, FLAT = (
    17,
    4.0,
)  # neighbourhood that contrast is compared with, and grey levels of contrast that are noise
# in the reduced image, over INTERVAL_S; tracking noise of a still clip is about .05 to .15
STILL_PX = 0.35
# share of points: moving shadows and what a hand moves beside the marker are the others
AT_REST = 0.45
_MIN_POINTS = 6
REST_WIDTH_PX = 480  # of the reduced pictures of `RestCheck`
REST_POINTS = 80
REST_PX = 0.7  # in a reduced picture: sensor noise and compression move corners by a tenth
REST_FRACTION = 0.6  # of the corners that have to stay
_LEAST_POINTS = 8
_WINDOW_PX, _NOISE = (
    15,
    5.0,
)  # neighbourhood of a corner, and grey levels of contrast in it that noise alone makes


@dataclass(frozen=True, eq=False)
class FlowSample:
    """Corners that were followed. index : number of the first frame;  frames : by so many
    the second one is later
    pixel_px : of the reduced image, clip px;  here, there : (n, 2) px of the clip"""

    index: int
    frames: int
    pixel_px: int
    here: np.ndarray
    there: np.ndarray


class BackgroundFlow:
    """Collects corner flow: pairs of frames with matched points. length_s : of all frames"""

    def __init__(self, length_s: float = 0.0) -> None:
        self._image: np.ndarray | None = None
        self._points = [
            np.zeros((0, 2), np.float32)
        ] * 2  # in the image itself, and in the evened one
        self._index, self._time_s = 0, -np.inf
        self._stride = max(int(np.ceil(length_s / INTERVAL_S / MAX_SAMPLES)), 1)
        self.samples: list[FlowSample] = []

    def step(
        self,
        index: int,
        time_s: float,
        luma: np.ndarray,
        markers: Iterable[Rect],
        fresh: bool,
    ) -> None:
        """markers : rectangles that hold configured or other markers;  fresh : a marker was
        measured in this frame.
        """
        since = time_s - self._time_s
        if since < INTERVAL_S:
            return
        recent = (
            self._image is not None
            and since < 3 * INTERVAL_S
            and max(map(len, self._points)) >= _MIN_POINTS
        )
        factor = max(1, luma.shape[1] // WIDTH_PX)
        small = _reduced(luma, factor) if fresh or recent else luma
        if recent:
            self._follow(index, small, factor)
        self._image, self._time_s = None, time_s if fresh else -np.inf
        if not fresh or int(time_s / INTERVAL_S) % self._stride:
            return
        mask = np.full(small.shape, 255, np.uint8)
        for r in markers:
            r = r.pad(max(r.width, r.height) // 3)
            rows = slice(max(r.y0 // factor, 0), r.y1 // factor + 1)
            mask[rows, max(r.x0 // factor, 0) : r.x1 // factor + 1] = 0
        self._points = [
            _corners(view, POINTS, mask) for view in (small, _local_contrast(small))
        ]
        self._image, self._index = small, index

    def _follow(self, index: int, small: np.ndarray, factor: int) -> None:
        assert self._image is not None
        from_, to = [], []
        views = (self._image, small), (_local_contrast(self._image), _local_contrast(small))
        for points, (before, now) in zip(self._points, views, strict=True):
            if len(points) < _MIN_POINTS:
                continue
            options = {"winSize": (11, 11), "maxLevel": 3}
            there, good, _ = cv2.calcOpticalFlowPyrLK(before, now, points, None, **options)  # type: ignore[call-overload]
            back, good_back, _ = cv2.calcOpticalFlowPyrLK(
                now, before, there, None, **options
            )  # type: ignore[call-overload]
            # which of them lead back to where they came from
            keep = (
                (good.ravel() > 0)
                & (good_back.ravel() > 0)
                & (np.linalg.norm(back - points, axis=1) < 0.3)
            )
            if keep.sum() >= _MIN_POINTS:
                from_.append(points[keep])
                to.append(there[keep])
        if not from_:
            return
        a, b = ((np.concatenate(p).astype(float) + 0.5) * factor - 0.5 for p in (from_, to))
        self.samples.append(
            FlowSample(self._index, index - self._index, factor, a.round(3), b.round(3))
        )


def _reduced(luma: np.ndarray, factor: int) -> np.ndarray:
    h, w = luma.shape
    return cv2.resize(luma, (w // factor, h // factor), interpolation=cv2.INTER_AREA)


def _corners(image: np.ndarray, most: int, mask: np.ndarray) -> np.ndarray:
    """(n, 2) float32"""
    found = cv2.goodFeaturesToTrack(image, most, 0.02, 8, mask=mask)
    return (
        np.zeros((0, 2), np.float32)
        if found is None
        else found.reshape(-1, 2).astype(np.float32)
    )


def _local_contrast(image: np.ndarray) -> np.ndarray:
    """(h, w) uint8 contrast against the neighbourhood: a change of light or exposure leaves
    it nearly as it was.
    """
    off, square = _contrast(image, NEAR_PX)
    size = np.sqrt(np.maximum(square, 0)) + FLAT
    return np.clip(128 + 48 * off / size, 0, 255).astype(np.uint8)


def _contrast(image: np.ndarray, window_px: int) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) float32 difference to the mean of the neighbourhood; mean square of that in it."""
    value, window = image.astype(np.float32), (window_px, window_px)
    off = value - cv2.blur(value, window)
    return off, cv2.blur(off * off, window)


def decide_static(
    samples: Sequence[FlowSample], camera_from_world: Mapping[int, Pose], camera: Camera
) -> tuple[str, dict[str, float]]:
    """("camera" | "marker" | "both", evidence).

    samples : BackgroundFlow.samples;  camera_from_world : smoothed poses by frame
    evidence : samples, share of background points at rest, share that move with the
    marker's world, marker_moves_px.
    Without evidence the answer is "both": nothing is known to stand still."""
    posed = [
        s for s in samples if {s.index, s.index + s.frames} <= camera_from_world.keys()
    ]
    told = []
    for s in posed:
        from_, to = camera.normalised(np.stack([s.here, s.there]))
        a, b = camera_from_world[s.index], camera_from_world[s.index + s.frames]
        still, way = STILL_PX * s.pixel_px, np.linalg.norm(s.there - s.here, axis=1)
        missed = camera.fx * epipolar_distance(
            from_, to, b @ a.inverse(), NEAREST * float(b.translation_m[2])
        )
        along = (missed < 2 * still + DRIFT * way).mean()
        moved = camera.project(np.stack([a.translation_m, b.translation_m]))
        told.append(((way < still).mean(), along, np.linalg.norm(np.diff(moved, axis=0))))
    rest, along, moves = np.array(told).reshape(-1, 3).T
    evidence = {
        "samples": float(len(told)),
        "at_rest": float(rest.mean()) if told else 0.0,
        "with_marker": float(along.mean()) if told else 0.0,
        "marker_moves_px": float(np.nanmedian(moves)) if np.isfinite(moves).any() else 0.0,
    }
    otherwise = "marker" if evidence["with_marker"] > 0.6 else "both"
    return ("camera" if evidence["at_rest"] > AT_REST else otherwise), evidence


def epipolar_distance(
    a: np.ndarray, b: np.ndarray, b_from_a: Pose, nearest_m: float
) -> np.ndarray:
    """(n,) from b to the segment on which a point seen at a lies in the second picture,
    `nearest_m` to infinite depth.

    a, b : (n, 2) ideal normalised coordinates;  b_from_a : motion of the camera frame. inf
    where there is no direction.
    """
    far = np.column_stack([a, np.ones(len(a))]) @ b_from_a.rotation.T
    near = far + b_from_a.translation_m / max(nearest_m, LEAST_DEPTH_M)
    p, q = (divide(v[:, :2], v[:, 2:], where_zero=np.nan) for v in (far, near))
    d = q - p
    t = np.clip(divide(((b - p) * d).sum(1), (d * d).sum(1)), 0, 1)
    distance = np.linalg.norm(b - p - t[:, None] * d, axis=1)
    return np.where(np.isfinite(distance), distance, np.inf)


class RestPicture(NamedTuple):
    """The first picture of a part of the clip. picture : (h, w) uint8, reduced;  points : (n,
    2) its corners;  factor : clip px in one of its own"""

    frame: int
    picture: np.ndarray
    points: np.ndarray
    factor: int


class RestMotion(NamedTuple):
    """How far the corners of a part's first picture were in a later one. moved_px : the
    middle one, clip px, 0 where none was found;  rests : whether they stay"""

    frame: int
    moved_px: float
    rests: bool


class RestCheck:
    """Fed the frames of a part of the clip in order."""

    def __init__(self) -> None:
        self.pictures: list[RestPicture] = []
        self.motions: list[RestMotion] = []
        self._next_s = -np.inf

    def step(self, index: int, time_s: float, luma: np.ndarray) -> None:
        """luma : (h, w) uint8"""
        if time_s < self._next_s:
            return
        self._next_s = time_s + INTERVAL_S
        factor = max(1, round(luma.shape[1] / REST_WIDTH_PX))
        small = _reduced(luma, factor)
        if self.pictures:
            self.motions += _motion(index, small, self.pictures[0])
            return
        mask = (_contrast(small, _WINDOW_PX)[1] > _NOISE**2).astype(np.uint8)
        points = _corners(small, REST_POINTS, mask)
        self.pictures.append(RestPicture(index, small, points, factor))


def rests(
    pictures: Sequence[RestPicture], motions: Sequence[RestMotion]
) -> tuple[bool, float]:
    """(whether the camera stands still, the farthest that the middle corner was seen from its
    place, clip px): of `RestCheck`, each part against its own first picture, and these against
    the clip's."""
    every = [*motions]
    for later in pictures[1:]:
        every += _motion(later.frame, later.picture, pictures[0])
    return all(m.rests for m in every), max((m.moved_px for m in every), default=0.0)


def _motion(index: int, small: np.ndarray, first: RestPicture) -> list[RestMotion]:
    """None where there is nothing to see: nothing that could tell of a motion."""
    if len(first.points) < _LEAST_POINTS:
        return []
    points = first.points
    there, good, _ = cv2.calcOpticalFlowPyrLK(first.picture, small, points, None)  # type: ignore[call-overload]
    away = np.linalg.norm(there - points, axis=1)
    away[good.ravel() == 0] = np.inf  # a corner that is lost may have left the picture
    seen = away[np.isfinite(away)]
    moved_px = first.factor * float(np.median(seen)) if len(seen) else 0.0
    return [RestMotion(index, moved_px, bool((away < REST_PX).mean() >= REST_FRACTION))]
