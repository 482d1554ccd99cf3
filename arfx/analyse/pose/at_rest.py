"""Which of camera and marker stands still, from picture corners that are followed from one
snapshot of the clip to another.

Corners are taken twice, from the reduced picture and from its contrast against the
neighbourhood, which a change of light leaves, and followed there and back (Lucas, Kanade).
With markers: corners outside of them, over about a third of a second. Without: those of the
first picture in later ones.
Source: docs/methods/pose.md#rest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

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
MAX_SAMPLES = (
    120  # about so many are taken, evenly over the clip: memory does not grow with it
)
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
# share of points: moving shadows and what a hand moves beside the marker are the others
AT_REST = 0.45
_BACK_PX = 0.3  # from its start, in the reduced image: a corner that came back
_MIN_POINTS = 6


class Snapshot(NamedTuple):
    """A reduced picture. frame : its number;  luma : (h, w) uint8
    corners : (h, w) uint8, 0 where none is taken;  pixel_px : clip px in one of its own"""

    frame: int
    luma: ndarray
    corners: ndarray
    pixel_px: int


def snapshot(frame: AnalysisFrame, markers: Iterable[Rect] | None = None) -> Snapshot:
    """markers : no corners there; without them those that stand out of noise are taken"""
    height, width = frame.luma.shape
    factor = max(1, width // WIDTH_PX)
    size = width // factor, height // factor
    small = cv2.resize(frame.luma, size, interpolation=cv2.INTER_AREA)
    rough = markers is not None or local_contrast(small, NEAR_PX)[1] > FLAT
    corners = np.full(small.shape, rough, np.uint8)
    for r in markers or ():
        r = r.pad(max(r.width, r.height) // 3)
        rows = slice(max(r.y0 // factor, 0), r.y1 // factor + 1)
        corners[rows, max(r.x0 // factor, 0) : r.x1 // factor + 1] = 0
    return Snapshot(frame.index, small, corners, factor)


def follow(first: Snapshot, second: Snapshot) -> tuple[ndarray, ndarray]:
    """Places (n, 2), (n, 2) of the first one's corners in both, clip px; NaN in the second
    where they are lost.
    """
    places = [np.zeros((0, 2, 2))]
    evened = (even_contrast(picture.luma, NEAR_PX) for picture in (first, second))
    for before, now in ((first.luma, second.luma), evened):
        points = cv2.goodFeaturesToTrack(before, POINTS, 0.02, 8, mask=first.corners)
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

    tables: ClassVar[Mapping[str, type]] = {"background": FlowSample}

    def __init__(self, frames: int) -> None:
        self.background: list[FlowSample] = []
        self._before: Snapshot | None = None
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
        now = snapshot(frame, [Rect.around(s.print.corners_px) for s in shown])
        self._before = now if first else None
        if before is not None:
            places = np.stack(follow(before, now))
            here, there = places[:, np.isfinite(places).all((0, 2))].round(3)
            if len(here) >= _MIN_POINTS:
                later = now.frame - before.frame
                row = FlowSample(before.frame, later, now.pixel_px, here, there)
                self.background.append(row)


def decide_static(
    samples: Sequence[FlowSample],
    camera_from_world: Mapping[int, Pose],
    camera: Camera,
) -> tuple[str, dict[str, float]]:
    """("camera" | "marker" | "both", evidence).

    samples : of BackgroundFlow;  camera_from_world : smoothed poses by frame
    evidence : samples, share of background points at rest, share that move with the
    marker's world, marker_moves_px.
    Without evidence the answer is "both": nothing is known to stand still."""
    posed = [
        s
        for s in samples
        if {s.index, s.index + s.frames} <= camera_from_world.keys()
    ]
    shares = list[Any]()
    for s in posed:
        from_, to = camera.normalised(np.stack([s.here, s.there]))
        a, b = camera_from_world[s.index], camera_from_world[s.index + s.frames]
        still, way = STILL_PX * s.pixel_px, np.linalg.norm(s.there - s.here, axis=1)
        missed = camera.fx * epipolar_distance(
            from_, to, b @ a.inverse(), NEAREST * float(b.translation_m[2])
        )
        along = (missed < 2 * still + DRIFT * way).mean()
        moved = camera.project(np.stack([a.translation_m, b.translation_m]))
        shares.append(
            ((way < still).mean(), along, np.linalg.norm(np.diff(moved, axis=0)))
        )
    rest, along, moves = np.array(shares or [(0.0, 0.0, np.nan)]).T
    evidence = {
        "samples": float(len(shares)),
        "at_rest": float(rest.mean()),
        "with_marker": float(along.mean()),
        "marker_moves_px": float(np.nanmedian(moves))
        if np.isfinite(moves).any()
        else 0.0,
    }
    otherwise = "marker" if evidence["with_marker"] > 0.6 else "both"
    return ("camera" if evidence["at_rest"] > AT_REST else otherwise), evidence


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


class RestMotion(NamedTuple):
    """How far the corners of a part's first picture were in a later one. moved_px : the
    middle one, clip px, 0 where none was found;  rests : whether they stay"""

    frame: int
    moved_px: float
    rests: bool


class RestCheck:
    """Compares pictures of a part of the clip with its first one."""

    tables: ClassVar[Mapping[str, type]] = {
        "rest_pictures": Snapshot,
        "rest_motions": RestMotion,
    }

    def __init__(self) -> None:
        self.rest_pictures: list[Snapshot] = []
        self.rest_motions: list[RestMotion] = []
        self._next_s = -np.inf

    def step(self, frame: AnalysisFrame, _: Sequence[Sighting] = ()) -> None:
        if frame.time_s < self._next_s:
            return
        self._next_s = frame.time_s + INTERVAL_S
        now = snapshot(frame)
        if self.rest_pictures:
            self.rest_motions.append(_motion(self.rest_pictures[0], now))
        else:
            self.rest_pictures.append(now)


def rests(
    pictures: Sequence[Snapshot], motions: Sequence[RestMotion]
) -> tuple[bool, float]:
    """(whether the camera stands still, the farthest that the middle corner was seen from its
    place, clip px): of `RestCheck`, each part against its own first picture, and these against
    the clip's."""
    every = [*motions, *(_motion(pictures[0], later) for later in pictures[1:])]
    return all(m.rests for m in every), max((m.moved_px for m in every), default=0.0)


def _motion(first: Snapshot, now: Snapshot) -> RestMotion:
    here, there = follow(first, now)
    away = np.linalg.norm(there - here, axis=1)
    # a corner that is lost may have left the picture; without any nothing could tell
    near = away < REST_PX * now.pixel_px
    stays = not len(away) or bool(near.mean() > AT_REST)
    moved_px = float(np.nanmedian(away)) if np.isfinite(away).any() else 0.0
    return RestMotion(now.frame, moved_px, stays)
