"""Less light on what the picture shows, worked out line by line in its stored samples: no
picture in linear light is made.

Where the camera adds nothing of its own (no bias) no linear value is needed at all: a coded
value c above the transfer function's toe stands for ((c + a) / (1 + a))^power, so a
fraction k of that light is coded k^(1/power) (c + a) - a, and one on the toe's line k c;
the larger of the two (the smaller, of more light than there was) is off by at most .3 grey
levels of 255, just above the toe. Compiled, as in kernels.py."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import FAST, line_kernel
from arfx.media.lines import (
    Chroma,
    Luma,
    Planes,
    add_steps,
    apply_curve,
    chroma_span,
    clipped_differences,
    coded_line,
    line_scratch,
    power_of,
    reduce_line,
    taps,
)

_BLOCK = 64  # pixels


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def dim_luma(
    planes: Planes,
    rect,
    hole,
    transmittance,
    opacity,
    bias,
    curves,
    luma: Luma,
    chroma: Chroma,
):
    """Dims the luma plane in place; sets the chroma differences as `edit_luma` does, for
    `edit_chroma`.
    rect, hole : x0, y0, x1, y1, coded; inside `hole` nothing changes;  transmittance : (h,
    w, 3 or 1), of linear light
    opacity : how much of that change is shown;  bias : (3,) linear, what is no light and stays
    curves : decoding, encoding, (2,) exponent of the encoding's power and its a"""
    scratch = line_scratch(16, rect[2] - rect[0])
    step = planes.steps[0]
    tapped = taps(step, planes.cosited[0] and step > 0)
    wide = np.zeros(
        (2, (chroma.lines.shape[2] << step) + tapped[1] - tapped[0]), np.float32
    )
    _dim_lines(
        planes,
        rect,
        hole,
        transmittance,
        opacity,
        bias,
        curves,
        luma,
        chroma,
        (tapped, wide, scratch),
    )


@line_kernel(fastmath=FAST)
def _dim_lines(
    planes: Planes,
    rect,
    hole,
    transmittance,
    opacity,
    bias,
    curves,
    luma: Luma,
    chroma: Chroma,
    work,
):
    (low_tap, high_tap, weights), wide, scratch = work
    lines, changed_columns = chroma
    channels, biased = transmittance.shape[2], bias[0] != 0 or bias[1] != 0 or bias[2] != 0
    x0, y0, x1, y1 = rect
    sx, n = planes.steps[0], lines.shape[2]
    k, m, coded = scratch[:3], scratch[3:6], scratch[6:9]
    samples, cb, cr, dy = scratch[9], scratch[10], scratch[11], scratch[12]
    light, base, mantissa = scratch[13], scratch[14], scratch[15]
    at = x0 - ((x0 >> sx) << sx) - low_tap  # place in `wide` of the first pixel
    d_cb, d_cr = wide[0, at:], wide[1, at:]
    for j in range(y1 - y0):
        row = y0 + j
        row_transmittance = transmittance[j].reshape(-1)
        first, last = _dimmed_span(row_transmittance.view(np.int32), channels, x1 - x0)
        changed_columns[j, 0], changed_columns[j, 1] = 0, 0
        if first >= last:
            continue
        h0 = h1 = last
        if hole[1] <= row < hole[3]:
            h0, h1 = (
                min(max(hole[0] - x0, first), last),
                min(max(hole[2] - x0, first), last),
            )
        for a, b in ((first, h0), (h1, last)):
            if a >= b:
                continue
            w = b - a
            grey = _transmittances(
                row_transmittance[a * channels : b * channels], channels, opacity, k, w
            )
            c0, c1 = chroma_span(x0 + a, x0 + b, sx, planes.chroma_size[0])
            coded_line(planes, row, x0 + a, samples[: c1 - c0], cb[:w], cr[:w], coded)
            for c in range(3):
                one = 0 if grey else c
                if biased:
                    apply_curve(coded[c, :w], curves[0], base, mantissa, light)
                    _attenuate(light[:w], k[one], bias[c])
                    apply_curve(light[:w], curves[1], base, mantissa, m[c])
                    clipped_differences(coded[c, :w], m[c])
                else:
                    if one == c:
                        power_of(k[c, :w], curves[2][0], base, mantissa, m[c])
                    _dimmed(coded[c, :w], k[one], m[one], curves[2][1])
            diff = m if biased else coded
            _to_yuv(diff[0], diff[1], diff[2], luma.to_yuv, dy[:w], d_cb[a:], d_cr[a:])
            add_steps(
                planes.y[row, x0 + a : x0 + b], dy[:w], luma.factor, luma.low, luma.high
            )
        c0 = max(((x0 + first - high_tap + 1) >> sx) - (x0 >> sx), 0)
        c1 = min(((x0 + last - 1 - low_tap) >> sx) + 1 - (x0 >> sx), n)
        changed_columns[j, 0], changed_columns[j, 1] = c0, c1
        for c in range(2):
            line = wide[c]
            line[c0 << sx : at + first] = 0
            line[at + h0 : at + h1] = 0
            line[at + last : (c1 << sx) + high_tap - low_tap] = 0
            if x0 + first == 0:
                line[:at] = line[at]
            if x0 + last == luma.width:
                line[at + last :] = line[at + last - 1]
            reduce_line(line[c0 << sx :], sx, weights, lines[c, j, c0:c1])


