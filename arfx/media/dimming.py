"""Less light on what the picture shows, worked out line by line in its stored samples: no picture in linear light is made.

Where the camera adds nothing of its own (no bias) no linear value is needed at all: a coded value c above the transfer
function's toe stands for ((c + a) / (1 + a))^power, so a share k of that light is coded k^(1/power) (c + a) - a, and one on
the toe's line k c; the larger of the two (the smaller, of more light than there was) is off by at most .3 grey levels of
255, just above the toe. Compiled, as in kernels.py.
"""

# mypy: no-check-untyped-defs
from __future__ import annotations

import numba
import numpy as np

from arfx.media.curves import FAST, apply_curve, power_of
from arfx.media.lines import add_steps, chroma_span, clipped_differences, coded_line, reduce_line, taps


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def dim_luma(
    y, u, v, rect, hole, left, opacity, bias, steps, cosited, chroma_size, scale, matrix, curves, to_yuv, picture_width, factor,
    legal, chroma, reach,
):  # fmt: skip
    """Dims luma plane y in place; leaves the chroma differences as `edit_luma` does, for `edit_chroma`.

    rect, hole : x0, y0, x1, y1, coded; inside `hole` nothing changes;  left : (h, w, 3 or 1) share of linear light that is left
    opacity : how much of that change is shown;  bias : (3,) linear, what is no light and stays, None = none
    steps ... matrix : as in `linear_from_yuv`;  curves : decoding, encoding, (2,) exponent of the encoding's power and its a
    to_yuv : (3, 3) from R'G'B';  factor : stored steps per unit of luma;  legal : lowest, highest stored luma
    """
    x0, y0, x1, y1 = rect
    sx = steps[0]
    w, n = x1 - x0, chroma.shape[2]
    c0, c1 = chroma_span(x0, x1, sx, chroma_size[0])
    few, cb, cr = np.empty(c1 - c0, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    k, m, coded = np.empty((3, w), np.float32), np.empty((3, w), np.float32), np.empty((3, w), np.float32)
    room, room2, light = np.empty(w, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    low_tap, high_tap, weights = taps(sx, cosited[0] and sx > 0)
    start = ((x0 >> sx) << sx) + low_tap
    wide = np.zeros((2, (n << sx) + high_tap - low_tap), np.float32)
    at = x0 - start
    first = max(((x0 - high_tap + 1) >> sx) - (x0 >> sx), 0)
    last = min(((x1 - 1 - low_tap) >> sx) + 1 - (x0 >> sx), n)
    dy, d_cb, d_cr = np.empty(w, np.float32), wide[0, at : at + w], wide[1, at : at + w]
    for j in range(y1 - y0):
        row = y0 + j
        reach[j, 0], reach[j, 1] = 0, 0
        grey = _shares(left[j], opacity, k)
        if grey < 0:
            continue
        coded_line(y, u, v, row, x0, steps, cosited, chroma_size, scale, matrix, few, cb, cr, coded)
        for c in range(3):
            one = 0 if grey else c
            if bias is None:
                if one == c:
                    power_of(k[c], curves[2][0], room, room2, m[c])
                _dimmed(coded[c], k[one], m[one], curves[2][1])
            else:
                apply_curve(coded[c], curves[0], room, room2, light)
                _less(light, k[one], bias[c])
                apply_curve(light, curves[1], room, room2, m[c])
                clipped_differences(coded[c], m[c])
        diff = coded if bias is None else m
        _to_yuv(diff[0], diff[1], diff[2], to_yuv, dy, d_cb, d_cr)
        h0 = h1 = w
        if hole[1] <= row < hole[3]:
            h0, h1 = min(max(hole[0] - x0, 0), w), min(max(hole[2] - x0, 0), w)
            d_cb[h0:h1], d_cr[h0:h1] = 0, 0
        add_steps(y[row, x0 : x0 + h0], dy[:h0], factor, legal[0], legal[1])
        add_steps(y[row, x0 + h1 : x1], dy[h1:], factor, legal[0], legal[1])
        reach[j, 0], reach[j, 1] = first, last
        for c in range(2):
            if x0 == 0:
                wide[c, :at] = wide[c, at]
            if x1 == picture_width:
                wide[c, at + w :] = wide[c, at + w - 1]
            reduce_line(wide[c, first << sx :], sx, weights, chroma[c, j, first:last])


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _shares(left, opacity, k):
    """k (3, w) : share of light left of one line (w, 3 or 1). Returns 1 where all channels are alike, -1 where nothing is taken,
    else 0; then k[0] alone is set."""
    one, zero = np.float32(1), np.float32(0)
    flat = left.reshape(-1)
    bits, n, step = flat.view(np.int32), left.shape[0], np.uintp(left.shape[1])
    apart, taken = np.int32(0), np.int32(0)
    if step == 1:
        for i in range(n):
            taken |= bits[i] ^ np.int32(0x3F800000)  # the bits of 1
    else:
        for i in range(n):
            at = np.uintp(i) * np.uintp(3)
            apart |= (bits[at] ^ bits[at + np.uintp(1)]) | (bits[at] ^ bits[at + np.uintp(2)])
            taken |= bits[at] ^ np.int32(0x3F800000)
    if apart == 0 and taken == 0:
        return -1
    if step == 1:
        share = k[0]
        for i in range(n):
            share[i] = max(one + opacity * (flat[i] - one), zero)
        return 1
    for c in range(1 if apart == 0 else 3):
        share, first = k[c], np.uintp(c)
        for i in range(n):
            share[i] = max(one + opacity * (flat[np.uintp(i) * np.uintp(3) + first] - one), zero)
    return 1 if apart == 0 else 0


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _dimmed(coded, k, m, a):
    """coded (w,) becomes its change.  k : share of light that is left;  m : its power"""
    zero, one = np.float32(0), np.float32(1)
    for i in range(coded.shape[0]):
        c = coded[i]
        p = abs(c)
        curved, straight = m[i] * (p + a) - a, k[i] * p
        new = max(curved, straight) if k[i] <= one else min(curved, straight)
        coded[i] = min(new if c >= zero else -new, max(c, one)) - c


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _less(light, k, bias):
    """light (w,) becomes what it is with a share k of it left."""
    for i in range(light.shape[0]):
        light[i] = bias + k[i] * (light[i] - bias)


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _to_yuv(r, g, b, to_yuv, dy, d_cb, d_cr):
    """R'G'B' differences (w,) to luma and chroma."""
    for i in range(r.shape[0]):
        dy[i] = to_yuv[0, 0] * r[i] + to_yuv[0, 1] * g[i] + to_yuv[0, 2] * b[i]
        d_cb[i] = to_yuv[1, 0] * r[i] + to_yuv[1, 1] * g[i] + to_yuv[1, 2] * b[i]
        d_cr[i] = to_yuv[2, 0] * r[i] + to_yuv[2, 1] * g[i] + to_yuv[2, 2] * b[i]
