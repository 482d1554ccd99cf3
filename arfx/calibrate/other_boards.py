"""What is in a picture in which the given board is not: another board, other markers, or nothing."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from arfx.calibrate.board import CHARUCO, BoardSpec, opencv_dictionary
from arfx.calibrate.corners import find_view

# The largest dictionary of each bit pattern: the smaller ones are its first ids.
SEARCHED = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ORIGINAL", "36h11", "25h9", "16h5")
LEAST_MARKERS = 4  # of one family: fewer may be chance in texture (4x4 markers have few bits) ...
TELLING = {"36h11", "6X6_1000", "7X7_1000"}  # ... but not with these: codes this long do not come about by chance
SMALL_CHESSBOARD = (4, 3)  # the sector-based finder grows from this to the whole board


def seen_instead(gray: np.ndarray, spec: BoardSpec) -> str:
    """In words what a picture (h, w) uint8 shows in place of the board, as a spec where it can be told; "" for nothing.

    Cost: about 1 s at 1920x1080; meant for a few pictures.
    """
    chess = _largest_chessboard(gray)
    families = {}
    for f in SEARCHED:
        found = cv2.aruco.ArucoDetector(opencv_dictionary(f)).detectMarkers(gray)[1]
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
        return f"{len(ids)} marker{'s'[: len(ids) > 1]} of {family} (ids {min(ids)} to {max(ids)})"
    if chess:
        return f"a chessboard with {chess[0]}x{chess[1]} inner corners"
    return ""


def _working_spec(gray: np.ndarray, spec: BoardSpec, family: str, highest: int) -> BoardSpec | None:
    """A change of pattern, orientation or dictionary with which the board is found."""
    own = spec.family.split("_")[0] == family.split("_")[0]
    # the smallest dictionary of the same bits that holds the ids seen and the board's own
    enough = max(highest + 1, spec.columns * spec.rows // 2)
    sizes = [k for k in (50, 100, 250, 1000) if k >= enough]
    name = spec.family if own else (f"{family.split('_')[0]}_{sizes[0]}" if "X" in family and sizes else family)
    for columns, rows in ((spec.columns, spec.rows), (spec.rows, spec.columns)):
        for legacy in (spec.legacy, not spec.legacy):
            trial = replace(spec, columns=columns, rows=rows, legacy=legacy, family=name)
            if trial != spec and find_view(gray, trial, "") is not None:
                return trial
    return None


def _largest_chessboard(gray: np.ndarray) -> tuple[int, int] | None:
    """(inner corners across, down), the larger first, of a chessboard of any size."""
    found, _, meta = cv2.findChessboardCornersSBWithMeta(gray, SMALL_CHESSBOARD, cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE)
    if not found or meta is None:
        return None
    rows, columns = meta.shape[:2]
    return max(rows, columns), min(rows, columns)
