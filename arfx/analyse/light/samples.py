"""A print's cells in linear light: samples on a grid inside every cell, away from its edges."""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

# of a cell that is left out at each side: the inner 60 % remain, at least 10 %
MARGIN, MOST_MARGIN = 0.2, 0.45
# A bilinear sample has 4/9 of a pixel's noise variance, on average; samples nearer than 1.5
# px have that noise in common.
SHARED_PX2 = 9 / 4
LEAST_STEP_PX = 1.25  # between samples: nearer ones tell next to nothing more
BLURS = 2.5  # margin in standard deviations of the blur
MOST_SAMPLES = 5  # per cell and axis
_HALF = np.float32(0.5)
CLIP_LOW, CLIP_HIGH = 1.5e-4, 0.9955  # half an 8-bit step inside either end, sRGB
# the least and the greatest of what is not clipped, by channel
_WITHIN = np.nextafter(np.array([[CLIP_LOW] * 3, [CLIP_HIGH] * 3], np.float32), _HALF)
FARTHEST_PX = 3e4  # that remap reads: 16-bit numbers
_UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)


class CellSamples(NamedTuple):
    """m samples of each of a print's n x n cells, row by row.

    value : (n, n, m, 3) linear RGB, NaN = not in the picture, or not finite;  place : (n k,
    n k, 2) float32 of all on the print, 0..1, across and down;  clipped : (n, n, m)
    shared : samples that have their noise in common;  leak : share of the contrast that
    blur brings in from other cells
    """

    value: ndarray
    place: ndarray
    clipped: ndarray
    shared: float
    leak: float


def sample_cells(
    linear: ndarray, quad_px: ndarray, n: int, blur_px: float
) -> CellSamples | None:
    """None for a quad that is bent.

    linear : (h, w, 3) float32, of a picture or a part of it;  quad_px : (4, 2) in it, order
    of MarkerSpec.corners_m;  n : cells on a side;  blur_px : standard deviation of the
    edges' blur"""
    side = np.roll(quad_px, -1, 0) - quad_px
    after = np.roll(side, -1, 0)
    turns = np.sign(side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]).sum()
    if abs(turns) != 4 or np.abs(quad_px).max() > FARTHEST_PX:
        return None
    turn = cv2.getPerspectiveTransform(_UNIT, np.asarray(quad_px, np.float32))
    # how the plane is stretched at the middle
    *middle, depth = turn @ [0.5, 0.5, 1]
    stretch = (turn[:2, :2] - np.outer(middle, turn[2, :2]) / depth) / depth / n
    wide_px, cell_px = np.linalg.svd(stretch, compute_uv=False)
    margin = float(np.clip(BLURS * blur_px / max(cell_px, 1e-6), MARGIN, MOST_MARGIN))
    inner = 1 - 2 * margin
    k = int(np.clip(round(inner * cell_px / LEAST_STEP_PX), 1, MOST_SAMPLES))
    along = (
        np.arange(n)[:, None] + margin + inner * (np.arange(k) + 0.5) / k
    ).ravel() / n
    place = np.stack(np.meshgrid(along, along), -1).astype(np.float32)
    at = cv2.perspectiveTransform(place, turn)
    x, y = cv2.split(at)
    seen = cv2.remap(
        linear, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, (np.nan,) * 3
    )
    within = cv2.inRange(linear, *_WITHIN)
    cut = cv2.remap((within == 0).astype(np.float32), x, y, cv2.INTER_LINEAR)
    value, clipped = (
        a.reshape(n, k, n, k, -1).transpose(0, 2, 1, 3, 4).reshape(n, n, k * k, -1)
        for a in (seen, cut)
    )
    per_sample = inner**2 * wide_px * cell_px / k**2  # px^2
    nearest = (margin + inner * 0.5 / k) * cell_px
    leak = math.erfc(nearest / blur_px / math.sqrt(2)) if blur_px > 0 else 0.0
    shared = max(1.0, SHARED_PX2 / max(per_sample, 1e-6))
    return CellSamples(value.astype(float), place, clipped[..., 0] > 0, shared, leak)
