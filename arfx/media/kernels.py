"""Compiled loops between stored planes and linear light, over a rectangle only.

Cost on one core: see docs; about one table lookup per sample. Left out: nothing is clipped when reading, so values
beyond black and white (limited range, out-of-gamut chroma) come out below 0 and above 1.
"""

# mypy: no-check-untyped-defs
from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

from arfx.core.colour import Transfer

# Decoding: coded values of every legal Y'CbCr triple lie in this interval (limited range: -1.12 .. 2.16).
DECODE_LOW, DECODE_HIGH, DECODE_STEPS = -1.25, 2.25, 14336
# Encoding: 128 nodes in each octave from 2^-30 to 2^6; interpolation error of x^(1/2.4) is below 2e-6 of the value.
_LOW_EXPONENT, _HIGH_EXPONENT, _NODE_BITS = -30, 6, 7
_FIRST = (127 + _LOW_EXPONENT) << _NODE_BITS
_LAST = ((127 + _HIGH_EXPONENT) << _NODE_BITS) - 1


@lru_cache(maxsize=8)
def decode_table(transfer: Transfer) -> np.ndarray:
    """(DECODE_STEPS + 1,) float32; linear interpolation errs by less than 3e-8 for sRGB."""
    return transfer.decode(np.linspace(DECODE_LOW, DECODE_HIGH, DECODE_STEPS + 1)).astype(np.float32)


