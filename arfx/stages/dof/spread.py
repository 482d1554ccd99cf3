"""Compiled: each pixel's light spread over its disc. Changes are marked and summed along the rows, O(radius) a pixel.

What is marked is a multiple of 2^-23 (light of 2^-17, area in 64ths of a pixel): sums below 2 are exact in float32. So a
row's running sum is exactly 0 behind the last disc, and neither the order nor the rectangle changes a bit of it."""

# mypy: disable-error-code="no-untyped-def, call-arg, assignment"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.dof.aperture import STEPS, Shape
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.four import add_between, add_four, add_two_between

_FLAGS = {"contract", "nsz", "arcp"}  # no re-association: the rounding below must stay
_SNAP = np.float32(1.5 * 2**6)  # adding and taking it away rounds to 2^-17
TILE_PX = 16  # splatted at once; a power of two
MIN_RUN = 4  # discs of one size side by side that are worth marking together


class SplatBuffers(NamedTuple):
    """Where a layer's light goes. fade : of the `Pyramid`

    finest : (h, w, 4) light of level 0, set where SHARP_PX < radius < fade[0, 1] in tiles that are `occupied` (th, tw) uint8
    cells : (n, 5) red, green, blue, weight, weight x radius of all further levels;  meta : (levels, 3) first cell, width,
    height;  offset_y, offset_x : px by which the rectangle's corner lies in a cell of the last level"""

    fade: np.ndarray
    cells: np.ndarray
    meta: np.ndarray
    offset_y: int
    offset_x: int
    finest: np.ndarray
    occupied: np.ndarray


class BlurredRows(NamedTuple):
    """Light of some rows of a layer, 0 outside of columns lo..hi. values : flat, of each level's rows, (rows, width + 1, 4)

    table : (n, 7), of each: level, first value, first row, height and width of the whole level, columns of the rectangle
    offset_y, offset_x : as of `SplatBuffers`"""

    values: np.ndarray
    table: np.ndarray
    offset_y: int
    offset_x: int
    lo: int
    hi: int


@numba.njit(cache=True, nogil=True)
def extremes(radius, y0, x0, y1, x1):  # pragma: no cover - compiled
    """Least and largest radius of a tile."""
    smallest, largest = radius[y0, x0], radius[y0, x0]
    for y in range(y0, y1):
        for x in range(x0, x1):
            r = radius[np.uintp(y), np.uintp(x)]
            smallest, largest = min(smallest, r), max(largest, r)
    return smallest, largest


@line_kernel()
def levels_of(smallest, largest, fade, levels):  # pragma: no cover - compiled
    """Lowest and highest level that light of radii least..most goes to."""
    low, high = 0, 0
    while low < levels - 1 and smallest >= fade[low, 1]:
        low += 1
    while high < levels - 1 and largest > fade[high, 0]:
        high += 1
    return low, high


@numba.njit(cache=True, nogil=True)
def highlight(level):  # pragma: no cover - compiled
    """Light above which a pixel goes one level lower; so that the sum of a cell's column shows whether there is any."""
    return max(np.float32(4), np.float32(1.001) * np.float32(1 << level))


@line_kernel(fastmath=_FLAGS)
def to_cell(buffers: SplatBuffers, level, y, x, a, b, c, d, r):  # pragma: no cover - compiled
    """Light a, b, c, d (weight) of one pixel with radius r to the level's cell that holds it."""
    meta, cells = buffers.meta, buffers.cells
    at = np.uintp(meta[level, 0] + ((y + buffers.offset_y) >> level) * meta[level, 1] + ((x + buffers.offset_x) >> level))
    cells[at, 0] += a
    cells[at, 1] += b
    cells[at, 2] += c
    cells[at, 3] += d
    cells[at, 4] += d * r


