"""Compiled: light of the layers onto the pyramid, tile by tile."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.spread import (
    TILE_PX,
    SplatBuffers,
    extremes,
    highlight,
    levels_of,
    splat_tile,
    to_cell,
)

_FLAGS = {"contract", "nsz", "arcp"}
CLIPPED = np.float32(0.9)  # linear light from which a highlight boost sets in; full at 1


class OccluderPixels(NamedTuple):
    """Of an occluder: blur radius (h, w) px, premultiplied colour (h, w, 3), which is read-only, and coverage (h, w)."""

    radius: np.ndarray
    colour: np.ndarray
    coverage: np.ndarray
    opacity: np.float32


@line_kernel(fastmath=_FLAGS)
def boosted(red, green, blue, boost):  # pragma: no cover - compiled
    largest = max(red, max(green, blue))
    return np.float32(1) + boost * min(
        max((largest - CLIPPED) / (np.float32(1) - CLIPPED), np.float32(0)), np.float32(1)
    )


@line_kernel()
def _extremes(bits, y0, x0, y1, x1):  # pragma: no cover - compiled
    """Least and greatest of a tile, of the bits of float32 >= 0, which are ordered as their values are."""
    smallest, largest = bits[y0, x0], bits[y0, x0]
    for y in range(y0, y1):
        line = bits[y, x0:x1]
        for x in range(len(line)):
            smallest, largest = min(smallest, line[x]), max(largest, line[x])
    return smallest, largest


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def splat_real(
    top, bottom, begin, end, radius, real: RealPixels, visibility, boost, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """Rows top..bottom, columns begin..end (borders of tiles) of the real scene; returns whether any of it is blurred.

    real : `flat`;  radius : (h, w) px, >= 0;  visibility : (h, w) fraction that no finite plane hides, (0, 0) = all"""
    image, patch, box = real
    fade, offset_y, offset_x, levels = (
        buffers.fade,
        buffers.offset_y,
        buffers.offset_x,
        buffers.meta.shape[0],
    )
    whole = visibility.shape[0] == 0
    width, bits, seen = end, radius.view(np.int32), visibility.view(np.int32)
    source, ends = np.empty((TILE_PX, TILE_PX, 4), np.float32), np.empty(2, np.int32)
    extreme = ends.view(np.float32)
    work = np.empty(15 * width, np.float32)
    left = begin - ((begin + offset_x) & (TILE_PX - 1))
    blurred = False
    tiles = (width - left + TILE_PX - 1) // TILE_PX
    lowest, highest = (
        np.empty(tiles, np.int64),
        np.empty(tiles, np.int64),
    )  # levels of each tile; -1 = nothing blurred
    patched, plain = np.empty(tiles, np.bool_), np.empty(tiles, np.bool_)
    for y0 in range(top - ((top + offset_y) & (TILE_PX - 1)), bottom, TILE_PX):
        ya, yb = max(y0, top), min(y0 + TILE_PX, bottom)
        for i in range(tiles):
            xa, xb = max(left + i * TILE_PX, 0), min(left + (i + 1) * TILE_PX, width)
            ends[0], ends[1] = _extremes(bits, ya, xa, yb, xb)
            patched[i] = box[0] <= xa and xb <= box[2] and box[1] <= ya and yb <= box[3]
            lowest[i], highest[i] = -1, -1
            if extreme[1] <= SHARP_PX:
                continue
            blurred = True
            lowest[i], highest[i] = levels_of(extreme[0], extreme[1], fade, levels)
            plain[i] = boost <= 0
            if not whole:
                ends[0], ends[1] = _extremes(seen, ya, xa, yb, xb)
                plain[i] = plain[i] and extreme[0] >= 1
        after = 0
        for i in range(tiles):
            if i < after or highest[i] < 0:
                continue
            xa, xb = max(left + i * TILE_PX, 0), min(left + (i + 1) * TILE_PX, width)
            light, up, along = (patch, box[1], box[0]) if patched[i] else (image, 0, 0)
            if plain[i] and _alike(lowest[i], highest[i]):
                after = i + 1  # as many tiles as there are alike: memory is read along the rows
                while (
                    after < tiles
                    and (lowest[after], highest[after]) == (lowest[i], highest[i])
                    and patched[after] == patched[i]
                    and plain[after]
                ):
                    after += 1
                xb = min(left + after * TILE_PX, width)
                part = light[ya - up : yb - up, 3 * (xa - along) : 3 * (xb - along)]
                _to_cells(lowest[i], highest[i], ya, xa, radius, part, work, buffers)
                continue
            for y in range(ya, yb):
                for x in range(xa, xb):
                    weight, k = np.float32(1), np.float32(1)
                    first = 3 * (x - along)
                    red, green, blue = (
                        light[y - up, first],
                        light[y - up, first + 1],
                        light[y - up, first + 2],
                    )
                    if not plain[i]:
                        if not whole:
                            weight = visibility[y, x]
                            k = weight
                        if boost > 0:
                            k *= boosted(red, green, blue, boost)
                    to = source[y - ya, x - xa]
                    to[0], to[1], to[2], to[3] = red * k, green * k, blue * k, weight
            splat_tile(source, radius, ya, xa, yb, xb, buffers)
    return blurred


@line_kernel()
def _alike(low, high):  # pragma: no cover - compiled
    """Whether `_to_cells` takes a tile of these levels."""
    return 0 < low <= high <= low + 1


@line_kernel(fastmath=_FLAGS)
def _to_cells(
    low, high, ya, xa, radius, part, work, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """Tiles of weight 1 to level low, or to low and low + 1 = high.

    part : (rows, 3 columns) light from row ya, column xa"""
    if high == low:
        _sum_cells(low, ya, xa, radius, part, work, buffers)
    else:
        _split_cells(low, ya, xa, radius, part, work, buffers)


@line_kernel(fastmath=_FLAGS)
def _sum_cells(k, ya, xa, radius, part, work, buffers: SplatBuffers):  # pragma: no cover - compiled
    """Tiles of the real scene that all go to level k: summed by columns first, which the compiler makes vectors of.

    part : (rows, 3 columns) light from row ya, column xa;  work : (15, w) scratch, flat"""
    side, count, end = 1 << k, part.shape[1] // 3, ya + part.shape[0]
    bright = highlight(k) if k > 1 else np.float32(np.inf)
    offset_y = buffers.offset_y
    line, sums, weight = work[: 3 * count], work[3 * count : 4 * count], work[4 * count : 5 * count]
    for cy in range((ya + offset_y) >> k, ((end - 1 + offset_y) >> k) + 1):
        top, bottom = max(cy * side - offset_y, ya), min((cy + 1) * side - offset_y, end)
        for n in range(4 * count):
            work[n] = 0
        for n in range(count):
            weight[n] = np.float32(bottom - top)
        for y in range(top, bottom):
            p, r = part[y - ya], radius[y, xa : xa + count]
            for n in range(3 * count):
                line[n] += p[n]
            for n in range(count):
                sums[n] += r[n]
        above = 0
        for n in range(3 * count):
            above += line[n] > bright
        if above > 0:  # take the highlights out again, and to the level below
            for y in range(top, bottom):
                for n in range(count):
                    red, green, blue = (
                        part[y - ya, 3 * n],
                        part[y - ya, 3 * n + 1],
                        part[y - ya, 3 * n + 2],
                    )
                    if max(red, max(green, blue)) > bright:
                        r = radius[y, xa + n]
                        to_cell(buffers, k - 1, y, xa + n, red, green, blue, np.float32(1), r)
                        line[3 * n] -= red
                        line[3 * n + 1] -= green
                        line[3 * n + 2] -= blue
                        sums[n] -= r
                        weight[n] -= np.float32(1)
        _columns_to_cells(k, cy, xa, line, weight, sums, buffers)


@line_kernel(fastmath=_FLAGS)
def _split_cells(
    k, ya, xa, radius, part, work, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """As `_sum_cells`, of tiles that levels k and k + 1 share by their radii."""
    side, count, end = 1 << k, part.shape[1] // 3, ya + part.shape[0]
    bright, one = highlight(k + 1), np.float32(1)
    fade, offset_y = buffers.fade, buffers.offset_y
    start, scale = fade[k, 0], np.float32(1) / (fade[k, 1] - fade[k, 0])
    low, high, fractions = (
        work[: 3 * count],
        work[3 * count : 6 * count],
        work[10 * count : 13 * count],
    )
    weight_low, sum_low = work[6 * count : 7 * count], work[7 * count : 8 * count]
    weight_high, sum_high, fraction = (
        work[8 * count : 9 * count],
        work[9 * count : 10 * count],
        work[13 * count : 14 * count],
    )
    for cy in range((ya + offset_y) >> k, ((end - 1 + offset_y) >> k) + 1):
        top, bottom = max(cy * side - offset_y, ya), min((cy + 1) * side - offset_y, end)
        for n in range(10 * count):
            work[n] = 0
        above = 0
        for y in range(top, bottom):
            p, r = part[y - ya], radius[y, xa : xa + count]
            for n in range(count):
                t = min(max((r[n] - start) * scale, np.float32(0)), one)
                fraction[n] = t
                weight_low[n] += one - t
                weight_high[n] += t
                sum_low[n] += (one - t) * r[n]
                sum_high[n] += t * r[n]
            for n in range(count):
                fractions[3 * n], fractions[3 * n + 1], fractions[3 * n + 2] = (
                    fraction[n],
                    fraction[n],
                    fraction[n],
                )
            for n in range(3 * count):
                onward = p[n] * fractions[n]
                high[n] += onward
                low[n] += p[n] - onward
        for n in range(3 * count):
            above += low[n] + high[n] > bright
        if above > 0:  # take the highlights out again, and to the levels below
            below = max(k - 1, 1)
            for y in range(top, bottom):
                for n in range(count):
                    red, green, blue = (
                        part[y - ya, 3 * n],
                        part[y - ya, 3 * n + 1],
                        part[y - ya, 3 * n + 2],
                    )
                    if max(red, max(green, blue)) <= bright:
                        continue
                    r = radius[y, xa + n]
                    t = min(max((r - start) * scale, np.float32(0)), one)
                    weight_low[n] -= one - t
                    weight_high[n] -= t
                    sum_low[n] -= (one - t) * r
                    sum_high[n] -= t * r
                    for c in range(3):
                        onward = part[y - ya, 3 * n + c] * t
                        high[3 * n + c] -= onward
                        low[3 * n + c] -= part[y - ya, 3 * n + c] - onward
                    if k == 1:
                        t = np.float32(0)
                    s = one - t
                    to_cell(buffers, below, y, xa + n, red * s, green * s, blue * s, s, r)
                    to_cell(buffers, below + 1, y, xa + n, red * t, green * t, blue * t, t, r)
        _columns_to_cells(k, cy, xa, low, weight_low, sum_low, buffers)
        _columns_to_cells(k + 1, cy >> 1, xa, high, weight_high, sum_high, buffers)


@line_kernel(fastmath=_FLAGS)
def _columns_to_cells(
    k, cy, xa, line, weight, sums, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """Add columns, light line (3 n,), weight and weight x radius (n,), the first at xa, to row cy of level k."""
    side, end, offset_x = 1 << k, xa + len(weight), buffers.offset_x
    meta, cells = buffers.meta, buffers.cells
    row = meta[k, 0] + cy * meta[k, 1]
    for cx in range((xa + offset_x) >> k, ((end - 1 + offset_x) >> k) + 1):
        a, b, c, d, e = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for n in range(
            max(cx * side - offset_x, xa) - xa, min((cx + 1) * side - offset_x, end) - xa
        ):
            m = np.uintp(3 * n)
            a += line[m]
            b += line[m + np.uintp(1)]
            c += line[m + np.uintp(2)]
            d += weight[np.uintp(n)]
            e += sums[np.uintp(n)]
        at = np.uintp(row + cx)
        cells[at, 0] += a
        cells[at, 1] += b
        cells[at, 2] += c
        cells[at, 3] += d
        cells[at, 4] += e


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def splat_occluder(
    top, bottom, occluder: OccluderPixels, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """Rows top..bottom. Returns whether there is any light."""
    radius, colour, coverage, opacity = occluder
    fade, offset_y, offset_x, levels = (
        buffers.fade,
        buffers.offset_y,
        buffers.offset_x,
        buffers.meta.shape[0],
    )
    width, found = radius.shape[1], False
    bits, covered, ends = radius.view(np.int32), coverage.view(np.int32), np.empty(2, np.int32)
    extreme = ends.view(np.float32)
    source, work = np.empty((TILE_PX, TILE_PX, 4), np.float32), np.empty(15 * width, np.float32)
    flat = colour.reshape(colour.shape[0], 3 * width)
    left = -(offset_x & (TILE_PX - 1))
    tiles = (width - left + TILE_PX - 1) // TILE_PX
    lowest, highest = (
        np.empty(tiles, np.int64),
        np.empty(tiles, np.int64),
    )  # levels of a tile all covered; -1 = nothing in it
    for y0 in range(top - ((top + offset_y) & (TILE_PX - 1)), bottom, TILE_PX):
        ya, yb = max(y0, top), min(y0 + TILE_PX, bottom)
        for i in range(tiles):
            xa, xb = max(left + i * TILE_PX, 0), min(left + (i + 1) * TILE_PX, width)
            ends[0], ends[1] = _extremes(covered, ya, xa, yb, xb)
            lowest[i], highest[i] = -1, -1
            if extreme[1] * opacity <= 0:
                continue
            found = True
            lowest[i], highest[i] = 0, levels + 1  # one by one
            if extreme[0] * opacity >= 1:
                ends[0], ends[1] = _extremes(bits, ya, xa, yb, xb)
                lowest[i], highest[i] = levels_of(extreme[0], extreme[1], fade, levels)
        after = 0
        for i in range(tiles):
            if i < after or highest[i] < 0:
                continue
            xa, xb = max(left + i * TILE_PX, 0), min(left + (i + 1) * TILE_PX, width)
            if _alike(lowest[i], highest[i]):  # as of the real scene
                after = i + 1
                while after < tiles and (lowest[after], highest[after]) == (lowest[i], highest[i]):
                    after += 1
                xb = min(left + after * TILE_PX, width)
                _to_cells(
                    lowest[i],
                    highest[i],
                    ya,
                    xa,
                    radius,
                    flat[ya:yb, 3 * xa : 3 * xb],
                    work,
                    buffers,
                )
                continue
            for y in range(ya, yb):
                for x in range(xa, xb):
                    to = source[np.uintp(y - ya), np.uintp(x - xa)]
                    for c in range(3):
                        to[c] = colour[np.uintp(y), np.uintp(x), c] * opacity
                    to[3] = coverage[np.uintp(y), np.uintp(x)] * opacity
            splat_tile(source, radius, ya, xa, yb, xb, buffers)
    return found


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def splat_occluded(
    top, bottom, occluder: OccluderPixels, buffers: SplatBuffers
):  # pragma: no cover - compiled
    """Rows top..bottom of what a layer lets through: weight only, in the last channel. Returns whether there is any."""
    radius, _, coverage, opacity = occluder
    offset_y, offset_x = buffers.offset_y, buffers.offset_x
    width, found = radius.shape[1], False
    source = np.zeros((TILE_PX, TILE_PX, 4), np.float32)
    for y0 in range(top - ((top + offset_y) & (TILE_PX - 1)), bottom, TILE_PX):
        for x0 in range(-(offset_x & (TILE_PX - 1)), width, TILE_PX):
            ya, yb, xa, xb = (
                max(y0, top),
                min(y0 + TILE_PX, bottom),
                max(x0, 0),
                min(x0 + TILE_PX, width),
            )
            if extremes(coverage, ya, xa, yb, xb)[0] * opacity >= 1:
                continue
            found = True
            for y in range(ya, yb):
                for x in range(xa, xb):
                    source[y - ya, x - xa, 3] = np.float32(1) - coverage[y, x] * opacity
            splat_tile(source, radius, ya, xa, yb, xb, buffers)
    return found
