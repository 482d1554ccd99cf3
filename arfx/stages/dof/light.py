"""Compiled: light of the layers onto the ladder, and what comes down from it over one another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the shadow, as the composite
has it, so what a blurred edge lets through is known.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.stages.dof.ladder import SHARP_PX
from arfx.stages.dof.spread import TILE_PX, deposit_tile, extremes, highlight, only_rung, to_cell

_FLAGS = {"contract", "nsz", "arcp"}
# State of a pixel of the result: the composite's bits; something sharp laid there; light spread there.
KEPT, TRIED, LAID = np.uint8(0), np.uint8(1), np.uint8(2)
CLIPPED = np.float32(0.9)  # linear light from which a highlight boost sets in; full at 1


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _behind(plate, shadow, opacity, bias):  # pragma: no cover - compiled
    """The real scene with the shadow and without the object, one channel: as `composite`, coverage 0."""
    return plate + opacity * (plate * (shadow - np.float32(1)) + bias * (np.float32(1) - shadow))


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def cut_from_real(plate, shadow, opacity, bias, inside):  # pragma: no cover - compiled
    """(h, w, 3) premultiplied colour of the part `inside` (h, w) of the real scene."""
    out = np.empty_like(plate)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            for c in range(3):
                out[y, x, c] = inside[y, x] * _behind(plate[y, x, c], shadow[y, x, c], opacity, bias[c])
    return out


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _boosted(red, green, blue, boost):  # pragma: no cover - compiled
    most = max(red, max(green, blue))
    return np.float32(1) + boost * min(max((most - CLIPPED) / (np.float32(1) - CLIPPED), np.float32(0)), np.float32(1))


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def deposit_real(
    top, bottom, radius, flat_plate, flat_shadow, opacity, bias, kept, boost, fade, cells, meta, lead_y, lead_x, near, held
):  # fmt: skip  # pragma: no cover - compiled
    """Rows top..bottom of the real scene; returns whether any of it is blurred. flat_plate, flat_shadow : (h, 3 w)

    kept : (h, w) share that is not cut out, (0, 0) = all
    """
    whole = kept.shape[0] == 0
    plain = whole and boost <= 0
    width = radius.shape[1]
    source = np.empty((TILE_PX, TILE_PX, 4), np.float32)
    line, biases, sums = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32), np.empty(width, np.float32)
    for n in range(3 * width):
        biases[n] = bias[n % 3]
    gone = np.empty(width, np.float32)
    left = -(lead_x & (TILE_PX - 1))
    blurred = False
    rungs = np.empty((width - left + TILE_PX - 1) // TILE_PX, np.int64)  # of each tile; -1 = several, -2 = none
    for y0 in range(top - ((top + lead_y) & (TILE_PX - 1)), bottom, TILE_PX):
        ya, yb = max(y0, top), min(y0 + TILE_PX, bottom)
        for i in range(len(rungs)):
            x0 = left + i * TILE_PX
            least, most = extremes(radius, ya, max(x0, 0), yb, min(x0 + TILE_PX, width))
            rungs[i] = only_rung(least, most, fade, meta.shape[0]) if most > SHARP_PX else -2
            blurred |= most > SHARP_PX
        after = 0
        for tile in range(len(rungs)):
            if tile < after or rungs[tile] == -2:
                continue
            x0 = left + tile * TILE_PX
            xa, xb = max(x0, 0), min(x0 + TILE_PX, width)
            first = 3 * xa
            if plain and rungs[tile] > 0:  # as many tiles as there are alike: memory is read along the rows
                after = tile + 1
                while after < len(rungs) and rungs[after] == rungs[tile]:
                    after += 1
                xb = min(left + after * TILE_PX, width)
                _sum_cells(
                    rungs[tile], ya, yb, xa, xb, radius, flat_plate, flat_shadow, opacity, biases, line, sums, gone, cells, meta,
                    lead_y, lead_x,
                )  # fmt: skip
                continue
            for y in range(ya, yb):
                p, s = flat_plate[y, first : first + 3 * (xb - xa)], flat_shadow[y, first : first + 3 * (xb - xa)]
                for n in range(3 * (xb - xa)):  # over all channels alike: the compiler makes vectors of it
                    line[n] = _behind(p[n], s[n], opacity, biases[n])
                for i in range(xb - xa):
                    red, green, blue, weight, k = line[3 * i], line[3 * i + 1], line[3 * i + 2], np.float32(1), np.float32(1)
                    if not plain:
                        if not whole:
                            weight = kept[y, xa + i]
                            k = weight
                        if boost > 0:
                            k *= _boosted(red, green, blue, boost)
                    j = y - ya
                    source[j, i, 0], source[j, i, 1], source[j, i, 2], source[j, i, 3] = red * k, green * k, blue * k, weight
            deposit_tile(source, radius, ya, xa, yb, xb, fade, cells, meta, lead_y, lead_x, near, held)
    return blurred


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _pixel(flat_plate, flat_shadow, y, x, opacity, biases):  # pragma: no cover - compiled
    """Colour of the real scene in one pixel."""
    p, s = flat_plate[y, 3 * x : 3 * x + 3], flat_shadow[y, 3 * x : 3 * x + 3]
    return (
        _behind(p[0], s[0], opacity, biases[0]),
        _behind(p[1], s[1], opacity, biases[1]),
        _behind(p[2], s[2], opacity, biases[2]),
    )


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _sum_cells(
    k, ya, yb, xa, xb, radius, flat_plate, flat_shadow, opacity, biases, line, sums, gone, cells, meta, lead_y, lead_x
):  # fmt: skip  # pragma: no cover - compiled
    """Tiles of the real scene that all go to rung k: summed by columns first, which the compiler makes vectors of."""
    side, count = 1 << k, xb - xa
    bright = highlight(k) if k > 1 else np.float32(np.inf)
    for cy in range((ya + lead_y) >> k, ((yb - 1 + lead_y) >> k) + 1):
        top, bottom = max(cy * side - lead_y, ya), min((cy + 1) * side - lead_y, yb)
        for n in range(3 * count):
            line[n] = 0
        for n in range(count):
            sums[n], gone[n] = 0, 0
        for y in range(top, bottom):
            p, s = flat_plate[y, 3 * xa : 3 * xb], flat_shadow[y, 3 * xa : 3 * xb]
            for n in range(3 * count):
                line[n] += _behind(p[n], s[n], opacity, biases[n])
            r = radius[y, xa:xb]
            for n in range(count):
                sums[n] += r[n]
        most = np.float32(0)
        for n in range(3 * count):
            most = max(most, line[n])
        if most > bright:  # take the highlights out again, and to the rung below
            for y in range(top, bottom):
                for n in range(count):
                    red, green, blue = _pixel(flat_plate, flat_shadow, y, xa + n, opacity, biases)
                    if max(red, max(green, blue)) > bright:
                        r = radius[y, xa + n]
                        to_cell(cells, meta, k - 1, y, xa + n, lead_y, lead_x, red, green, blue, np.float32(1), r)
                        line[3 * n] -= red
                        line[3 * n + 1] -= green
                        line[3 * n + 2] -= blue
                        sums[n] -= r
                        gone[n] += np.float32(1)
        for cx in range((xa + lead_x) >> k, ((xb - 1 + lead_x) >> k) + 1):
            a, b, c, e = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            d = np.float32(0)
            left, right = max(cx * side - lead_x, xa) - xa, min((cx + 1) * side - lead_x, xb) - xa
            for n in range(left, right):
                a += line[3 * n]
                b += line[3 * n + 1]
                c += line[3 * n + 2]
                d += np.float32(bottom - top) - gone[n]
                e += sums[n]
            at = np.uintp(meta[k, 0] + cy * meta[k, 1] + cx)
            cells[at, 0] += a
            cells[at, 1] += b
            cells[at, 2] += c
            cells[at, 3] += d
            cells[at, 4] += e


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def deposit_cut(
    top, bottom, radius, colour, coverage, opacity, fade, cells, meta, lead_y, lead_x, near, held
):  # fmt: skip  # pragma: no cover - compiled
    """Rows top..bottom of a layer of premultiplied colour (h, w, 3), coverage (h, w). Returns whether there is any light."""
    width, found = radius.shape[1], False
    source = np.empty((TILE_PX, TILE_PX, 4), np.float32)
    for y0 in range(top - ((top + lead_y) & (TILE_PX - 1)), bottom, TILE_PX):
        for x0 in range(-(lead_x & (TILE_PX - 1)), width, TILE_PX):
            ya, yb, xa, xb = max(y0, top), min(y0 + TILE_PX, bottom), max(x0, 0), min(x0 + TILE_PX, width)
            if extremes(coverage, ya, xa, yb, xb)[1] * opacity <= 0:
                continue
            for y in range(ya, yb):
                for x in range(xa, xb):
                    for c in range(3):
                        source[y - ya, x - xa, c] = colour[y, x, c] * opacity
                    source[y - ya, x - xa, 3] = coverage[y, x] * opacity
            deposit_tile(source, radius, ya, xa, yb, xb, fade, cells, meta, lead_y, lead_x, near, held)
            found = True
    return found


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def deposit_gap(
    top, bottom, radius, coverage, opacity, fade, cells, meta, lead_y, lead_x, near, held
):  # fmt: skip  # pragma: no cover - compiled
    """Rows top..bottom of what a layer lets through: weight only, in the last channel. Returns whether there is any."""
    width, found = radius.shape[1], False
    source = np.zeros((TILE_PX, TILE_PX, 4), np.float32)
    for y0 in range(top - ((top + lead_y) & (TILE_PX - 1)), bottom, TILE_PX):
        for x0 in range(-(lead_x & (TILE_PX - 1)), width, TILE_PX):
            ya, yb, xa, xb = max(y0, top), min(y0 + TILE_PX, bottom), max(x0, 0), min(x0 + TILE_PX, width)
            if extremes(coverage, ya, xa, yb, xb)[0] * opacity >= 1:
                continue
            for y in range(ya, yb):
                for x in range(xa, xb):
                    source[y - ya, x - xa, 3] = np.float32(1) - coverage[y, x] * opacity
            deposit_tile(source, radius, ya, xa, yb, xb, fade, cells, meta, lead_y, lead_x, near, held)
            found = True
    return found


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def lay_real(
    out, state, image, top, light, lo, hi, radius, plate, shadow, opacity, bias, kept
):  # fmt: skip  # pragma: no cover - compiled
    """out (rows, w, 3) = the real scene blurred where light of it was spread to, there state (rows, w) = LAID; else the
    composite's own bits, image (h, w, 3) from its row `top`.

    light : of `Spread.rows`, columns lo..hi
    """
    whole = kept.shape[0] == 0
    for j in range(out.shape[0]):
        y = top + j
        for x in range(lo):
            out[j, x, 0], out[j, x, 1], out[j, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
        for x in range(hi, out.shape[1]):
            out[j, x, 0], out[j, x, 1], out[j, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
        for x in range(lo, hi):
            w = light[j, x, 3]
            if not w > 0:
                out[j, x, 0], out[j, x, 1], out[j, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
                continue
            state[j, x] = LAID
            if radius[y, x] > SHARP_PX:
                inverse = np.float32(1) / w
                for c in range(3):
                    out[j, x, c] = light[j, x, c] * inverse
            else:
                share = np.float32(1) if whole else kept[y, x]
                inverse = np.float32(1) / (w + share)
                for c in range(3):
                    own = share * _behind(plate[y, x, c], shadow[y, x, c], opacity, bias[c])
                    out[j, x, c] = (light[j, x, c] + own) * inverse


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def lay_cut(
    out, state, top, begin, end, left, light, lo, hi, gap, gap_lo, gap_hi, radius, colour, coverage, layer_opacity,
    plate, shadow, opacity, bias,
):  # fmt: skip  # pragma: no cover - compiled
    """Put columns begin..end of a cut-out layer over out (rows, w, 3); its column 0 is `left` of out's.

    light, gap : (rows, w', 4) of `Spread.rows`;  state : set LAID where any of it is spread, else TRIED
    plate, shadow : of the real scene, from row `top`, for pixels that hold the composite's bits as yet
    """
    for y in range(out.shape[0]):
        for x in range(begin, end):
            w = light[y, x, 3] if lo <= x < hi else np.float32(0)
            c = coverage[y, x] * layer_opacity
            sharp = radius[y, x] <= SHARP_PX
            if not (w > 0 or (sharp and c > 0)):
                continue
            total = w + (gap[y, x, 3] if gap_lo <= x < gap_hi else np.float32(0))
            own = np.float32(1) if sharp else np.float32(0)
            total += own
            if state[y, left + x] == KEPT:
                for k in range(3):
                    out[y, left + x, k] = _behind(plate[top + y, left + x, k], shadow[top + y, left + x, k], opacity, bias[k])
                state[y, left + x] = TRIED
            if w > 0:
                state[y, left + x] = LAID
            w += own * c
            inverse = np.float32(1) / total
            through = max(np.float32(1) - w * inverse, np.float32(0))
            for k in range(3):
                v = own * colour[y, x, k] * layer_opacity
                if lo <= x < hi:
                    v += light[y, x, k]
                out[y, left + x, k] = out[y, left + x, k] * through + v * inverse


@numba.njit(cache=True, nogil=True)
def restore(out, state, image, top, begin, end):  # pragma: no cover - compiled
    """The composite's own bits where nothing was spread to after all. out (rows, w, 3), image (h, w, 3) from row `top`"""
    for j in range(out.shape[0]):
        for x in range(begin, end):
            if state[j, x] == TRIED:
                for c in range(3):
                    out[j, x, c] = image[top + j, x, c]
