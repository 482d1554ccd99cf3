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

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from arfx.calibrate.board import (
    CHARUCO,
    CHESSBOARD,
    BoardSpec,
    charuco_board,
)
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
    finder : which corner finder; sharpness : see `corner_sharpness`; upside_down : None
    where the board cannot tell
    alternative : (n, 2) the same corners by the other finder, or None; their disagreement
    is a systematic error that
        residuals do not show"""

    name: str
    size: tuple[int, int]
    ids: np.ndarray
    board_m: np.ndarray
    pixels: np.ndarray
    finder: str
    sharpness: float = 0.0
    upside_down: bool | None = None
    alternative: np.ndarray | None = field(default=None, repr=False)


def find_view(
    gray: np.ndarray, spec: BoardSpec, name: str, second_opinion: bool = False
) -> View | None:
    """The board in a picture (h, w) uint8, or None.

    second_opinion : find chessboard corners with the other finder as well (3-10 x the time)
    """
    if spec.kind == CHESSBOARD:
        return _chessboard(gray, spec, name, second_opinion)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco_board(spec)).detectBoard(gray)
    if ids is None or len(ids) < LEAST_CHARUCO_CORNERS:
        return None
    ids = np.asarray(ids).ravel()
    board = spec.corners_m[ids]
    if (
        np.linalg.matrix_rank(board[:, :2] - board[:, :2].mean(0), tol=0.1 * spec.square_m)
        < 2
    ):
        return None  # all on one row: no plane
    grid = np.full((spec.inner[0] * spec.inner[1], 2), np.nan)
    grid[ids] = np.asarray(corners, float).reshape(-1, 2)
    white = (1 - spec.marker_m / spec.square_m) / 2
    pixels = _refined(
        gray,
        np.asarray(corners, np.float32),
        CLEAR_FRACTION * white * nearest_corner_px(grid, spec.inner),
    )
    return _view(gray, spec, name, ids, pixels, "charuco", None)


def _refined(gray: np.ndarray, rough: np.ndarray, half_px: float) -> np.ndarray:
    """(n, 2) corners refined in windows of half the side half_px, NaN = the smallest."""
    half = (
        int(np.clip(round(half_px), REFINE_MIN_PX, REFINE_MAX_PX))
        if np.isfinite(half_px)
        else REFINE_MIN_PX
    )
    refined = cv2.cornerSubPix(
        gray, rough.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), STOP
    )
    return refined.reshape(-1, 2).astype(float)


def _chessboard(
    gray: np.ndarray, spec: BoardSpec, name: str, second_opinion: bool
) -> View | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, rough = cv2.findChessboardCorners(gray, spec.inner, flags=flags)
    finder, sectors = "gradient", None
    if not found:
        found, rough = cv2.findChessboardCornersSB(
            gray, spec.inner, flags=cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        finder, sectors = "gradient on the sector grid", rough
        if not found:
            return None
    elif second_opinion:
        ok, other = cv2.findChessboardCornersSB(gray, spec.inner, flags=0)
        sectors = other if ok else None
    rough = np.asarray(rough, np.float32).reshape(-1, 1, 2)
    # one pass only: a first one with a larger window (to pull back corners that the grid
    # search left far off) moved corners of left02 in OpenCV's set to their neighbours'
    # edges; such corners are rather dropped later (screen.drop_corners)
    nearest = nearest_corner_px(rough.reshape(-1, 2).astype(float), spec.inner)
    pixels = _refined(gray, rough, REFINE_FRACTION * nearest)
    # the other finder's corners in our order, unless it numbers them in a way that is not a
    # half turn, or is far off
    others = (
        [] if sectors is None else [o := np.asarray(sectors, float).reshape(-1, 2), o[::-1]]
    )
    near = (
        o.copy() for o in others if np.linalg.norm(o - pixels, axis=1).max() < 3.0
    )  # px; more is another corner
    alternative = next(near, None)
    grid = pixels.reshape(spec.inner[1], spec.inner[0], 2)
    # the inner squares next to the first and the last corner: they lie inside the grid, so
    # they are always in the picture. Is the first white, its opposite black? Then the grid
    # is turned
    ends = [grid[:2, :2].mean((0, 1)), grid[-2:, -2:].mean((0, 1))]
    first, last = (
        float(cv2.getRectSubPix(gray, (3, 3), (float(x), float(y))).mean()) for x, y in ends
    )
    if not spec.turn_is_ambiguous and first > last:
        pixels = pixels[::-1].copy()
        alternative = None if alternative is None else alternative[::-1].copy()
    return _view(gray, spec, name, np.arange(len(pixels)), pixels, finder, alternative)


def _view(
    gray: np.ndarray,
    spec: BoardSpec,
    name: str,
    ids: np.ndarray,
    pixels: np.ndarray,
    finder: str,
    other: np.ndarray | None,
) -> View:
    board = spec.corners_m[ids]
    # least squares slope of pixel y on board y: does the board's y, down its rows, run
    # upwards in the picture?
    rise = ((board[:, 1] - board[:, 1].mean()) * (pixels[:, 1] - pixels[:, 1].mean())).sum()
    upside_down = None if spec.turn_is_ambiguous else bool(rise < 0)
    height, width = gray.shape
    return View(
        name,
        (width, height),
        ids,
        board,
        pixels,
        finder,
        corner_sharpness(gray, pixels),
        upside_down,
        other,
    )


def nearest_corner_px(pixels: np.ndarray, inner: tuple[int, int]) -> float:
    """Smallest distance between neighbours, diagonal ones too, of a grid of corners (n, 2)
    with NaN for missing ones.
    """
    grid = pixels.reshape(inner[1], inner[0], 2)
    steps = (
        grid[1:] - grid[:-1],
        grid[:, 1:] - grid[:, :-1],
        grid[1:, 1:] - grid[:-1, :-1],
        grid[1:, :-1] - grid[:-1, 1:],
    )
    distances = np.concatenate([np.linalg.norm(s, axis=-1).ravel() for s in steps])
    known = distances[np.isfinite(distances)]
    return float(known.min()) if known.size else float("nan")


def corner_sharpness(gray: np.ndarray, pixels: np.ndarray) -> float:
    """Steepest grey step per pixel around the corners over the contrast there: 1 / edge
    width in px, ~0.5 sharp, 0 blurred.
    """
    height, width = gray.shape
    slopes = []
    for x, y in np.round(pixels[:: max(1, len(pixels) // 24)]).astype(int):
        patch = gray[
            max(0, y - 5) : min(height, y + 6), max(0, x - 5) : min(width, x + 6)
        ].astype(float)
        if min(patch.shape) < 3:
            continue
        gy, gx = np.gradient(patch)
        low, high = np.percentile(patch, (5, 95))
        slopes.append(float(divide(np.percentile(np.hypot(gx, gy), 95), high - low)))
    return float(np.median(slopes)) if slopes else 0.0


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
SMALL_CHESSBOARD = (4, 3)  # the sector-based finder grows from this to the whole board


def seen_instead(gray: np.ndarray, spec: BoardSpec) -> str:
    """In words what a picture (h, w) uint8 shows in place of the board, as a spec where it
    is recognised; "" for nothing.

    Cost: about 1 s at 1920x1080; meant for a few pictures."""
    families = {}
    for f in SEARCHED:
        found = cv2.aruco.ArucoDetector(dictionary(f)).detectMarkers(gray)[1]
        ids = set() if found is None else {int(i) for i in np.ravel(found)}
        if len(ids) >= (1 if f in TELLING else LEAST_MARKERS):
            families[f] = ids
    if families:
        family = max(families, key=lambda f: len(families[f]))
        ids = families[family]
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
    return f"a chessboard with {max(rows, columns)}x{min(rows, columns)} inner corners"


def _working_spec(
    gray: np.ndarray, spec: BoardSpec, family: str, highest: int
) -> BoardSpec | None:
    """A change of pattern, orientation or dictionary with which the board is found."""
    own = spec.family.split("_")[0] == family.split("_")[0]
    # the smallest dictionary of the same bits that holds the ids seen and the board's own
    enough = max(highest + 1, spec.columns * spec.rows // 2)
    sizes = [k for k in (50, 100, 250, 1000) if k >= enough]
    name = (
        spec.family
        if own
        else (f"{family.split('_')[0]}_{sizes[0]}" if "X" in family and sizes else family)
    )
    for columns, rows in ((spec.columns, spec.rows), (spec.rows, spec.columns)):
        for legacy in (spec.legacy, not spec.legacy):
            trial = replace(spec, columns=columns, rows=rows, legacy=legacy, family=name)
            if trial != spec and find_view(gray, trial, "") is not None:
                return trial
    return None
