"""Compiled: each pixel's light spread over its disc. Row ends are marked and summed along the rows, O(radius) a pixel.

What is marked is a multiple of 2^-23 (light of 2^-17, shares of a row in eighths): sums below 2 are exact in float32. So a
row's running sum is exactly 0 behind the last disc, and neither the order nor the rectangle changes a bit of it.
"""

# mypy: disable-error-code="no-untyped-def, call-arg, assignment"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.dof.aperture import STEPS, Shape
from arfx.stages.dof.ladder import SHARP_PX
from arfx.stages.four import add_between, add_four, add_two_between

_FLAGS = {"contract", "nsz", "arcp"}  # no re-association: the rounding below must stay
_SNAP = np.float32(1.5 * 2**6)  # adding and taking it away rounds to 2^-17
TILE_PX = 16  # deposited at once; a power of two
FEWEST_ALIKE = 4  # discs of one size side by side that are worth marking together


class Sink(NamedTuple):
    """Where a layer's light goes. fade : of the `Ladder`

    near : (h, w, 4) light of rung 0, set where SHARP_PX < radius < fade[0, 1] in tiles that are `held` (th, tw) uint8
    cells : (n, 5) red, green, blue, weight, weight x radius of all further rungs;  meta : (rungs, 3) first cell, width,
    height;  lead_y, lead_x : px by which the rectangle's corner lies in a cell of the last rung
    """

    fade: np.ndarray
    cells: np.ndarray
    meta: np.ndarray
    lead_y: int
    lead_x: int
    near: np.ndarray
    held: np.ndarray


class Light(NamedTuple):
    """Light of some rows of a layer, 0 outside of columns lo..hi. values : flat, of each rung's rows, (rows, width + 1, 4)

    table : (n, 7), of each: rung, first value, first row, height and width of the whole rung, columns of the rectangle
    lead_y, lead_x : as of `Sink`
    """

    values: np.ndarray
    table: np.ndarray
    lead_y: int
    lead_x: int
    lo: int
    hi: int


@numba.njit(cache=True, nogil=True)
def extremes(radius, y0, x0, y1, x1):  # pragma: no cover - compiled
    """Least and largest radius of a tile."""
    least, most = radius[y0, x0], radius[y0, x0]
    for y in range(y0, y1):
        for x in range(x0, x1):
            r = radius[np.uintp(y), np.uintp(x)]
            least, most = min(least, r), max(most, r)
    return least, most


@numba.njit(cache=True, nogil=True)
def only_rung(least, most, fade, rungs):  # pragma: no cover - compiled
    """The rung that takes all of the light of radii least..most; -1 where two share it."""
    k = 0
    while k < rungs - 1 and least >= fade[k, 1]:
        k += 1
    return k if k == rungs - 1 or most <= fade[k, 0] else -1


@numba.njit(cache=True, nogil=True)
def highlight(rung):  # pragma: no cover - compiled
    """Light above which a pixel goes one rung lower; so that the sum of a cell's column tells whether there is any."""
    return max(np.float32(4), np.float32(1.001) * np.float32(1 << rung))


@line_kernel(fastmath=_FLAGS)
def to_cell(sink: Sink, rung, y, x, a, b, c, d, r):  # pragma: no cover - compiled
    """Light a, b, c, d (weight) of one pixel with radius r to the rung's cell that holds it."""
    meta, cells = sink.meta, sink.cells
    at = np.uintp(meta[rung, 0] + ((y + sink.lead_y) >> rung) * meta[rung, 1] + ((x + sink.lead_x) >> rung))
    cells[at, 0] += a
    cells[at, 1] += b
    cells[at, 2] += c
    cells[at, 3] += d
    cells[at, 4] += d * r


