"""Whether the cells inside a marker lie where its corners say: a hand over one side has an
edge too, and bits are still read.

Every line between a dark and a bright cell is looked up in the picture. How far they are
off, as a plane over the print, says how far each corner is off. Cost: about .1 ms per
marker."""

from functools import cache

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.marker_codes import cells_per_side, marker_cells
from arfx.core.numerics import divide

# cells, where a line between two cells is sampled, between the middles of both
_REACH = 0.4
_ACROSS = np.array([-0.5, *np.linspace(-_REACH, _REACH, 9), 0.5])
_LEAST_CONTRAST = 0.4  # of the usual one: fainter, one of the two cells is covered
LEAST_LINES = 12
# three deviations of a corner, each three of the mean of the lines: it lies outside of them
_DOUBT = 9.0
_RIDGE = 1e-6 * np.eye(6)
AGREE_CELLS = 0.05  # what the camera makes of edges moves lines by less


@cache
def _lines(family: str, number: int) -> tuple[ndarray, ndarray]:
    """Of one print, cells from its upper left corner: middles (k, 2), and unit normals (k,
    2) to the brighter cell.
    """
    bright = marker_cells(family, number).astype(int)
    middles, normals = [], []
    for axis in (0, 1):  # lines that a row crosses, then those that a column crosses
        step = np.diff(bright, axis=1 - axis)
        row, column = np.nonzero(step)
        middle = np.stack([column, row], 1) + 0.5
        middle[:, axis] += 0.5
        middles.append(middle)
        normals.append(np.outer(step[row, column], np.eye(2)[axis]))
    return np.concatenate(middles), np.concatenate(normals)


def misplaced_px(
    luma: ndarray,
    corners_px: ndarray,
    family: str,
    number: int,
    inverted: bool,
    table: ndarray,
) -> float:
    """Root mean square over the corners of how far they are from where the inner cells have
    them; 0 where these agree.

    luma : (h, w) uint8;  corners_px : (4, 2) in the order of MarkerSpec.corners_m;  table :
    (256,) coded luma to light, 0..255
    """
    cells = cells_per_side(family)
    middle, normal = _lines(family, number)
    if len(middle) < LEAST_LINES or not np.isfinite(corners_px).all():
        return 0.0
    square = np.array([[0, 0], [cells, 0], [cells, cells], [0, cells]], np.float32)
    h = cv2.getPerspectiveTransform(square, np.asarray(corners_px, np.float32))
    at = middle[:, None] + _ACROSS[:, None] * normal[:, None]
    x, y = np.moveaxis(cv2.perspectiveTransform(at, h).astype(np.float32), -1, 0)
    read = cv2.remap(luma, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    light = table[read]
    light = 255 - light if inverted else light
    dark, bright = light[:, 0], light[:, -1]
    contrast = bright - dark
    clear = contrast > _LEAST_CONTRAST * np.median(contrast)
    if clear.sum() < LEAST_LINES or np.median(contrast) <= 0:
        return 0.0
    # of a line that is off by d the mean over -w to w is off by d / 2 w of the contrast
    level = divide(light[:, 1:-1].mean(1) - (dark + bright) / 2, contrast)
    off = -level * 2 * _REACH
    plane = np.concatenate([np.ones((len(off), 1)), middle / cells - 0.5], 1)
    ends = np.concatenate([np.ones((4, 1)), square / cells - 0.5], 1)
    off, normal = off[clear], normal[clear]
    if np.abs(normal).sum(0).min() < LEAST_LINES // 3:
        return 0.0
    # a plane for what lies off along the rows, and one along the columns
    design = (normal[:, :, None] * plane[clear][:, None]).reshape(-1, 6)
    weight = np.ones(len(off))
    for _ in range(3):  # what covers cells moves their lines too
        weighted = design.T * weight
        fit = np.linalg.solve(weighted @ design + _RIDGE, weighted @ off)
        missed = np.abs(off - design @ fit)
        weight = 1 / (1 + missed / 0.05) ** 2
    shift = ends @ fit.reshape(2, 3).T
    scatter = 1.4826 * float(np.median(missed))
    if np.abs(shift).max() < max(
        AGREE_CELLS, _DOUBT * scatter / np.sqrt(len(off) / 2)
    ):
        return 0.0
    away = cv2.perspectiveTransform((square + shift)[None], h)[0] - corners_px
    return float(np.sqrt((away**2).sum(1).mean() / 2))
