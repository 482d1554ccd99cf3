"""Where the samples of a print lie, and which of a patch's samples agree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.numerics import HALF_GREY

# black top left, top right, bottom left, bottom right, then white in the same order
PATCHES = 8
# of a cell that is left out at each side: the inner 60 % remain, at least 10 %
MARGIN, MOST_MARGIN = 0.2, 0.45
# A bilinear sample has 4/9 of a pixel's noise variance, on average; samples nearer than 1.5
# px have that noise in common.
SHARED_PX2 = 9 / 4
LEAST_STEP_PX = 1.25  # between samples: nearer ones tell next to nothing more
BLURS = 2.5  # margin in standard deviations of the blur
MOST_SAMPLES = 5  # per cell and axis
OUT = 3.5  # robust standard deviations beyond which a sample is no part of its patch
_GAMMA = 2.2  # about the slope of the transfer function


@dataclass(frozen=True, eq=False)
class SamplePoints:
    """Where the samples of one print lie. corner : (k, 2) int32, upper left of the four
    pixels around each (x, y)
    part : (k, 2) from there to the next ones, 0..1;  group : (k,) patch;  scale : (k, 3)
    factor that makes a patch even
    last : (x, y) of the picture's last pixel
    shared : samples that have their noise in common;  leak : share of the contrast that
    blur brings in from other cells
    """

    corner: np.ndarray
    part: np.ndarray
    group: np.ndarray
    scale: np.ndarray
    last: tuple[int, int]
    shared: float = 1.0
    leak: float = 0.0

    def pixels(self) -> np.ndarray:
        """(4 k, 2) int32: x, y of every pixel that is read."""
        four = self.corner[:, None] + np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        return np.minimum(four, self.last).reshape(-1, 2).astype(np.int32)

    @property
    def weights(self) -> np.ndarray:
        """(k, 4) of these pixels."""
        x, y = self.part.T
        return np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], 1)


def place_samples(
    quad_px: np.ndarray,
    cells: np.ndarray,
    inverted: bool,
    blur_px: float,
    shape: tuple[int, int],
    scale: np.ndarray | None = None,
) -> SamplePoints:
    """Samples of a print in a picture of shape (rows, columns); none for a quad that is bent.

    quad_px : (4, 2) order of MarkerSpec.corners_m;  cells : `marker_cells(family, id)`, or of a
    Meter;  inverted : white on black print
    blur_px : standard deviation of the edges' blur;  scale : of a Meter"""
    rows, columns = shape
    last = np.array([max(columns - 1, 0), max(rows - 1, 0)])
    quad, white = np.asarray(quad_px, float), np.asarray(cells, np.int8)
    white = 1 - white if inverted else white
    n = len(white)
    side = np.roll(quad, -1, 0) - quad
    after = np.roll(side, -1, 0)
    turns = np.sign(side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]).sum()
    if abs(turns) != 4:
        none = np.zeros((0, 2))
        return SamplePoints(
            none.astype(np.int32), none, np.zeros(0, int), np.zeros((0, 3)), (*last,)
        )
    # unit square to quadrilateral (Heckbert 1989, eq. 2.10)
    q0, q1, q2, q3 = quad
    g, h = np.linalg.solve(np.stack([q1 - q2, q3 - q2], 1), q0 - q1 + q2 - q3)
    turn = np.ones((3, 3))
    turn[:2] = np.stack([q1 - q0 + g * q1, q3 - q0 + h * q3, q0], 1)
    turn[2, :2] = g, h
    # how the plane is stretched at the middle
    x, y, depth = turn @ [0.5, 0.5, 1]
    stretch = (turn[:2, :2] - np.outer([x / depth, y / depth], turn[2, :2])) / depth / n
    wide_px, cell_px = np.linalg.svd(stretch, compute_uv=False)
    margin = float(np.clip(BLURS * blur_px / max(cell_px, 1e-6), MARGIN, MOST_MARGIN))
    inner = 1 - 2 * margin
    k = int(np.clip(round(inner * cell_px / LEAST_STEP_PX), 1, MOST_SAMPLES))
    per_sample = inner**2 * wide_px * cell_px / k**2  # px^2
    nearest = (margin + inner * 0.5 / k) * cell_px
    leak = math.erfc(nearest / blur_px / math.sqrt(2)) if blur_px > 0 else 0.0
    row, column = np.nonzero(white >= 0)
    inside_cell = margin + inner * (np.arange(k) + 0.5) / k
    v, u = np.broadcast_arrays(
        (row[:, None, None] + inside_cell[:, None]) / n,
        (column[:, None, None] + inside_cell) / n,
    )
    patch = 4 * white[row, column].astype(int)[:, None, None] + 2 * (v >= 0.5) + (u >= 0.5)
    place = np.stack([u, v], -1).reshape(-1, 1, 2)
    at = cv2.perspectiveTransform(place, turn)[:, 0]
    inside = ((at >= 0) & (at <= last)).all(1)
    at, place = at[inside], place[inside]
    corner = np.minimum(at.astype(np.int32), np.maximum(last - 1, 0)).astype(np.int32)
    even: np.ndarray = np.ones((len(at), 3))
    if scale is not None and len(at):
        on_map = (place * len(scale) - 0.5).astype(np.float32)
        x, y = on_map[..., 0], on_map[..., 1]
        even = cv2.remap(scale, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[
            :, 0
        ]
    shared = max(1.0, SHARED_PX2 / max(per_sample, 1e-6))
    return SamplePoints(
        corner, at - corner, patch.ravel()[inside], even, (*last,), shared, leak
    )


def half_step(level: np.ndarray | float) -> np.ndarray:
    """Half of an 8-bit step in linear light, at a linear level."""
    slope = _GAMMA * np.maximum(level, 0) ** (1 - 1 / _GAMMA)
    return HALF_GREY * np.maximum(1 / 12.92, slope)


def within(grey: np.ndarray) -> np.ndarray:
    """(n,) bool: which of a patch's samples are within OUT deviations of their median,
    those beyond left out up to four times.
    """
    ordered = np.sort(grey)
    kept, centre, width = ordered, 0.0, np.inf
    for _ in range(4):
        if not len(kept):
            break
        centre = _median(kept)
        spread = 1.4826 * _median(np.sort(np.abs(kept - centre)))
        width = OUT * max(spread, float(half_step(centre)))
        before = len(kept)
        low = np.searchsorted(ordered, centre - width)
        kept = ordered[low : np.searchsorted(ordered, centre + width, "right")]
        if len(kept) == before < len(grey):
            break
    return np.abs(grey - centre) <= width


def _median(ordered: np.ndarray) -> float:
    """Of ascending numbers; numpy's own takes five times as long for so few."""
    n = len(ordered)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2