@line_kernel(fastmath=FAST)
def _dimmed_span(bits, channels, n):
    """First pixel of a line of n that something is taken from, and the one behind the last,
    by blocks of _BLOCK. bits (n channels,) : of the transmittance"""
    first, last = 0, n
    while first < last and _all_one(
        bits[first * channels : min(first + _BLOCK, n) * channels]
    ):
        first += _BLOCK
    while last > first and _all_one(
        bits[(last - 1) // _BLOCK * _BLOCK * channels : last * channels]
    ):
        last = (last - 1) // _BLOCK * _BLOCK
    return min(first, last), last


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _all_one(bits):
    """Whether all of these float32 bits are those of 1."""
    taken = np.int32(0)
    for i in range(bits.shape[0]):
        taken |= bits[i] ^ np.int32(0x3F800000)  # the bits of 1
    return taken == 0


@line_kernel(fastmath=FAST)
def _transmittances(flat, step, opacity, k, n):
    """k (3, n) : transmittance of n pixels with the opacity, of flat (n step,), step values each.
    Returns whether all channels are alike; then k[0] alone is set."""
    one, zero = np.float32(1), np.float32(0)
    if step == 1:
        fraction = k[0]
        for i in range(n):
            fraction[i] = max(one + opacity * (flat[i] - one), zero)
        return True
    bits, differs = flat.view(np.int32), np.int32(0)
    for i in range(n):
        at = np.uintp(i) * np.uintp(3)
        differs |= (bits[at] ^ bits[at + np.uintp(1)]) | (bits[at] ^ bits[at + np.uintp(2)])
    for c in range(1 if differs == 0 else 3):
        fraction, first = k[c], np.uintp(c)
        for i in range(n):
            fraction[i] = max(
                one + opacity * (flat[np.uintp(i) * np.uintp(3) + first] - one), zero
            )
    return differs == 0


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _dimmed(coded, k, m, a):
    """coded (w,) becomes its change.  k : transmittance;  m : its power"""
    zero, one = np.float32(0), np.float32(1)
    for i in range(coded.shape[0]):
        c = coded[i]
        p = abs(c)
        curved, straight = m[i] * (p + a) - a, k[i] * p
        new = max(curved, straight) if k[i] <= one else min(curved, straight)
        coded[i] = min(new if c >= zero else -new, max(c, one)) - c


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _attenuate(light, k, bias):
    """light (w,) is attenuated by k above the bias."""
    for i in range(light.shape[0]):
        light[i] = bias + k[i] * (light[i] - bias)


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _to_yuv(r, g, b, to_yuv, dy, d_cb, d_cr):
    """R'G'B' differences (w,) to luma and chroma."""
    for i in range(dy.shape[0]):
        dy[i] = to_yuv[0, 0] * r[i] + to_yuv[0, 1] * g[i] + to_yuv[0, 2] * b[i]
        d_cb[i] = to_yuv[1, 0] * r[i] + to_yuv[1, 1] * g[i] + to_yuv[1, 2] * b[i]
        d_cr[i] = to_yuv[2, 0] * r[i] + to_yuv[2, 1] * g[i] + to_yuv[2, 2] * b[i]
