"""Compiled: each pixel's light spread over its disc. Row ends are marked and summed along the rows, O(radius) a pixel.

What is marked is rounded to multiples of 2^-20: sums below 16 are then exact in float32, so a row's running sum comes
back to exactly 0 behind the last disc, and neither the order nor the rectangle it is computed in changes a bit.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.stages.dof.aperture import STEPS
from arfx.stages.dof.ladder import SHARP_PX

_FLAGS = {"contract", "nsz", "arcp"}  # no re-association: the rounding below must stay
_SNAP = np.float32(1.5 * 2**3)  # adding and taking it away rounds to 2^-20


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _snap(v):  # pragma: no cover - compiled
    return (v + _SNAP) - _SNAP


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def deposit(r, red, green, blue, weight, y, x, fade, cells, meta, lead_y, lead_x, near):  # pragma: no cover - compiled
    """Hand one pixel's light (premultiplied) and weight to the one or two rungs that its radius asks for.

    near : (h, w, 4) light of rung 0, set where SHARP_PX < r < fade[0, 1]
    cells : (n, 5) red, green, blue, weight, weight x radius of all further rungs;  meta : (rungs, 3) first cell, width,
    height;  lead_y, lead_x : px by which the rectangle's corner lies in a cell of the last rung
    """
    rungs = meta.shape[0]
    k = 0
    while k < rungs - 1 and r >= fade[k, 1]:
        k += 1
    onward = np.float32(0)
    if k < rungs - 1 and r > fade[k, 0]:
        onward = (r - fade[k, 0]) / (fade[k, 1] - fade[k, 0])
    for step in range(2):
        share = np.float32(1) - onward if step == 0 else onward
        at = k + step
        if share <= 0 or at >= rungs:
            continue
        if at == 0:
            near[y, x, 0], near[y, x, 1], near[y, x, 2] = red * share, green * share, blue * share
            near[y, x, 3] = weight * share
        else:
            c = meta[at, 0] + ((y + lead_y) >> at) * meta[at, 1] + ((x + lead_x) >> at)
            cells[c, 0] += red * share
            cells[c, 1] += green * share
            cells[c, 2] += blue * share
            cells[c, 3] += weight * share
            cells[c, 4] += weight * share * r


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _mark(
    marks, q, y, x, low, high, width, red, green, blue, weight, first, last, share_first, share_last, row_weight, reach
):  # fmt: skip  # pragma: no cover - compiled
    """Mark the row ends of one disc in rows low..high (marks begin at row low)."""
    n = reach[q]
    for j in range(max(-n, low - y), min(n, high - 1 - y) + 1):
        i = j + n
        g = row_weight[q, i]
        if g <= 0:
            continue
        f, e = share_first[q, i], share_last[q, i]
        a = min(max(x + first[q, i], 0), width)
        b = min(max(x + first[q, i] + 1, 0), width)
        c = min(max(x + last[q, i], 0), width)
        d = min(max(x + last[q, i] + 1, 0), width)
        row = marks[y + j - low]
        r0, g0, b0, w0 = _snap(red * g), _snap(green * g), _snap(blue * g), _snap(weight * g)
        r1, g1, b1, w1 = _snap(r0 * f), _snap(g0 * f), _snap(b0 * f), _snap(w0 * f)
        m = row[a]
        m[0] += r1
        m[1] += g1
        m[2] += b1
        m[3] += w1
        if last[q, i] > first[q, i]:
            r2, g2, b2, w2 = _snap(r0 * e), _snap(g0 * e), _snap(b0 * e), _snap(w0 * e)
            m = row[b]
            m[0] += r0 - r1
            m[1] += g0 - g1
            m[2] += b0 - b1
            m[3] += w0 - w1
            m = row[c]
            m[0] -= r0 - r2
            m[1] -= g0 - g2
            m[2] -= b0 - b2
            m[3] -= w0 - w2
            m = row[d]
            m[0] -= r2
            m[1] -= g2
            m[2] -= b2
            m[3] -= w2
        else:
            m = row[b]
            m[0] -= r1
            m[1] -= g1
            m[2] -= b1
            m[3] -= w1


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_pixels(
    near, radius, until, low, high, far, marks, first, last, share_first, share_last, row_weight, reach
):  # fmt: skip  # pragma: no cover - compiled
    """Rung 0: light of pixels with SHARP_PX < radius < until onto rows low..high. Returns the columns marked (lo, hi)."""
    h, w = radius.shape
    top = np.float32(row_weight.shape[0] - 1)
    lo, hi = w, 0
    for y in range(max(low - far, 0), min(high + far, h)):
        for x in range(w):
            r = radius[y, x]
            if r <= SHARP_PX or r >= until or near[y, x, 3] <= 0:
                continue
            q = int(min(r * STEPS + np.float32(0.5), top))
            n = reach[q]
            if y + n < low or y - n >= high:
                continue
            lo, hi = min(lo, x - n), max(hi, x + n + 1)
            _mark(
                marks, q, y, x, low, high, w, near[y, x, 0], near[y, x, 1], near[y, x, 2], near[y, x, 3],
                first, last, share_first, share_last, row_weight, reach,
            )  # fmt: skip
    return max(lo, 0), min(hi, w)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def spread_cells(
    cells, width, height, rung, cut_px2, low, high, far, marks, first, last, share_first, share_last, row_weight, reach
):  # fmt: skip  # pragma: no cover - compiled
    """Further rungs: cells (height * width, 5) onto rows low..high of the rung. Returns the columns marked (lo, hi)."""
    top = np.float32(row_weight.shape[0] - 1)
    side = np.float32(1 << rung)
    area = np.float32(1) / (side * side)
    lo, hi = width, 0
    for y in range(max(low - far, 0), min(high + far, height)):
        for x in range(width):
            k = y * width + x
            if cells[k, 3] <= 0:
                continue
            r = cells[k, 4] / cells[k, 3]
            r = np.sqrt(max(r * r - cut_px2, np.float32(0))) / side
            q = int(min(r * STEPS + np.float32(0.5), top))
            n = reach[q]
            if y + n < low or y - n >= high:
                continue
            lo, hi = min(lo, x - n), max(hi, x + n + 1)
            _mark(
                marks, q, y, x, low, high, width, cells[k, 0] * area, cells[k, 1] * area, cells[k, 2] * area,
                cells[k, 3] * area, first, last, share_first, share_last, row_weight, reach,
            )  # fmt: skip
    return max(lo, 0), min(hi, width)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def run_sums(marks, lo, hi):  # pragma: no cover - compiled
    """Marks to light: running sums along the rows, columns lo..hi, in place."""
    for y in range(marks.shape[0]):
        a, b, c, d = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for x in range(lo, hi):
            m = marks[y, x]
            a += m[0]
            b += m[1]
            c += m[2]
            d += m[3]
            m[0], m[1], m[2], m[3] = a, b, c, d


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def add_rung(
    out, coarse, rung, first_row, height, width, top, lead_y, lead_x, lo, hi
):  # fmt: skip  # pragma: no cover - compiled
    """out (rows, w, 4) += the rung's light, bilinear, columns lo..hi.

    coarse : (n, width + 1, 4) rows from cell row `first_row`;  top : row of `out`'s first row in the rectangle
    lead_y, lead_x : px by which the rectangle's corner lies in its first cell;  height, width : cells
    """
    step = np.float32(1) / np.float32(1 << rung)
    half = np.float32(0.5)
    line = np.empty((width, 4), np.float32)
    for y in range(out.shape[0]):
        v = (np.float32(top + y + lead_y) + half) * step - half
        i = int(np.floor(v))
        t = v - np.float32(i)
        a, b = min(max(i, 0), height - 1) - first_row, min(max(i + 1, 0), height - 1) - first_row
        c0 = max(((lo + lead_x) >> rung) - 1, 0)
        c1 = min(((hi + lead_x) >> rung) + 2, width)
        for x in range(c0, c1):
            for c in range(4):
                line[x, c] = coarse[a, x, c] + (coarse[b, x, c] - coarse[a, x, c]) * t
        for x in range(lo, hi):
            u = (np.float32(x + lead_x) + half) * step - half
            i = int(np.floor(u))
            t = u - np.float32(i)
            p, q = max(i, 0), min(i + 1, width - 1)
            for c in range(4):
                out[y, x, c] += line[p, c] + (line[q, c] - line[p, c]) * t
