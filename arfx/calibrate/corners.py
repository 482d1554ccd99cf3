"""Finds the inner corners of one board in one picture, to a few hundredths of a pixel.

Chessboards: `findChessboardCorners` (grid) and `cornerSubPix` (position) with a window tied
to the size of the squares as
they appear; where the grid search fails, the sector-based finder's grid. Measured, see docs
of `REFINE_FRACTION` and tests.
ChArUco: OpenCV's detector, then `cornerSubPix` with a window that keeps clear of the
markers; see `CLEAR_FRACTION`.
Cost: 5-15 ms at 640x480, 30-50 ms at 1920x1080; a chessboard that is not there costs up to .3 s.
Source: Förstner and Gülch 1987 (cornerSubPix); Duda and Frese 2018 (the sector-based finder).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray
from scipy.spatial import cKDTree

from arfx.calibrate.board import (
    CHARUCO,
    CHESSBOARD,
    BoardSpec,
    charuco_board,
)
from arfx.core.marker import smallest_family
from arfx.core.marker_codes import dictionary
from arfx.core.numerics import divide

# Half the refinement window, as a share of the smallest distance between two corners in the
# picture. The window is a square, so a board turned by 45 degrees reaches sqrt(2) times as
# far: .33 * 1.41 = .47 of the way to the next corner, whose edges would otherwise pull this
# one. On OpenCV's set a fixed 11 px reaches too far in left02 (22 px squares): rms there
# 1.22 px against .16, and fx 536.3 instead of 533.1.
REFINE_FRACTION = 0.33
# The same for ChArUco, as a share of the white between a marker and its square's edge. On
# rendered boards (5-11 px per marker module) errors were .04-.06 px, OpenCV's own
# refinement gave .04-.17; a window that reaches the markers .2-.5.
CLEAR_FRACTION = 0.8
REFINE_MIN_PX, REFINE_MAX_PX = 2, 20
LEAST_CHARUCO_CORNERS = (
    8  # a plane's homography takes 4; twice that leaves residuals to judge it by
)
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


@dataclass(frozen=True, eq=False)
class View:
    """One board seen once.

    name : picture, or clip and time; size : (width, height) px
    ids : (n,) corner numbers, row by row; board_m : (n, 3) metres; pixels : (n, 2) float64
    sharpness : see `corner_sharpness`"""

    name: str
    size: tuple[int, int]
    ids: ndarray
    board_m: ndarray
    pixels: ndarray
    sharpness: float = 0.0

    def without(self, number: int) -> View:
        """Without one of its corners."""
        names = ("ids", "board_m", "pixels")
        rest = {name: np.delete(getattr(self, name), number, 0) for name in names}
        return replace(self, **rest)


def find_view(gray: ndarray, spec: BoardSpec, name: str) -> View | None:
    """The board in a picture (h, w) uint8, or None."""
    found = (_chessboard if spec.kind == CHESSBOARD else _charuco)(gray, spec)
    if found is None:
        return None
    ids, pixels = found
    sharpness = corner_sharpness(gray, pixels)
    return View(name, gray.shape[::-1], ids, spec.corners_m[ids], pixels, sharpness)


_Corners = tuple[ndarray, ndarray]  # ids and pixels of a View


def _charuco(gray: ndarray, spec: BoardSpec) -> _Corners | None:
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco_board(spec)).detectBoard(
        gray
    )
    if ids is None or len(ids) < LEAST_CHARUCO_CORNERS:
        return None
    ids = np.asarray(ids).ravel()
    board = spec.corners_m[ids, :2]
    if np.linalg.matrix_rank(board - board.mean(0), tol=0.1 * spec.square_m) < 2:
        return None  # all on one row: no plane
    white = (1 - spec.marker_m / spec.square_m) / 2
    return ids, _refined(gray, corners, CLEAR_FRACTION * white)


def _refined(gray: ndarray, rough: ndarray, share: float) -> ndarray:
    """(n, 2) corners refined in windows of half the side `share` of the smallest distance
    between two of them.
    """
    rough = np.asarray(rough, np.float32).reshape(-1, 2)
    nearest = cKDTree(rough).query(rough, 2)[0][:, 1].min()
    half = int(np.clip(round(share * nearest), REFINE_MIN_PX, REFINE_MAX_PX))
    return cv2.cornerSubPix(gray, rough.copy(), (half, half), (-1, -1), STOP).astype(
        float
    )


def _chessboard(gray: ndarray, spec: BoardSpec) -> _Corners | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, rough = cv2.findChessboardCorners(gray, spec.inner, flags=flags)
    if not found:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE
        found, rough = cv2.findChessboardCornersSB(gray, spec.inner, flags=flags)
    if not found:
        return None
    # one pass only: a first one with a larger window (to pull back corners that the grid
    # search left far off) moved corners of left02 in OpenCV's set to their neighbours'
    # edges; such corners are rather dropped later (screen.drop_corners)
    pixels = _refined(gray, rough, REFINE_FRACTION)
    grid = pixels.reshape(spec.inner[1], spec.inner[0], 2)
    # the inner squares next to the first and the last corner: they lie inside the grid, so
    # they are always in the picture. Is the first white, its opposite black? Then the grid
    # is turned
    ends = [grid[:2, :2].mean((0, 1)), grid[-2:, -2:].mean((0, 1))]
    first, last = (
        cv2.getRectSubPix(gray, (3, 3), end.tolist()).mean() for end in ends
    )
    if not spec.turn_is_ambiguous and first > last:
        pixels = pixels[::-1].copy()
    return np.arange(len(pixels)), pixels


def corner_sharpness(gray: ndarray, pixels: ndarray) -> float:
    """Steepest grey step per pixel around the corners over the contrast there: 1 / edge
    width in px, ~0.5 sharp, 0 blurred.
    """
    patches = np.array(
        [cv2.getRectSubPix(gray, (11, 11), at) for at in np.round(pixels).tolist()],
        float,
    )
    slopes = np.percentile(np.hypot(*np.gradient(patches, axis=(1, 2))), 95, (1, 2))
    low, high = np.percentile(patches, (5, 95), (1, 2))
    return float(np.median(divide(slopes, high - low)))


# The largest dictionary of each bit pattern: the smaller ones are its first ids.
SEARCHED = (
    "4X4_1000",
    "5X5_1000",
    "6X6_1000",
    "7X7_1000",
    "ORIGINAL",
    "36h11",
    "25h9",
    "16h5",
)
LEAST_MARKERS = (
    4  # of one family: fewer may be chance in texture (4x4 markers have few bits) ...
)
TELLING = {
    "36h11",
    "6X6_1000",
    "7X7_1000",
}  # ... but not with these: codes this long do not come about by chance
SMALL_CHESSBOARD = (
    4,
    3,
)  # the sector-based finder grows from this to the whole board


def seen_instead(gray: ndarray, spec: BoardSpec) -> str:
    """In words what a picture (h, w) uint8 shows in place of the board, as a spec where it
    is recognised; "" for nothing.

    Cost: about 1 s at 1920x1080; meant for a few pictures."""
    ids, family = set[int](), ""
    for f in SEARCHED:
        found = cv2.aruco.ArucoDetector(dictionary(f)).detectMarkers(gray)[1]
        own = set() if found is None else {int(i) for i in np.ravel(found)}
        if len(own) >= (1 if f in TELLING else LEAST_MARKERS) and len(own) > len(ids):
            ids, family = own, f
    if ids:
        if spec.kind == CHARUCO:
            better = _working_spec(gray, spec, family, max(ids))
            if better is not None:
                return f"a board that fits {better}"
        return (
            f"{len(ids)} marker{'s'[: len(ids) > 1]} of {family} (ids {min(ids)} to"
            f" {max(ids)})"
        )
    chess, _, meta = cv2.findChessboardCornersSBWithMeta(
        gray, SMALL_CHESSBOARD, cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    )
    if not chess or meta is None:
        return ""
    rows, columns = meta.shape[:2]
    return (
        f"a chessboard with {max(rows, columns)}x{min(rows, columns)} inner corners"
    )


def _working_spec(
    gray: ndarray, spec: BoardSpec, family: str, highest: int
) -> BoardSpec | None:
    """A change of pattern, orientation or dictionary with which the board is found."""
    # the smallest dictionary of the same bits that holds the ids seen and the board's own
    own = spec.family.split("_")[0] == family.split("_")[0]
    most = max(highest, spec.columns * spec.rows // 2 - 1)
    name = spec.family if own else smallest_family(family, most)
    for columns, rows in ((spec.columns, spec.rows), (spec.rows, spec.columns)):
        for legacy in (spec.legacy, not spec.legacy):
            trial = replace(
                spec, columns=columns, rows=rows, legacy=legacy, family=name
            )
            if trial != spec and find_view(gray, trial, "") is not None:
                return trial
    return None
