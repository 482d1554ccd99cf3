"""What one blur circle looks like on the pixel grid: rows of the disc, or of an n-blade polygon of the same area.

A row is a run of pixels with fractional ends, in eighths of a pixel so that float32 sums of them stay exact (spread.py).
A disc of at most half a pixel's radius lies within its own pixel: no blur."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

STEPS = 16  # radii a pixel in the table
UNIT_BITS = 17  # fraction of the light that a disc adds to a pixel (spread.py)
_SUBROWS = 8  # lines by which a row's ends are averaged


class Shape(NamedTuple):
    """Rows of the blur circle by radius: index q = round(radius px * STEPS), row j + reach[q] for j = -reach..reach.

    ends : (q, rows, 2) int32, first and last pixel of the row, from the centre; last > first
    fractions : (q, rows, 3) float32, multiples of 1/8 in 0..1: of the row's height; of the first and of the last pixel
    unit : (q,) float32, 1 / area to UNIT_BITS, so that a full pixel's weight is not rounded again when it is spread
    half_rows : (q,) int32, rows beyond the centre's"""

    ends: np.ndarray
    fractions: np.ndarray
    unit: np.ndarray
    half_rows: np.ndarray


@lru_cache(maxsize=16)
def shape(largest_px: int, blades: int = 0, turn_deg: float = 0.0) -> Shape:
    """Table for radii 0..largest_px. blades : 0 = disc, else corners of the polygon, the first at turn_deg from x."""
    count = largest_px * STEPS + 1
    radius = np.arange(count) / STEPS
    half_rows = np.ceil(radius * _circumradius(blades) - 0.5).clip(0).astype(np.int32)
    half_rows[radius <= 0.5] = 0
    rows = 2 * int(half_rows.max()) + 1
    ends = np.zeros((count, rows, 2), np.int32)
    fractions = np.zeros((count, rows, 3), np.float32)
    unit = np.zeros(count, np.float32)
    for q in range(count):
        n = 2 * int(half_rows[q]) + 1
        left, right, covered = _rows(radius[q], int(half_rows[q]), blades, turn_deg)
        if radius[q] <= 0.5:
            left, right, covered = np.full(n, -0.5), np.full(n, 0.5), np.ones(n)
        left, right = (np.round(8 * x) / 8 for x in (left, np.maximum(right, left + 1 / 8)))
        a, b = np.floor(left + 0.5), np.ceil(right - 0.5)
        one = a >= b  # all within one pixel: it is covered by the run's length
        ends[q, :n, 0], ends[q, :n, 1] = a, np.where(one, a + 1, b)
        fractions[q, :n, 0] = covered
        fractions[q, :n, 1] = np.where(one, right - left, a + 0.5 - left)
        fractions[q, :n, 2] = np.where(one, 0.0, right - (b - 0.5))
        area = float(((right - left) * covered).sum())
        unit[q] = max(np.round(2.0**UNIT_BITS / area), 1) / 2.0**UNIT_BITS
    return Shape(ends, fractions, unit, half_rows)


def _circumradius(blades: int) -> float:
    """Of a polygon whose area is that of a disc of radius 1."""
    return 1.0 if blades < 3 else float(np.sqrt(2 * np.pi / (blades * np.sin(2 * np.pi / blades))))


def _rows(radius: float, half_rows: int, blades: int, turn_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean left and right end of every row, px, and the fraction of the row's height that the shape takes."""
    y = (np.arange(-half_rows, half_rows + 1)[:, None] + (np.arange(_SUBROWS) + 0.5) / _SUBROWS - 0.5).astype(float)
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
