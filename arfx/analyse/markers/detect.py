"""Finds printed markers of known families in a luma image, by OpenCV's ArucoDetector
without its corner refinement (corners.py).

OpenCV's relative thresholds are set to mean the same pixels in a part as in the whole
frame: a search of the part that holds a marker gives exactly the corners of a search of the
whole frame.
Cost: about 3 ms per 640x360 image and family, 7 to 10 ms at 720p, 10 to 20 ms at 1080p (two
threads).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.marker_codes import dictionary
from arfx.core.rect import Rect

# Families whose dictionary is a superset of others of the same size: enough to look for these.
SCANNED_FAMILIES = (
    "36h11",
    "4X4_1000",
    "5X5_1000",
    "6X6_1000",
    "7X7_1000",
    "ORIGINAL",
    "25h9",
    "36h10",
    "MIP_36h12",
    "16h5",
)

_REDUCED_WINDOW_PX = 9


class Candidate(NamedTuple):
    """A decoded marker. quad_px : (4, 2) whole-frame pixels, about 1 px accurate, order of
    MarkerSpec.corners_m.
    """

    family: str
    id: int
    quad_px: ndarray

    @property
    def key(self) -> str:
        return f"{self.family}:{self.id}"

    @property
    def side_px(self) -> float:
        return float(sides(self.quad_px).mean())


class Detection(NamedTuple):
    """One marker print in one frame, refined.

    corners_px : (4, 2);  sigma_px : predicted standard deviation of a coordinate, without
    misplaced_px
    blur_px : nan where unknown;  misplaced_px : by how much the cells between contradict
    the corners, root mean square
    misfit_px : of a pictured print, how far its texture lies from that of a flat print
    """

    key: str
    corners_px: ndarray
    sigma_px: float
    blur_px: float
    inverted: bool
    misplaced_px: float = 0.0
    misfit_px: float = 0.0

    @property
    def quad_px(self) -> ndarray:
        return self.corners_px

    @property
    def side_px(self) -> float:
        return float(sides(self.corners_px).mean())


@dataclass(frozen=True, eq=False)
class Record:
    """One frame.

    duplicates : further prints with a key that is in `detections` too
    thumbnail : (18, 32) uint8, the whole picture
    """

    index: int
    time_s: float
    detections: tuple[Detection, ...]
    duplicates: tuple[Detection, ...]
    whole: bool
    thumbnail: ndarray


def sides(quads: ndarray) -> ndarray:
    """(..., 4) lengths of the sides of quads (..., 4, 2), from corner k to k + 1."""
    return np.linalg.norm(np.roll(quads, -1, -2) - quads, axis=-1)


@dataclass
class MarkerDetector:
    """One detector for a set of families: squares are looked for once. min_side_px : smaller
    ones are left out;  inverted : white on black is looked for too"""

    families: Iterable[str]
    min_side_px: float = 9.0
    inverted: bool = True

    def search(
        self,
        luma: ndarray,
        rect: Rect | None = None,
        factor: int = 1,
        min_side_px: float = 0.0,
    ) -> list[Candidate]:
        """All markers of the families, in a deterministic order.

        luma : (h, w) uint8;  rect : part of it to search;  factor : search an image reduced
        by this whole number
        min_side_px : leave out what is smaller (of the image searched), beside what the
        detector leaves out anyway
        """
        whole = Rect.of(luma.shape[1], luma.shape[0])
        area = whole if rect is None else rect.clip(whole)
        if min(area.width, area.height) < 8:
            return []
        image = np.ascontiguousarray(luma[area.slices])
        if factor > 1:
            size = area.width // factor, area.height // factor
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        options = cv2.aruco.DetectorParameters()
        options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        options.detectInvertedMarker = self.inverted
        options.minDistanceToBorder = 1
        if factor > 1:
            # A reduced image is searched to see whether there is something at all: one
            # threshold window finds the same markers as OpenCV's three (3, 13, 23 px) on
            # every real test clip, in less than half of the time.
            options.adaptiveThreshWinSizeMin = _REDUCED_WINDOW_PX
            options.adaptiveThreshWinSizeMax = _REDUCED_WINDOW_PX
        least_px = max(self.min_side_px, min_side_px)
        options.minMarkerPerimeterRate = 4 * least_px / max(image.shape)
        families = [*dict.fromkeys(self.families)]
        detector = cv2.aruco.ArucoDetector([dictionary(f) for f in families], options)
        quads, ids, _, of = detector.detectMarkersMultiDict(image)
        if not quads:
            return []
        scale = np.array([area.width / image.shape[1], area.height / image.shape[0]])
        px = (np.array(quads, float).reshape(-1, 4, 2) + 0.5) * scale - 0.5
        px += [area.x0, area.y0]
        out = [
            Candidate(families[int(family)], int(number), quad)
            for family, number, quad in zip(
                np.ravel(of), np.ravel(ids), px, strict=True
            )
        ]
        return sorted(out, key=lambda c: (c.key, tuple(c.quad_px[0])))