@lru_cache(maxsize=8)
def encode_table(transfer: Transfer) -> np.ndarray:
    """float32 values of `transfer.encode` at the nodes; node i is the float32 with bits (i + first) << 16."""
    bits = np.arange(_FIRST, _LAST + 2, dtype=np.int32) << (23 - _NODE_BITS)
    return transfer.encode(bits.view(np.float32).astype(float)).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def linear_from_yuv(y, u, v, rect, steps, cosited, chroma_size, scale, matrix, table, out):
    """out (h, w, 3) float32 linear RGB of coded `rect` (x0, y0, x1, y1).

    y, u, v : whole-line planes;  steps : log2 of the chroma step (x, y);  cosited : chroma on the left/top luma sample
    scale : y offset, y factor, chroma offset, chroma factor;  matrix : R from Cr, G from Cb, G from Cr, B from Cb
    Chroma is interpolated linearly between its true positions, from samples outside the rectangle too.
    """
    x0, y0, x1, y1 = rect
    sx, sy = steps
    cw, ch = chroma_size
    yo, yf, co, cf = scale
    rv, gu, gv, bu = matrix
    w = x1 - x0
    first = np.empty(w, np.int32)
    second = np.empty(w, np.int32)
    part = np.empty(w, np.float32)
    for k in range(w):
        c = np.float32((x0 + k) / (1 << sx)) if cosited[0] else np.float32((x0 + k + 0.5) / (1 << sx) - 0.5)
        c = min(max(c, np.float32(0)), np.float32(cw - 1))
        first[k] = np.int32(c)
        second[k] = min(np.int32(c) + 1, cw - 1)
        part[k] = c - np.float32(first[k])
    c0 = first[0]
    n = second[w - 1] - c0 + 1
    # a line at a time in steps without branches: the compiler makes vector code of all but the lookup
    coded = np.empty((3, w), np.float32)
    at, between = np.empty((3, w), np.int32), np.empty((3, w), np.float32)
    row_u = np.empty(n, np.float32)
    row_v = np.empty(n, np.float32)
    for j in range(y1 - y0):
        yy = y0 + j
        c = np.float32(yy / (1 << sy)) if cosited[1] else np.float32((yy + 0.5) / (1 << sy) - 0.5)
        c = min(max(c, np.float32(0)), np.float32(ch - 1))
        r0 = np.int32(c)
        r1 = min(r0 + 1, ch - 1)
        f = c - np.float32(r0)
        for i in range(n):
            a, b = np.float32(u[r0, c0 + i]), np.float32(u[r1, c0 + i])
            row_u[i] = (a + f * (b - a) - co) * cf
            a, b = np.float32(v[r0, c0 + i]), np.float32(v[r1, c0 + i])
            row_v[i] = (a + f * (b - a) - co) * cf
        for k in range(w):
            i, m, t = np.uintp(first[k] - c0), np.uintp(second[k] - c0), part[k]
            cb = row_u[i] + t * (row_u[m] - row_u[i])
            cr = row_v[i] + t * (row_v[m] - row_v[i])
            luma = (np.float32(y[yy, x0 + k]) - yo) * yf
            coded[0, k] = luma + rv * cr
            coded[1, k] = luma - gu * cb - gv * cr
            coded[2, k] = luma + bu * cb
        for c in range(3):
            for k in range(w):
                t = (coded[c, k] - np.float32(-1.25)) * np.float32(4096.0)
                t = min(max(t, np.float32(0.0)), np.float32(14335.999))
                at[c, k] = np.int32(t)
                between[c, k] = t - np.float32(at[c, k])
        for k in range(w):
            for c in range(3):
                i = np.uintp(at[c, k])
                out[j, k, c] = table[i] + between[c, k] * (table[i + np.uintp(1)] - table[i])


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def linear_at_yuv(y, u, v, pixels, steps, cosited, chroma_size, scale, matrix, table, out):
    """out (n, 3) = linear_from_yuv of single pixels (n, 2), x and y, coded; other arguments as there."""
    sx, sy = steps
    cw, ch = chroma_size
    yo, yf, co, cf = scale
    rv, gu, gv, bu = matrix
    zero = np.float32(0)
    for k in range(len(pixels)):
        x, row = pixels[k, 0], pixels[k, 1]
        p = np.float32(x / (1 << sx)) if cosited[0] else np.float32((x + 0.5) / (1 << sx) - 0.5)
        q = np.float32(row / (1 << sy)) if cosited[1] else np.float32((row + 0.5) / (1 << sy) - 0.5)
        p, q = min(max(p, zero), np.float32(cw - 1)), min(max(q, zero), np.float32(ch - 1))
        i0, r0 = np.int32(p), np.int32(q)
        i1, r1 = min(i0 + 1, cw - 1), min(r0 + 1, ch - 1)
        t, f = p - np.float32(i0), q - np.float32(r0)
        a, b = np.float32(u[r0, i0]), np.float32(u[r1, i0])
        c, d = np.float32(u[r0, i1]), np.float32(u[r1, i1])
        left, right = (a + f * (b - a) - co) * cf, (c + f * (d - c) - co) * cf
        cb = left + t * (right - left)
        a, b = np.float32(v[r0, i0]), np.float32(v[r1, i0])
        c, d = np.float32(v[r0, i1]), np.float32(v[r1, i1])
        left, right = (a + f * (b - a) - co) * cf, (c + f * (d - c) - co) * cf
        cr = left + t * (right - left)
        luma = (np.float32(y[row, x]) - yo) * yf
        for n in range(3):
            coded = luma + rv * cr if n == 0 else (luma - gu * cb - gv * cr if n == 1 else luma + bu * cb)
            e = min(max((coded - np.float32(-1.25)) * np.float32(4096.0), zero), np.float32(14335.999))
            i = np.int32(e)
            out[k, n] = table[i] + (e - np.float32(i)) * (table[i + 1] - table[i])


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def encode_bits(bits, table, out):
    """out[k] = the transfer function of the float32 with bits[k] (n,) int32, by linear interpolation; odd in the value."""
    zero, last = np.int32(0), np.int32(4607)
    for k in range(bits.shape[0]):
        b = bits[k] & np.int32(0x7FFFFFFF)
        node = (b >> np.int32(16)) - np.int32(12416)
        t = np.float32(b & np.int32(0xFFFF)) * np.float32(1 / 65536) if node <= last else np.float32(1)
        i = np.uintp(min(max(node, zero), last))
        v = table[i] + t * (table[i + np.uintp(1)] - table[i])
        if node < zero:  # below 2^-30: straight to zero in the bits
            v = table[0] * (np.float32(b) * np.float32(1 / (12416 << 16)))
        out[k] = -v if bits[k] < zero else v


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _all_finite(before, after):
    """Whether all float32 with these bits are finite: none has all bits of its exponent set."""
    infinite, highest = np.int32(0x7F800000), np.int32(0)
    for k in range(before.shape[0]):
        highest = max(highest, max(before[k] & infinite, after[k] & infinite))
    return highest < infinite


