"""Compiled loops between stored planes and linear light, over a rectangle only.

Cost on one core: see docs; about one table lookup per sample. Left out: nothing is clipped when reading, so values
beyond black and white (limited range, out-of-gamut chroma) come out below 0 and above 1.
"""

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
def _decoded(v, table):
    t = (v - np.float32(-1.25)) * np.float32(4096.0)
    t = min(max(t, np.float32(0.0)), np.float32(14335.999))
    i = np.int32(t)
    f = t - np.float32(i)
    return table[i] + f * (table[i + 1] - table[i])


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
            i, m, t = first[k] - c0, second[k] - c0, part[k]
            cb = row_u[i] + t * (row_u[m] - row_u[i])
            cr = row_v[i] + t * (row_v[m] - row_v[i])
            luma = (np.float32(y[yy, x0 + k]) - yo) * yf
            out[j, k, 0] = _decoded(luma + rv * cr, table)
            out[j, k, 1] = _decoded(luma - gu * cb - gv * cr, table)
            out[j, k, 2] = _decoded(luma + bu * cb, table)


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _encoded(bits, value, table):
    b = bits & 0x7FFFFFFF
    node = (b >> 16) - 12416
    if node < 0:  # below 2^-30: straight to zero
        return value * (table[0] * np.float32(1073741824.0))
    if node > 4607:
        node = 4607
        b = 0xFFFF
    f = np.float32(b & 0xFFFF) * np.float32(1 / 65536)
    r = table[node] + f * (table[node + 1] - table[node])
    return -r if value < 0 else r


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def edit_luma(y, x0, y0, before, after, before_bits, after_bits, table, to_yuv, factor, low, high, d_cb, d_cr):
    """Adds the luma difference to plane y in place and leaves the chroma differences (per pixel, -0.5..0.5) in d_cb, d_cr.

    before, after : (h, w, 3) float32 linear;  *_bits : the same memory as int32;  to_yuv : (3, 3) from R'G'B'
    factor : stored steps per unit of luma;  low, high : legal stored values
    Returns how many pixels of `after` or `before` are not finite; those are left alone.
    """
    h, w = d_cb.shape
    bad = 0
    zero, one = np.float32(0), np.float32(1)
    infinite = np.int32(0x7F800000)
    for j in range(h):
        for k in range(w):
            r0, g0, b0 = before_bits[j, k, 0], before_bits[j, k, 1], before_bits[j, k, 2]
            r1, g1, b1 = after_bits[j, k, 0], after_bits[j, k, 1], after_bits[j, k, 2]
            dy, db, dr = zero, zero, zero
            if r0 != r1 or g0 != g1 or b0 != b1:
                old_odd = (r0 & infinite) == infinite or (g0 & infinite) == infinite or (b0 & infinite) == infinite
                if old_odd or (r1 & infinite) == infinite or (g1 & infinite) == infinite or (b1 & infinite) == infinite:
                    bad += 1
                else:
                    for c in range(3):
                        b = _encoded(before_bits[j, k, c], before[j, k, c], table)
                        a = _encoded(after_bits[j, k, c], after[j, k, c], table)
                        a = min(max(a, min(b, zero)), max(b, one))
                        d = a - b
                        dy += to_yuv[0, c] * d
                        db += to_yuv[1, c] * d
                        dr += to_yuv[2, c] * d
                    step = np.int32(np.rint(dy * factor))
                    if step != 0:
                        old = np.int32(y[y0 + j, x0 + k])
                        y[y0 + j, x0 + k] = min(max(old + step, min(old, low)), max(old, high))
            elif (r0 & infinite) == infinite or (g0 & infinite) == infinite or (b0 & infinite) == infinite:
                bad += 1
            d_cb[j, k] = db
            d_cr[j, k] = dr
    return bad


@numba.njit(cache=True, nogil=True)
def edit_chroma(plane, diff, rect, picture, steps, cosited, factor, low, high):
    """Adds per-pixel chroma differences (of coded `rect`) to one chroma plane in place.

    A sample on the left/top luma sample takes a tent of the differences, one in the middle a box; beyond the rectangle
    the difference is zero, beyond the picture its edge goes on. Only samples on the grid inside the rectangle,
    grown to that grid, can change.
    """
    x0, y0, x1, y1 = rect
    width, height = picture
    sx, sy = steps
    nx, ny = 1 << sx, 1 << sy
    ca, cb = x0 >> sx, -(-x1 >> sx)
    ra, rb = y0 >> sy, -(-y1 >> sy)
    rows = np.zeros((y1 - y0, cb - ca), np.float32)
    tent_x = cosited[0] and sx > 0
    tent_y = cosited[1] and sy > 0
    for j in range(y1 - y0):
        for i in range(cb - ca):
            total, centre = np.float32(0), (ca + i) << sx
            for k in range(1 - nx if tent_x else 0, nx):
                x = min(max(centre + k, 0), width - 1)
                if x0 <= x < x1:
                    total += diff[j, x - x0] * np.float32((nx - abs(k)) / (nx * nx) if tent_x else 1.0 / nx)
            rows[j, i] = total
    for r in range(ra, rb):
        for i in range(cb - ca):
            total, centre = np.float32(0), r << sy
            for k in range(1 - ny if tent_y else 0, ny):
                yy = min(max(centre + k, 0), height - 1)
                if y0 <= yy < y1:
                    total += rows[yy - y0, i] * np.float32((ny - abs(k)) / (ny * ny) if tent_y else 1.0 / ny)
            step = np.int32(np.rint(total * factor))
            if step != 0:
                old = np.int32(plane[r, ca + i])
                plane[r, ca + i] = min(max(old + step, min(old, low)), max(old, high))