@line_kernel(fastmath=_FLAGS)
def splat_tile(source, radius, y0, x0, y1, x1, buffers: SplatBuffers):  # pragma: no cover - compiled
    """Hand light of the pixels y0..y1, x0..x1 (within one tile) to the one or two levels that their radii ask for.

    source : (TILE_PX, TILE_PX, 4) premultiplied light and weight;  radius : (h, w) px, at most SHARP_PX = none"""
    fade, cells, meta, offset_y, offset_x, finest, occupied = buffers
    levels = meta.shape[0]
    smallest, largest = extremes(radius, y0, x0, y1, x1)
    if largest <= SHARP_PX:
        return
    k, highest = levels_of(smallest, largest, fade, levels)
    alone = highest <= k
    if alone and k > 0:
        side, bright = 1 << k, highlight(k) if k > 1 else np.float32(np.inf)
        for top in range(y0 - ((y0 + offset_y) & (side - 1)), y1, side):
            for left in range(x0 - ((x0 + offset_x) & (side - 1)), x1, side):
                a, b, c, d, e = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                for y in range(max(top, y0), min(top + side, y1)):
                    for x in range(max(left, x0), min(left + side, x1)):
                        j, i = np.uintp(y - y0), np.uintp(x - x0)
                        if max(source[j, i, 0], max(source[j, i, 1], source[j, i, 2])) > bright:
                            r, s = radius[np.uintp(y), np.uintp(x)], source[j, i]
                            to_cell(buffers, k - 1, y, x, s[0], s[1], s[2], s[3], r)
                            continue
                        a += source[j, i, 0]
                        b += source[j, i, 1]
                        c += source[j, i, 2]
                        d += source[j, i, 3]
                        e += source[j, i, 3] * radius[np.uintp(y), np.uintp(x)]
                at = np.uintp(meta[k, 0] + ((top + offset_y) >> k) * meta[k, 1] + ((left + offset_x) >> k))
                cells[at, 0] += a
                cells[at, 1] += b
                cells[at, 2] += c
                cells[at, 3] += d
                cells[at, 4] += e
        return
    if k == 0:
        occupied[(y0 + offset_y) // TILE_PX - offset_y // TILE_PX, (x0 + offset_x) // TILE_PX - offset_x // TILE_PX] = 1
    if alone:
        for y in range(y0, y1):
            for x in range(x0, x1):
                j, i = np.uintp(y - y0), np.uintp(x - x0)
                for n in range(4):
                    finest[np.uintp(y), np.uintp(x), n] = source[j, i, n]
        return
    for y in range(y0, y1):
        for x in range(x0, x1):
            r = radius[np.uintp(y), np.uintp(x)]
            if r <= SHARP_PX:
                continue
            k = 0
            while k < levels - 1 and r >= fade[k, 1]:
                k += 1
            onward = np.float32(0)
            if k < levels - 1 and r > fade[k, 0]:
                onward = (r - fade[k, 0]) / (fade[k, 1] - fade[k, 0])
            j, i = np.uintp(y - y0), np.uintp(x - x0)
            if k > 0 and max(source[j, i, 0], max(source[j, i, 1], source[j, i, 2])) > highlight(k + 1):
                k, onward = max(k - 1, 1), onward if k > 1 else np.float32(0)
            for step in range(2):
                fraction = np.float32(1) - onward if step == 0 else onward
                level = k + step
                if fraction <= 0:
                    continue
                if level == 0:
                    for n in range(4):
                        finest[np.uintp(y), np.uintp(x), n] = source[j, i, n] * fraction
                else:
                    s = source[j, i]
                    to_cell(buffers, level, y, x, s[0] * fraction, s[1] * fraction, s[2] * fraction, s[3] * fraction, r)


@line_kernel(fastmath=_FLAGS)
def _mark(marks, q, y, x, low, high, width, line, unit, shape: Shape):  # pragma: no cover - compiled
    """Mark the rows of one disc, row q of `shape`, in rows low..high. marks : flat, (rows, width + 1, 4), from row low

    line : (4 width,) light of the disc's row of cells;  unit : fraction of it that a pixel gets"""
    places, changes, n = shape.places, shape.changes, shape.half_rows[q]
    red, green, blue, weight = line[4 * x] * unit, line[4 * x + 1] * unit, line[4 * x + 2] * unit, line[4 * x + 3] * unit
    red, green, blue, weight = red + _SNAP, green + _SNAP, blue + _SNAP, weight + _SNAP
    red, green, blue, weight = red - _SNAP, green - _SNAP, blue - _SNAP, weight - _SNAP
    for j in range(max(-n, low - y), min(n, high - 1 - y) + 1):
        i, row = np.uintp(j + n), (y + j - low) * (width + 1)
        for pair in range(places.shape[2]):
            a, b = changes[q, i, pair, 0], changes[q, i, pair, 1]
            if a == 0:
                break
            at = x + places[q, i, pair]
            add_four(marks, row + min(max(at, 0), width), red * a, green * a, blue * a, weight * a)
            add_four(marks, row + min(max(at + 1, 0), width), red * b, green * b, blue * b, weight * b)


@line_kernel(fastmath=_FLAGS)
def _add_shifted(marks, cell, light, count, begin, end):  # pragma: no cover - compiled
    """marks[cell + i] += light[i] begin + light[i - 1] end for i = 0..count. light : flat, a cell of zeros before and after"""
    to = marks[4 * cell : 4 * (cell + count + 1)]
    this, last = light[4 : 4 * (count + 2)], light[: 4 * (count + 1)]
    for i in range(4 * (count + 1)):
        to[i] += this[i] * begin + last[i] * end


@line_kernel(fastmath=_FLAGS)
def _mark_line(marks, y, low, high, width, size, line, area, run_light, shape: Shape):  # pragma: no cover - compiled
    """Mark the discs of one row of cells in rows low..high. Returns the columns marked (lo, hi).

    size : (width,) row of the shape table, -1 = no light;  line : (4 width,) light;  area : 1 / pixels of a cell
    run_light : scratch, 4 (width + 2)
    Neighbours of one size are marked together, row by row of their disc, which the compiler makes vectors of."""
    places, changes, unit, half_rows = shape
    stride = width + 1
    lo, hi = width, 0
    x = 0
    while x < width:
        q = size[x]
        first = x
        x += 1
        if q < 0:
            continue
        while x < width and size[x] == q:
            x += 1
        n, u = half_rows[q], area * unit[q]
        if y + n < low or y - n >= high:
            continue
        lo, hi = min(lo, first - n), max(hi, x + n + 1)  # the last mark of a row lies one beyond it
        begin, end = max(first, n), min(x, width - n - 1)
        if end - begin < MIN_RUN:
            begin, end = x, x
        for k in range(first, x):
            if k < begin or k >= end:
                _mark(marks, q, y, k, low, high, width, line, u, shape)
        count = end - begin
        if count <= 0:
            continue
        for k in range(4):
            run_light[k], run_light[4 * (count + 1) + k] = 0, 0
        for k in range(4 * count):
            run_light[4 + k] = (line[4 * begin + k] * u + _SNAP) - _SNAP
        for j in range(max(-n, low - y), min(n, high - 1 - y) + 1):
            i = np.uintp(j + n)
            row = (y + j - low) * stride + begin
            for pair in range(places.shape[2]):
                a, b = changes[q, i, pair, 0], changes[q, i, pair, 1]
                if a == 0:
                    break
                _add_shifted(marks, row + places[q, i, pair], run_light, count, a, b)
    return lo, hi


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_pixels(buffers: SplatBuffers, radius, limit_px, low, high, margin, marks, shape: Shape):  # pragma: no cover - compiled
    """Level 0: light of pixels with SHARP_PX < radius < limit_px onto rows low..high. Returns the columns marked (lo, hi)."""
    finest, occupied, offset_y, offset_x = buffers.finest, buffers.occupied, buffers.offset_y, buffers.offset_x
    first_x = offset_x // TILE_PX * TILE_PX - offset_x  # of the first tile
    h, w = radius.shape
    top = np.float32(shape.unit.shape[0] - 1)
    flat = marks.reshape(-1)
    size, run_light = np.empty(w, np.int32), np.empty(4 * (w + 2), np.float32)
    lo, hi = w, 0
    for y in range(max(low - margin, 0), min(high + margin, h)):
        tiles = occupied[(y + offset_y) // TILE_PX - offset_y // TILE_PX]
        any_light = False
        for tile in range(len(tiles)):
            a, b = max(first_x + tile * TILE_PX, 0), min(first_x + (tile + 1) * TILE_PX, w)
            if tiles[tile] == 0:
                size[a:b] = -1
                continue
            any_light = True
            for x in range(a, b):
                r = radius[y, x]
                size[x] = -1
                if r <= SHARP_PX or r >= limit_px or finest[y, x, 3] <= 0:
                    continue
                size[x] = int(min(r * STEPS + np.float32(0.5), top))
        if any_light:
            a, b = _mark_line(flat, y, low, high, w, size, finest[y].reshape(-1), np.float32(1), run_light, shape)
            lo, hi = min(lo, a), max(hi, b)
    return max(lo, 0), min(hi, w)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_cells(
    cells, width, height, level, filter_px2, low, high, margin, marks, shape: Shape
):  # fmt: skip  # pragma: no cover - compiled
    """Further levels: cells (height * width, 5) onto rows low..high of the level. Returns the columns marked (lo, hi)."""
    top = np.float32(shape.unit.shape[0] - 1)
    side = np.float32(1 << level)
    area = np.float32(1) / (side * side)
    flat = marks.reshape(-1)
    size, line = np.empty(width, np.int32), np.empty(4 * width, np.float32)
    run_light = np.empty(4 * (width + 2), np.float32)
    lo, hi = width, 0
    for y in range(max(low - margin, 0), min(high + margin, height)):
        any_light = False
        for x in range(width):
            k = np.uintp(y * width + x)
            size[x] = -1
            if cells[k, 3] <= 0:
                continue
            size[x], any_light = 0, True
            if cells[k, 4] * cells[k, 4] > filter_px2 * cells[k, 3] * cells[k, 3]:
                r = cells[k, 4] / cells[k, 3]
                r = np.sqrt(r * r - filter_px2) / side
                size[x] = int(min(r * STEPS + np.float32(0.5), top))
            for c in range(4):
                line[4 * x + c] = cells[k, c]
        if any_light:
            a, b = _mark_line(flat, y, low, high, width, size, line, area, run_light, shape)
            lo, hi = min(lo, a), max(hi, b)
    return max(lo, 0), min(hi, width)


@line_kernel(fastmath=_FLAGS)
def run_sums(marks, lo, hi):  # pragma: no cover - compiled
    """Marks to light: running sums along the rows, columns lo..hi, in place. Weights are exact, light brighter than 2 is
    not: where no weight is left no light is, so that nothing of a highlight's rounding goes on along its row."""
    for y in range(marks.shape[0]):
        a, b, c, d = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for x in range(np.uintp(lo), np.uintp(hi)):
            a += marks[y, x, 0]
            b += marks[y, x, 1]
            c += marks[y, x, 2]
            d += marks[y, x, 3]
            if d <= 0:
                a, b, c = np.float32(0), np.float32(0), np.float32(0)
            marks[y, x, 0], marks[y, x, 1], marks[y, x, 2], marks[y, x, 3] = a, b, c, d


@line_kernel(fastmath=_FLAGS)
def light_of_row(line, y, light: BlurredRows, lo, hi, between):  # pragma: no cover - compiled
    """line (4 w,) = light that reaches row y of the rectangle, columns lo..hi: all levels, bilinear between their cells.

    between : scratch, 4 (w + ALIGN_PX): cells count from lead_x on"""
    values, table, offset_y, offset_x, _, _ = light
    line[4 * lo : 4 * hi] = 0
    for part in range(table.shape[0]):
        level, first, first_row, height, width, left, right = table[part]
        left, right = max(left, lo), min(right, hi)
        if left >= right:
            continue
        stride = 4 * (width + 1)
        if level == 0:
            at = first + (y - first_row) * stride
            own, to = values[at + 4 * left : at + 4 * right], line[4 * left : 4 * right]
            for n in range(len(to)):
                to[n] += own[n]
            continue
        side, half = 1 << level, 1 << level - 1
        step = np.float32(1) / np.float32(side)
        begin, end = left + offset_x - half, right + offset_x - half  # from the middle of the first cell, as x below
        j = (y + offset_y - half) >> level
        t = (np.float32(y + offset_y - half - (j << level)) + np.float32(0.5)) * step
        a, b = min(max(j, 0), height - 1) - first_row, min(max(j + 1, 0), height - 1) - first_row
        one, after = 4 * max(begin >> level, 0), 4 * min(((end - 1) >> level) + 2, width)
        up, down = first + a * stride, first + b * stride
        upper, lower, cells = values[up + one : up + after], values[down + one : down + after], between[one:after]
        for n in range(len(cells)):
            cells[n] = upper[n] + (lower[n] - upper[n]) * t
        # cells whose pixels, up to the next cell's middle, are all wanted and have a cell on both sides; then the rest
        first_whole, after_whole = max((begin + side - 1) >> level, 0), min(end >> level, width - 1)
        i = first_whole
        while i < after_whole:
            if not between[4 * i + 7] > 0 and not between[4 * i + 3] > 0:
                i += 1
                continue
            run = i  # cells with light, up to one behind them
            while i < after_whole and (between[4 * i + 3] > 0 or between[4 * i + 7] > 0):
                i += 1
            for n in range(half):
                t = (np.float32(2 * n) + np.float32(0.5)) * step
                for k in range(run, i):
                    add_two_between(line, (k << level) + half - offset_x + 2 * n, between, k, t, step)
        i = begin >> level
        while i < ((end - 1) >> level) + 1:
            if i == first_whole and after_whole > i:
                i = after_whole
                continue
            p, q, x = max(i, 0), min(i + 1, width - 1), i << level
            for n in range(max(begin - x, 0), min(end - x, side)):
                add_between(line, x + half - offset_x + n, between, p, q, (np.float32(n) + np.float32(0.5)) * step)
            i += 1