@line_kernel(fastmath=_FLAGS)
def deposit_tile(source, radius, y0, x0, y1, x1, sink: Sink):  # pragma: no cover - compiled
    """Hand light of the pixels y0..y1, x0..x1 (within one tile) to the one or two rungs that their radii ask for.

    source : (TILE_PX, TILE_PX, 4) premultiplied light and weight;  radius : (h, w) px, at most SHARP_PX = none
    """
    fade, cells, meta, lead_y, lead_x, near, held = sink
    rungs = meta.shape[0]
    least, most = extremes(radius, y0, x0, y1, x1)
    if most <= SHARP_PX:
        return
    k = only_rung(least, most, fade, rungs)
    if k > 0:
        side, bright = 1 << k, highlight(k) if k > 1 else np.float32(np.inf)
        for top in range(y0 - ((y0 + lead_y) & (side - 1)), y1, side):
            for left in range(x0 - ((x0 + lead_x) & (side - 1)), x1, side):
                a, b, c, d, e = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                for y in range(max(top, y0), min(top + side, y1)):
                    for x in range(max(left, x0), min(left + side, x1)):
                        j, i = np.uintp(y - y0), np.uintp(x - x0)
                        if max(source[j, i, 0], max(source[j, i, 1], source[j, i, 2])) > bright:
                            r, s = radius[np.uintp(y), np.uintp(x)], source[j, i]
                            to_cell(sink, k - 1, y, x, s[0], s[1], s[2], s[3], r)
                            continue
                        a += source[j, i, 0]
                        b += source[j, i, 1]
                        c += source[j, i, 2]
                        d += source[j, i, 3]
                        e += source[j, i, 3] * radius[np.uintp(y), np.uintp(x)]
                at = np.uintp(meta[k, 0] + ((top + lead_y) >> k) * meta[k, 1] + ((left + lead_x) >> k))
                cells[at, 0] += a
                cells[at, 1] += b
                cells[at, 2] += c
                cells[at, 3] += d
                cells[at, 4] += e
        return
    if least < fade[0, 1] or k == 0:
        held[(y0 + lead_y) // TILE_PX - lead_y // TILE_PX, (x0 + lead_x) // TILE_PX - lead_x // TILE_PX] = 1
    if k == 0:
        for y in range(y0, y1):
            for x in range(x0, x1):
                j, i = np.uintp(y - y0), np.uintp(x - x0)
                for n in range(4):
                    near[np.uintp(y), np.uintp(x), n] = source[j, i, n]
        return
    for y in range(y0, y1):
        for x in range(x0, x1):
            r = radius[np.uintp(y), np.uintp(x)]
            if r <= SHARP_PX:
                continue
            k = 0
            while k < rungs - 1 and r >= fade[k, 1]:
                k += 1
            onward = np.float32(0)
            if k < rungs - 1 and r > fade[k, 0]:
                onward = (r - fade[k, 0]) / (fade[k, 1] - fade[k, 0])
            j, i = np.uintp(y - y0), np.uintp(x - x0)
            if k > 0 and max(source[j, i, 0], max(source[j, i, 1], source[j, i, 2])) > highlight(k + 1):
                k, onward = max(k - 1, 1), onward if k > 1 else np.float32(0)
            for step in range(2):
                share = np.float32(1) - onward if step == 0 else onward
                rung = k + step
                if share <= 0:
                    continue
                if rung == 0:
                    for n in range(4):
                        near[np.uintp(y), np.uintp(x), n] = source[j, i, n] * share
                else:
                    s = source[j, i]
                    to_cell(sink, rung, y, x, s[0] * share, s[1] * share, s[2] * share, s[3] * share, r)


@numba.njit(nogil=True)
def _mark_ends(marks, at, light, share, first, last):  # pragma: no cover - compiled
    """Ends of one row of a disc, in cells of four: with v = light share and at = a, b, c, d, marks[a] += v first,
    marks[b] += v - v first, marks[c] -= v - v last, marks[d] -= v last. marks : flat;  light : red, green, blue, weight"""
    a, b, c, d = at
    red, green, blue, weight = light[0] * share, light[1] * share, light[2] * share, light[3] * share
    begin = red * first, green * first, blue * first, weight * first
    end = red * last, green * last, blue * last, weight * last
    add_four(marks, a, begin[0], begin[1], begin[2], begin[3])
    add_four(marks, b, red - begin[0], green - begin[1], blue - begin[2], weight - begin[3])
    add_four(marks, c, end[0] - red, end[1] - green, end[2] - blue, end[3] - weight)
    add_four(marks, d, -end[0], -end[1], -end[2], -end[3])


@line_kernel(fastmath=_FLAGS)
def _mark(marks, q, y, x, low, high, width, line, unit, shape: Shape):  # pragma: no cover - compiled
    """Mark the row ends of one disc, row q of `shape`, in rows low..high. marks : flat, (rows, width + 1, 4), from row low

    line : (4 width,) light of the disc's row of cells;  unit : share of it that a pixel gets
    """
    ends, shares, n = shape.ends, shape.shares, shape.reach[q]
    red, green, blue, weight = line[4 * x] * unit, line[4 * x + 1] * unit, line[4 * x + 2] * unit, line[4 * x + 3] * unit
    red, green, blue, weight = red + _SNAP, green + _SNAP, blue + _SNAP, weight + _SNAP
    red, green, blue, weight = red - _SNAP, green - _SNAP, blue - _SNAP, weight - _SNAP
    stride = width + 1
    inside = x >= n and x + n + 2 <= width
    for j in range(max(-n, low - y), min(n, high - 1 - y) + 1):
        i = np.uintp(j + n)
        first, last = x + ends[q, i, 0], x + ends[q, i, 1]
        a, b, c, d = first, first + 1, last, last + 1
        if not inside:
            a, b, c, d = min(max(a, 0), width), min(max(b, 0), width), min(max(c, 0), width), min(max(d, 0), width)
        row = (y + j - low) * stride
        share, begin, end = shares[q, i, 0], shares[q, i, 1], shares[q, i, 2]
        _mark_ends(marks, (row + a, row + b, row + c, row + d), (red, green, blue, weight), share, begin, end)


@line_kernel(fastmath=_FLAGS)
def _add_shifted(marks, cell, light, count, begin, end):  # pragma: no cover - compiled
    """marks[cell + i] += light[i] begin + light[i - 1] end for i = 0..count. light : flat, a cell of zeros before and after"""
    to = marks[4 * cell : 4 * (cell + count + 1)]
    this, last = light[4 : 4 * (count + 2)], light[: 4 * (count + 1)]
    for i in range(4 * (count + 1)):
        to[i] += this[i] * begin + last[i] * end


@line_kernel(fastmath=_FLAGS)
def _mark_line(marks, y, low, high, width, size, line, area, alike, shape: Shape):  # pragma: no cover - compiled
    """Mark the discs of one row of cells in rows low..high. Returns the columns marked (lo, hi).

    size : (width,) row of the shape table, -1 = no light;  line : (4 width,) light;  area : 1 / pixels of a cell
    alike : scratch, 4 (width + 2)
    Neighbours of one size are marked together, row by row of their disc, which the compiler makes vectors of.
    """
    ends, shares, unit, reach = shape
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
        n, u = reach[q], area * unit[q]
        if y + n < low or y - n >= high:
            continue
        lo, hi = min(lo, first - n), max(hi, x + n + 1)  # the last mark of a row lies one beyond it
        begin, end = max(first, n), min(x, width - n - 1)
        if end - begin < FEWEST_ALIKE:
            begin, end = x, x
        for k in range(first, x):
            if k == begin:
                break
            _mark(marks, q, y, k, low, high, width, line, u, shape)
        for k in range(end, x):
            _mark(marks, q, y, k, low, high, width, line, u, shape)
        count = end - begin
        if count <= 0:
            continue
        for k in range(4):
            alike[k], alike[4 * (count + 1) + k] = 0, 0
        for k in range(4 * count):
            alike[4 + k] = (line[4 * begin + k] * u + _SNAP) - _SNAP
        for j in range(max(-n, low - y), min(n, high - 1 - y) + 1):
            i = np.uintp(j + n)
            row, share = (y + j - low) * stride + begin, shares[q, i, 0]
            before, after = shares[q, i, 1] * share, shares[q, i, 2] * share
            _add_shifted(marks, row + ends[q, i, 0], alike, count, before, share - before)
            _add_shifted(marks, row + ends[q, i, 1], alike, count, after - share, -after)
    return lo, hi


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_pixels(sink: Sink, radius, until, low, high, far, marks, shape: Shape):  # pragma: no cover - compiled
    """Rung 0: light of pixels with SHARP_PX < radius < until onto rows low..high. Returns the columns marked (lo, hi)."""
    near, held, lead_y, lead_x = sink.near, sink.held, sink.lead_y, sink.lead_x
    first_x = lead_x // TILE_PX * TILE_PX - lead_x  # of the first tile
    h, w = radius.shape
    top = np.float32(shape.unit.shape[0] - 1)
    flat = marks.reshape(-1)
    size, alike = np.empty(w, np.int32), np.empty(4 * (w + 2), np.float32)
    lo, hi = w, 0
    for y in range(max(low - far, 0), min(high + far, h)):
        tiles = held[(y + lead_y) // TILE_PX - lead_y // TILE_PX]
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
                if r <= SHARP_PX or r >= until or near[y, x, 3] <= 0:
                    continue
                size[x] = int(min(r * STEPS + np.float32(0.5), top))
        if any_light:
            a, b = _mark_line(flat, y, low, high, w, size, near[y].reshape(-1), np.float32(1), alike, shape)
            lo, hi = min(lo, a), max(hi, b)
    return max(lo, 0), min(hi, w)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_cells(
    cells, width, height, rung, cut_px2, low, high, far, marks, shape: Shape
):  # fmt: skip  # pragma: no cover - compiled
    """Further rungs: cells (height * width, 5) onto rows low..high of the rung. Returns the columns marked (lo, hi)."""
    top = np.float32(shape.unit.shape[0] - 1)
    side = np.float32(1 << rung)
    area = np.float32(1) / (side * side)
    flat = marks.reshape(-1)
    size, line = np.empty(width, np.int32), np.empty(4 * width, np.float32)
    alike = np.empty(4 * (width + 2), np.float32)
    lo, hi = width, 0
    for y in range(max(low - far, 0), min(high + far, height)):
        any_light = False
        for x in range(width):
            k = np.uintp(y * width + x)
            size[x] = -1
            if cells[k, 3] <= 0:
                continue
            r = cells[k, 4] / cells[k, 3]
            r = np.sqrt(max(r * r - cut_px2, np.float32(0))) / side
            size[x] = int(min(r * STEPS + np.float32(0.5), top))
            any_light = True
            for c in range(4):
                line[4 * x + c] = cells[k, c]
        if any_light:
            a, b = _mark_line(flat, y, low, high, width, size, line, area, alike, shape)
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
def light_of_row(line, y, light: Light, lo, hi, between):  # pragma: no cover - compiled
    """line (4 w,) = light that reaches row y of the rectangle, columns lo..hi: all rungs, bilinear between their cells.

    between : scratch, 4 (w + ALIGN_PX): cells count from lead_x on
    """
    values, table, lead_y, lead_x, _, _ = light
    for n in range(4 * lo, 4 * hi):
        line[n] = 0
    for part in range(table.shape[0]):
        rung, first, first_row, height, width, left, right = table[part]
        left, right = max(left, lo), min(right, hi)
        if left >= right:
            continue
        stride = 4 * (width + 1)
        if rung == 0:
            at = first + (y - first_row) * stride
            own, to = values[at + 4 * left : at + 4 * right], line[4 * left : 4 * right]
            for n in range(len(to)):
                to[n] += own[n]
            continue
        side, half = 1 << rung, 1 << rung - 1
        step = np.float32(1) / np.float32(side)
        begin, end = left + lead_x - half, right + lead_x - half  # from the middle of the first cell, as x below
        j = (y + lead_y - half) >> rung
        t = (np.float32(y + lead_y - half - (j << rung)) + np.float32(0.5)) * step
        a, b = min(max(j, 0), height - 1) - first_row, min(max(j + 1, 0), height - 1) - first_row
        one, after = 4 * max(begin >> rung, 0), 4 * min(((end - 1) >> rung) + 2, width)
        up, down = first + a * stride, first + b * stride
        upper, lower, cells = values[up + one : up + after], values[down + one : down + after], between[one:after]
        for n in range(len(cells)):
            cells[n] = upper[n] + (lower[n] - upper[n]) * t
        # cells whose pixels, up to the next cell's middle, are all wanted and have a cell on both sides; then the rest
        first_whole, after_whole = max((begin + side - 1) >> rung, 0), min(end >> rung, width - 1)
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
                    add_two_between(line, (k << rung) + half - lead_x + 2 * n, between, k, t, step)
        i = begin >> rung
        while i < ((end - 1) >> rung) + 1:
            if i == first_whole and after_whole > i:
                i = after_whole
                continue
            p, q, x = max(i, 0), min(i + 1, width - 1), i << rung
            for n in range(max(begin - x, 0), min(end - x, side)):
                add_between(line, x + half - lead_x + n, between, p, q, (np.float32(n) + np.float32(0.5)) * step)
            i += 1
