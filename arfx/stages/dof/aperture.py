"""What one blur circle looks like on the pixel grid: rows of the disc, or of an n-blade polygon of the same area.

A row is a run of pixels with fractional ends, so that the shape has its exact area in every row at any radius. A disc of
at most half a pixel's radius lies within its own pixel: no blur.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

STEPS = 16  # radii a pixel in the table
_SUBROWS = 8  # lines by which a row's ends are averaged


@dataclass(frozen=True, eq=False)
class Shape:
    """Rows of the blur circle by radius; index q = round(radius px * STEPS), row j + reach[q] for j = -reach..reach.

    first, last : (q, rows) int32, pixels in which the row begins and ends, from the centre
    share_first, share_last : (q, rows) float32, 0..1, how much of those pixels is covered
    weight : (q, rows) float32, of a fully covered pixel of the row; all covered shares times weight sum to 1
    reach : (q,) int32, rows beyond the centre's
    """

    first: np.ndarray
    last: np.ndarray
    share_first: np.ndarray
    share_last: np.ndarray
    weight: np.ndarray
    reach: np.ndarray


@lru_cache(maxsize=16)
def shape(largest_px: int, blades: int = 0, turn_deg: float = 0.0) -> Shape:
    """Table for radii 0..largest_px. blades : 0 = disc, else corners of the polygon, the first at turn_deg from x."""
    count = largest_px * STEPS + 1
    radius = np.arange(count) / STEPS
    grow = _circumradius(blades)
    reach = np.ceil(radius * grow - 0.5).clip(0).astype(np.int32)
    rows = 2 * int(reach.max()) + 1
    first, last = np.zeros((count, rows), np.int32), np.zeros((count, rows), np.int32)
    share_first, share_last, weight = (np.zeros((count, rows), np.float32) for _ in range(3))
    for q in range(count):
        n = 2 * int(reach[q]) + 1
        left, right, covered = _rows(radius[q], int(reach[q]), blades, turn_deg)
        total = float(((right - left) * covered).sum())
        if total <= 0:
            left, right, covered, total = np.full(n, -0.5), np.full(n, 0.5), np.ones(n), 1.0
        a, b = np.floor(left + 0.5), np.ceil(right - 0.5)
        one = a >= b  # within one pixel: it is covered by the run's length
        first[q, :n], last[q, :n] = a, np.where(one, a, b)
        share_first[q, :n] = np.where(one, right - left, a + 0.5 - left)
        share_last[q, :n] = np.where(one, 0.0, right - (b - 0.5))
        weight[q, :n] = covered / total
    return Shape(first, last, share_first, share_last, weight, reach)


def _circumradius(blades: int) -> float:
    """Of a polygon whose area is that of a disc of radius 1."""
    return 1.0 if blades < 3 else float(np.sqrt(2 * np.pi / (blades * np.sin(2 * np.pi / blades))))


def _rows(radius: float, reach: int, blades: int, turn_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean left and right end of every row, px, and the share of the row's height that the shape takes."""
    y = (np.arange(-reach, reach + 1)[:, None] + (np.arange(_SUBROWS) + 0.5) / _SUBROWS - 0.5).astype(float)
    if blades < 3:
        half = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        left, right = -half, half
    else:
        left, right = _polygon_chord(y, radius * _circumradius(blades), blades, turn_deg)
    inside = right > left
    count = np.maximum(inside.sum(1), 1)
    return (left * inside).sum(1) / count, (right * inside).sum(1) / count, inside.sum(1) / _SUBROWS


def _polygon_chord(y: np.ndarray, circumradius: float, blades: int, turn_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Left and right end of the polygon at heights y; left >= right where it does not reach."""
    middle = np.radians(turn_deg) + (np.arange(blades) + 0.5) * 2 * np.pi / blades
    apothem = circumradius * np.cos(np.pi / blades)
    left, right = np.full(y.shape, -2 * circumradius), np.full(y.shape, 2 * circumradius)
    for nx, ny in zip(np.cos(middle), np.sin(middle), strict=True):  # inside: nx x + ny y <= apothem
        if abs(nx) < 1e-9:
            outside = ny * y > apothem
            left, right = np.where(outside, 0.0, left), np.where(outside, 0.0, right)
        elif nx > 0:
            right = np.minimum(right, (apothem - ny * y) / nx)
        else:
            left = np.maximum(left, (apothem - ny * y) / nx)
    return left, right
