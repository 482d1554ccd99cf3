"""Which of camera and marker stands still, from picture corners that are followed from one
snapshot of the clip to another.

Corners are taken twice, from the reduced picture and from its contrast against the
neighbourhood, which a change of light leaves, and followed there and back (Lucas, Kanade).
With markers: corners outside of them, over about a third of a second. Without: those of the
first picture in later ones.
Source: docs/methods/pose.md#rest."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.even_frames import EvenFrames
from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.search import Sighting
from arfx.analyse.markers.texture import even_contrast, local_contrast
from arfx.analyse.markers.texture import follow as follow_points
from arfx.core.camera import Camera
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.rect import Rect

WIDTH_PX = 320  # of the reduced image
INTERVAL_S = 0.33
# about so many are taken, evenly over the clip: memory does not grow with it
MAX_SAMPLES, MAX_PICTURES = 120, 240
POINTS = 40
LEAST_DEPTH_M = 0.1  # nothing filmed stands closer
NEAREST = (
    1 / 3
)  # of the marker's distance: nothing before that is taken for background
# of a point's way by which it may be missed: the patch around it is seen from elsewhere
DRIFT = 0.02
# neighbourhood that contrast is compared with, and grey levels of contrast that are noise
NEAR_PX, FLAT = 17, 4.0
# in the reduced image, over INTERVAL_S: tracking noise of a still clip is about .05 to .15;
# and since the first picture: light and compression move corners by more
STILL_PX, REST_PX = 0.35, 0.6
# share of points that rest, or move along with the marker's world: moving shadows and what a
# hand moves beside the marker are the others
AT_REST, ALONG = 0.45, 0.6
_BACK_PX = 0.3  # from its start, in the reduced image: a corner that came back
_MIN_POINTS = 6


class RestPicture(NamedTuple):
    """A reduced picture. frame : its number;  luma : (h, w) uint8;  pixel_px : clip px in one
    of its own"""

    frame: int
    luma: ndarray
    pixel_px: int


def snapshot(frame: AnalysisFrame) -> RestPicture:
    height, width = frame.luma.shape
    factor = max(1, width // WIDTH_PX)
    size = width // factor, height // factor
    small = cv2.resize(frame.luma, size, interpolation=cv2.INTER_AREA)
    return RestPicture(frame.index, small, factor)


def follow(
    first: RestPicture, second: RestPicture, where: ndarray
) -> tuple[ndarray, ndarray]:
    """Places (n, 2), (n, 2) of the first one's corners in both, clip px; NaN in the second
    where they are lost. where : (h, w) bool, none are taken elsewhere
    """
    places, mask = [np.zeros((0, 2, 2))], where.astype(np.uint8)
    evened = (even_contrast(picture.luma, NEAR_PX) for picture in (first, second))
    for before, now in ((first.luma, second.luma), evened):
        points = cv2.goodFeaturesToTrack(before, POINTS, 0.02, 8, mask=mask)
        if points is None or len(points) < _MIN_POINTS:
            continue
        there, missed = follow_points(before, now, points, 3, 11, 30, 0.01)
        there = np.where(missed[:, None, None] < _BACK_PX, there, np.nan)
        places.append(np.concatenate([points, there], 1))
    here, there = (np.concatenate(places).swapaxes(0, 1) + 0.5) * first.pixel_px - 0.5
    return here, there


@dataclass(frozen=True, eq=False)
class FlowSample:
    """Corners that were followed. index : number of the first frame;  frames : by so many
    the second one is later
    pixel_px : of the reduced image, clip px;  here, there : (n, 2) px of the clip"""

    index: int
    frames: int
    pixel_px: int
    here: ndarray
    there: ndarray


class BackgroundFlow:
    """Follows corners of the background. frames : of the clip, about"""

    def __init__(self, frames: int) -> None:
        self.rows: list[FlowSample] = []
        self._before: tuple[RestPicture, ndarray] | None = None
        self._time_s = -np.inf
        self._even = EvenFrames(frames, MAX_SAMPLES, 0.0)

    def step(self, frame: AnalysisFrame, shown: Sequence[Sighting]) -> None:
        if frame.time_s - self._time_s < INTERVAL_S:
            return
        before, self._before = self._before, None
        self._time_s = frame.time_s if shown else -np.inf
        first = bool(shown) and self._even.due(frame.index, frame.time_s)
        if not first and before is None:
            return
        now = snapshot(frame)
        if first:
            self._before = now, _beside(shown, now)
        if before is not None:
            places = np.stack(follow(before[0], now, before[1]))
            here, there = places[:, np.isfinite(places).all((0, 2))].round(3)
            if len(here) >= _MIN_POINTS:
                number = before[0].frame
                row = FlowSample(
                    number, now.frame - number, now.pixel_px, here, there
                )
                self.rows.append(row)


def _beside(shown: Sequence[Sighting], picture: RestPicture) -> ndarray:
    """(h, w) bool, where no print is, nor near one."""
    out, factor = np.ones(picture.luma.shape, bool), picture.pixel_px
    for s in shown:
        r = Rect.around(s.print.corners_px)
        r = r.pad(max(r.width, r.height) // 3)
        rows = slice(max(r.y0 // factor, 0), r.y1 // factor + 1)
        out[rows, max(r.x0 // factor, 0) : r.x1 // factor + 1] = False
    return out


def decide_static(
    samples: Sequence[FlowSample],
    camera_from_world: Mapping[int, Pose],
    camera: Camera,
) -> str:
    """ "camera", "marker", or "both" move: that too where nothing is known to stand still.

    samples : of BackgroundFlow;  camera_from_world : smoothed poses by frame"""
    rest, along = (
        [],
        [],
    )  # shares of the points: at rest, moving with the marker's world
    for s in samples:
        a, b = (camera_from_world.get(k) for k in (s.index, s.index + s.frames))
        if a is None or b is None:
            continue
        from_, to = camera.normalised(np.stack([s.here, s.there]))
        still, way = STILL_PX * s.pixel_px, np.linalg.norm(s.there - s.here, axis=1)
        nearest_m = NEAREST * float(b.translation_m[2])
        missed = epipolar_distance(from_, to, b @ a.inverse(), nearest_m)
        rest.append((way < still).mean())
        along.append((camera.fx * missed < 2 * still + DRIFT * way).mean())
    if rest and np.mean(rest) > AT_REST:
        return "camera"
    return "marker" if along and np.mean(along) > ALONG else "both"


def epipolar_distance(
    a: ndarray, b: ndarray, b_from_a: Pose, nearest_m: float
) -> ndarray:
    """(n,) from b to the segment on which a point seen at a lies in the second picture,
    `nearest_m` to infinite depth.

    a, b : (n, 2) ideal normalised coordinates;  b_from_a : motion of the camera frame. inf
    where there is no direction.
    """
    far = np.pad(a, ((0, 0), (0, 1)), constant_values=1.0) @ b_from_a.rotation.T
    near = far + b_from_a.translation_m / max(nearest_m, LEAST_DEPTH_M)
    p, q = (divide(v[:, :2], v[:, 2:], where_zero=np.nan) for v in (far, near))
    d = q - p
    t = np.clip(divide(((b - p) * d).sum(1), (d * d).sum(1)), 0, 1)
    distance = np.linalg.norm(b - p - t[:, None] * d, axis=1)
    return np.where(np.isfinite(distance), distance, np.inf)


class RestCheck:
    """Keeps pictures of the whole clip. frames : of it, about"""

    def __init__(self, frames: int) -> None:
        self.rows: list[RestPicture] = []
        self._even = EvenFrames(frames, MAX_PICTURES, INTERVAL_S)

    def step(self, frame: AnalysisFrame, _: Sequence[Sighting] = ()) -> None:
        if self._even.due(frame.index, frame.time_s):
            self.rows.append(snapshot(frame))


def rests(pictures: Sequence[RestPicture]) -> tuple[bool, float]:
    """(whether the camera stands still, the farthest that the middle corner was seen from its
    place in the first picture, clip px)."""
    first = pictures[0]
    # corners that stand out of noise
    where = local_contrast(first.luma, NEAR_PX)[1] > FLAT
    still, farthest_px = True, 0.0
    for now in pictures[1:]:
        here, there = follow(first, now, where)
        away = np.linalg.norm(there - here, axis=1)
        # a corner that is lost may have left the picture; without any nothing could tell
        if len(away):
            still &= bool((away < REST_PX * now.pixel_px).mean() > AT_REST)
        if np.isfinite(away).any():
            farthest_px = max(farthest_px, float(np.nanmedian(away)))
    return still, farthest_px
