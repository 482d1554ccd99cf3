"""What a coded marker looks like: OpenCV's dictionaries, and the cells of a print."""

from functools import cache

import cv2
import numpy as np
from numpy import ndarray

# corners of the unit square, in the order of MarkerSpec.corners_m
UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)


@cache
def dictionary(family: str) -> cv2.aruco.Dictionary:
    """Of a FAMILIES key; OpenCV calls them DICT_4X4_50, DICT_APRILTAG_36h11,
    DICT_ARUCO_ORIGINAL.
    """
    maker = (
        "ARUCO_"
        if family.startswith(("ORIGINAL", "MIP"))
        else "APRILTAG_"
        if "h" in family
        else ""
    )
    return cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{maker}{family}")
    )


def cells_per_side(family: str) -> int:
    """Cells along a marker's side, black border included."""
    return int(dictionary(family).markerSize) + 2


@cache
def marker_cells(family: str, number: int) -> ndarray:
    """(n, n) bool, True = paper, border included; row 0 at the top, column 0 at the left of
    MarkerSpec.corners_m.

    family, number : FAMILIES key and id; as printed, not inverted. The array is read-only.
    """
    out = dictionary(family).generateImageMarker(number, cells_per_side(family)) > 127
    out.setflags(write=False)
    return out
