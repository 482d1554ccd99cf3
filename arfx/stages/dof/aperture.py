"""What one blur circle looks like on the pixel grid: rows of the disc, or of an n-blade polygon of the same area.

A row is kept as what it changes by from pixel to pixel, in multiples of 1/64 so that float32 sums of them stay exact
(spread.py). A disc of at most half a pixel's radius lies within its own pixel: no blur."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

STEPS = 16  # radii a pixel in the table
UNIT_BITS = 17  # fraction of the light that a disc adds to a pixel (spread.py)
SUBROWS = 16  # lines of a pixel by which the area of a shape in it is found
_UNITS = 64  # of a pixel's area
_PAIRS = 2  # of changes in a row: where it begins and where it ends


class Shape(NamedTuple):
    """Rows of the blur circle by radius: index q = round(radius px * STEPS), row j + half_rows[q] for j = -half_rows..half_rows.

    places : (q, rows, pairs) int32, a pixel, from the centre, that is followed by one more
    changes : (q, rows, pairs, 2) float32, by how much more of both is covered than of the pixel before each
    unit : (q,) float32, 1 / area to UNIT_BITS, so that a full pixel's weight is not rounded again when it is spread
    half_rows : (q,) int32, rows beyond the centre's"""

    places: np.ndarray
    changes: np.ndarray
    unit: np.ndarray
    half_rows: np.ndarray


@lru_cache(maxsize=16)
def shape(largest_px: int, blades: int = 0, turn_deg: float = 0.0) -> Shape:
    """Table for radii 0..largest_px. blades : 0 = disc, else corners of the polygon, the first at turn_deg from x.

    A row with more partial pixels than fit is a run with one at each end."""
    count = largest_px * STEPS + 1
    radius = np.arange(count) / STEPS
    half_rows = np.ceil(radius * circumradius(blades) - 0.5).clip(0).astype(np.int32)
    half_rows[radius <= 0.5] = 0
    rows = 2 * int(half_rows.max()) + 1
    places = np.zeros((count, rows, _PAIRS), np.int32)
    changes = np.zeros((count, rows, _PAIRS, 2), np.float32)
    unit = np.zeros(count, np.float32)
    for q in range(count):
        left, right = chords(radius[q], int(half_rows[q]), blades, turn_deg)
        if radius[q] <= 0.5:
            left, right = np.full_like(left, -0.5), np.full_like(right, 0.5)
        area_px = _rows_of(left, right, places[q], changes[q])
        unit[q] = max(np.round(2.0**UNIT_BITS / area_px), 1) / 2.0**UNIT_BITS
    return Shape(places, changes, unit, half_rows)


@numba.njit(cache=True, nogil=True)
def _rows_of(left, right, places, changes):  # pragma: no cover - compiled
    """Rows of one shape from its chords (rows, lines), px; the table's rows are all 0. Returns its area, px."""
    rows, lines = left.shape
    half, pairs, total = rows // 2, places.shape[1], 0.0
    width = 2 * (half + 2) + 1
    middle, row, step = width // 2, np.empty(width), np.empty(width + 1)
    for j in range(rows):
        for run in range(2):
            row[:] = 0
            if run == 0:
                for k in range(lines):
                    for x in range(width):
                        part = min(right[j, k], x - middle + 0.5) - max(
                            left[j, k], x - middle - 0.5
                        )
                        row[x] += max(part, 0.0) / lines
            else:
                inside, begin, end = 0, 0.0, 0.0
                for k in range(lines):
                    if right[j, k] > left[j, k]:
                        inside, begin, end = inside + 1, begin + left[j, k], end + right[j, k]
                begin, end = begin / max(inside, 1), end / max(inside, 1)
                for x in range(width):
                    row[x] = (
                        max(min(end, x - middle + 0.5) - max(begin, x - middle - 0.5), 0.0)
                        * inside
                        / lines
                    )
            before, used, after = 0.0, 0, -1
            for x in range(width + 1):
                now = np.rint(row[x] * _UNITS) / _UNITS if x < width else 0.0
                step[x], before = now - before, now
                if step[x] != 0 and x > after:
                    used, after = used + 1, x + 1
            if used <= pairs:
                break
        used, after, level = 0, -1, 0.0
        for x in range(width + 1):
            level += step[x]
            total += level
            if step[x] != 0 and x > after:
                places[j, used], changes[j, used, 0], after = x - middle, step[x], x + 1
                changes[j, used, 1] = step[x + 1] if x < width else 0.0
                used += 1
    return total


def circumradius(blades: int) -> float:
    """Of a polygon whose area is that of a disc of radius 1."""
    return 1.0 if blades < 3 else float(np.sqrt(2 * np.pi / (blades * np.sin(2 * np.pi / blades))))


def chords(
    radius: float, half_rows: int, blades: int, turn_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """(rows, SUBROWS) left and right ends of the shape on lines of each row of pixels; left >= right where it does not reach."""
    rows = np.arange(-half_rows, half_rows + 1.0)[:, None]
    return chord(rows + (np.arange(SUBROWS) + 0.5) / SUBROWS - 0.5, radius, blades, turn_deg)


def chord(
    y: np.ndarray, radius: float, blades: int, turn_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Left and right end of the disc or polygon at heights y; left >= right where it does not reach."""
    if blades < 3:
        half = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        return -half, half
    circumradius_px = radius * circumradius(blades)
    middle = np.radians(turn_deg) + (np.arange(blades) + 0.5) * 2 * np.pi / blades
    apothem = circumradius_px * np.cos(np.pi / blades)
    left, right = np.full(y.shape, -2 * circumradius_px), np.full(y.shape, 2 * circumradius_px)
    for nx, ny in zip(
        np.cos(middle), np.sin(middle), strict=True
    ):  # inside: nx x + ny y <= apothem
        if abs(nx) < 1e-9:
            outside = ny * y > apothem
            left, right = np.where(outside, 0.0, left), np.where(outside, 0.0, right)
        elif nx > 0:
            right = np.minimum(right, (apothem - ny * y) / nx)
        else:
            left = np.maximum(left, (apothem - ny * y) / nx)
    return left, right