@numba.njit(cache=True, nogil=True)
def _blank_odd(before, after):
    """Sets pixels with a value that is not finite to 0 in both lines, in place; returns how many."""
    infinite = np.int32(0x7F800000)
    bad = 0
    for k in range(0, before.shape[0], 3):
        odd = False
        for c in range(k, k + 3):
            odd |= ((before[c] & infinite) == infinite) | ((after[c] & infinite) == infinite)
        if odd:
            bad += 1
            before[k : k + 3] = 0
            after[k : k + 3] = 0
    return bad


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _clipped_differences(before, after):
    """after = after - before (n,), coded, with `after` kept between black and white or where `before` already lay beyond."""
    zero, one = np.float32(0), np.float32(1)
    for k in range(before.shape[0]):
        b = before[k]
        after[k] = min(max(after[k], min(b, zero)), max(b, one)) - b


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _to_yuv(diff, to_yuv, dy, d_cb, d_cr):
    """R'G'B' differences (3 n,) to luma and chroma (n,)."""
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(dy.shape[0]):
        i = np.uintp(k) * three
        r, g, b = diff[i], diff[i + one], diff[i + two]
        dy[k] = to_yuv[0, 0] * r + to_yuv[0, 1] * g + to_yuv[0, 2] * b
        d_cb[k] = to_yuv[1, 0] * r + to_yuv[1, 1] * g + to_yuv[1, 2] * b
        d_cr[k] = to_yuv[2, 0] * r + to_yuv[2, 1] * g + to_yuv[2, 2] * b


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _add_steps(line, diff, factor, low, high):
    """Adds diff (n,) x factor, rounded, to stored samples; legal ones stay legal, others go no further out."""
    for k in range(diff.shape[0]):
        old = np.int32(line[k])
        line[k] = min(max(old + np.int32(np.rint(diff[k] * factor)), min(old, low)), max(old, high))


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def edit_luma(y, x0, y0, before_bits, after_bits, table, to_yuv, factor, low, high, d_cb, d_cr, spans):
    """Adds the luma difference to plane y in place and leaves the chroma differences (per pixel, -0.5..0.5) in d_cb, d_cr.

    *_bits : (h, w, 3) float32 linear light as int32;  to_yuv : (3, 3) from R'G'B'
    factor : stored steps per unit of luma;  low, high : legal stored values
    spans : (h, 2) int32, set to the first column that changes and the one behind the last; d_cb, d_cr hold values there
    Returns how many pixels of `after` or `before` are not finite; those are left alone.
    """
    h, w = d_cb.shape
    bad = 0
    before, after = np.empty(3 * w, np.float32), np.empty(3 * w, np.float32)
    dy = np.empty(w, np.float32)
    # a line at a time from the first pixel that changes to the last, in steps of which the compiler makes vector code
    # (it does not where they stand together in one function); a pixel between them that does not change has difference 0
    for j in range(h):
        b, a = before_bits[j].reshape(-1), after_bits[j].reshape(-1)
        if not _all_finite(b, a):
            b, a = b.copy(), a.copy()
            bad += _blank_odd(b, a)
        first, last = 0, 3 * w
        while first < last and b[first] == a[first]:
            first += 1
        while last > first and b[last - 1] == a[last - 1]:
            last -= 1
        first, last = first // 3, (last + 2) // 3
        n = max(last - first, 0)
        spans[j, 0], spans[j, 1] = (first, last) if n else (0, 0)
        if n:
            encode_bits(b[3 * first : 3 * last], table, before)
            encode_bits(a[3 * first : 3 * last], table, after)
            _clipped_differences(before[: 3 * n], after)
            _to_yuv(after, to_yuv, dy[:n], d_cb[j, first:last], d_cr[j, first:last])
            _add_steps(y[y0 + j, x0 + first : x0 + last], dy[:n], factor, low, high)
    return bad


@numba.njit(cache=True, nogil=True)
def _taps(step, tent):
    """Offsets from a chroma sample's first luma sample (from, to) and the weights of the luma samples there."""
    n = 1 << step
    low = 1 - n if tent else 0
    weights = np.empty(n - low, np.float32)
    for k in range(low, n):
        weights[k - low] = (n - abs(k)) / (n * n) if tent else 1.0 / n
    return low, n, weights


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def edit_chroma(plane, diff, spans, rect, picture, steps, cosited, factor, low, high):
    """Adds per-pixel chroma differences (of coded `rect`, zero outside `spans`) to one chroma plane in place.

    A sample on the left/top luma sample takes a tent of the differences, one in the middle a box; beyond the rectangle
    the difference is zero, beyond the picture its edge goes on. Only samples on the grid inside the rectangle,
    grown to that grid, can change.
    """
    x0, y0, x1, y1 = rect
    width, height = picture
    sx, sy = steps
    ca, cb = x0 >> sx, -(-x1 >> sx)
    ra, rb = y0 >> sy, -(-y1 >> sy)
    n = cb - ca
    from_x, to_x, weights_x = _taps(sx, cosited[0] and sx > 0)
    from_y, to_y, weights_y = _taps(sy, cosited[1] and sy > 0)
    rows = np.zeros((y1 - y0, n), np.float32)
    start = (ca << sx) + from_x  # luma column of the first tap
    line = np.empty((n << sx) + to_x - from_x, np.float32)
    total = np.empty(n, np.float32)
    reach = np.zeros((y1 - y0, 2), np.int64)  # of each row, the chroma columns that its differences reach
    for j in range(y1 - y0):
        if spans[j, 1] <= spans[j, 0]:
            continue
        first, last = x0 + spans[j, 0], x0 + spans[j, 1]  # luma columns with a difference
        a = max(((first - to_x + 1) >> sx) - ca, 0)
        b = min(((last - from_x) >> sx) + 1 - ca, n)
        reach[j, 0], reach[j, 1] = a, b
        # the line with zeros around it, and the picture's edge going on, so that the sum needs no test
        line[:] = 0
        line[first - start : last - start] = diff[j, spans[j, 0] : spans[j, 1]]
        if first == 0:
            line[:-start] = line[-start]
        if last == width:
            line[last - start :] = line[last - start - 1]
        for k in range(from_x, to_x):
            weight, at = weights_x[k - from_x], k - from_x
            for i in range(a, b):
                rows[j, i] += line[np.uintp((i << sx) + at)] * weight
    for r in range(ra, rb):
        a, b = n, 0
        for k in range(from_y, to_y):
            yy = min(max((r << sy) + k, 0), height - 1)
            if y0 <= yy < y1 and reach[yy - y0, 1] > reach[yy - y0, 0]:
                a, b = min(a, reach[yy - y0, 0]), max(b, reach[yy - y0, 1])
        total[:] = 0
        for k in range(from_y, to_y):
            yy = min(max((r << sy) + k, 0), height - 1)
            if y0 <= yy < y1:
                for i in range(a, b):
                    total[i] += rows[yy - y0, i] * weights_y[k - from_y]
        for i in range(a, b):
            step = np.int32(np.rint(total[i] * factor))
            if step != 0:
                old = np.int32(plane[r, ca + i])
                plane[r, ca + i] = min(max(old + step, min(old, low)), max(old, high))
