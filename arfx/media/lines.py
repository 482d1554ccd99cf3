"""Steps over one line of samples that reading, editing and dimming share: transfer
functions, chroma between its samples and back, and differences added to what is stored.
Compiled, without branches inside, of which the compiler makes vector code.

Transfer functions go without tables. A power is 2^(p log2 x), each by a short series: three
times as quick as looking values up, and no table competes with the picture for the cache.
Error: below 2e-6 of the value, and of the power."""

# mypy: disable-error-code="no-untyped-def, index, assignment"
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

from arfx.core.colour import Transfer
from arfx.core.compiled import FAST, line_kernel

# Under this linear value a pure power is replaced by the chord to zero: less than 1e-7 of
# white in coded values.
_DARKEST = 1e-17


class Planes(NamedTuple):
    """Whole-line planes and how they are read. steps : log2 of the chroma step (x, y)
    cosited : chroma on the left/top luma sample;  chroma_size : columns, rows;  scale : y
    offset, y factor, chroma offset,
    chroma factor;  matrix : R from Cr, G from Cb, G from Cr, B from Cb"""

    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    steps: tuple[int, int]
    cosited: tuple[bool, bool]
    chroma_size: tuple[int, int]
    scale: tuple[np.float32, np.float32, np.float32, np.float32]
    matrix: tuple[np.float32, np.float32, np.float32, np.float32]


class Luma(NamedTuple):
    """How changes are written. to_yuv : (3, 3) from R'G'B';  factor : stored steps per unit
    of luma;  low, high : legal stored
    values;  width : of the picture"""

    to_yuv: np.ndarray
    factor: np.float32
    low: int
    high: int
    width: int


class Chroma(NamedTuple):
    """What is to be added to chroma. lines : (2, h, n) float32 Cb and Cr differences,
    -0.5..0.5, of a rectangle's columns
    changed_columns : (h, 2) first of those columns that changes and the one behind the last
    """

    lines: np.ndarray
    changed_columns: np.ndarray


@numba.njit(cache=True, nogil=True)
def line_scratch(lines, width):
    """(lines, width + 2 or more) float32 scratch, each of whole cache lines."""
    return np.empty((lines, (width + 17) // 16 * 16), np.float32)


@numba.njit(cache=True, nogil=True)
def chroma_span(x0, x1, step, columns):
    """First chroma column that luma columns x0 ...

    x1 - 1 may ask for, and the one behind the last.
    """
    return max((x0 >> step) - 1, 0), min(((x1 - 1) >> step) + 2, columns)


@line_kernel(fastmath=FAST)
def coded_line(planes: Planes, row, x0, samples, cb, cr, coded):
    """coded (3, w or more) = R'G'B' of w pixels of one line from column x0 on.
    samples (n,), cb, cr (w,) : scratch, n of the columns' `chroma_span`"""
    y, u, v, (sx, sy), cosited, (cw, ch), scale, matrix = planes
    yo, yf, co, cf = scale
    w = cb.shape[0]
    c0, c1 = chroma_span(x0, x0 + w, sx, cw)
    c = (
        np.float32(row / (1 << sy))
        if cosited[1]
        else np.float32((row + 0.5) / (1 << sy) - 0.5)
    )
    c = min(max(c, np.float32(0)), np.float32(ch - 1))
    r0 = np.int32(c)
    r1 = min(r0 + 1, ch - 1)
    _interpolate_rows(u[r0, c0:c1], u[r1, c0:c1], c - np.float32(r0), co, cf, samples)
    _upsample(samples, c0, cw, sx, cosited[0], x0, cb)
    _interpolate_rows(v[r0, c0:c1], v[r1, c0:c1], c - np.float32(r0), co, cf, samples)
    _upsample(samples, c0, cw, sx, cosited[0], x0, cr)
    _rgb(y[row, x0 : x0 + w], cb, cr, yo, yf, matrix, coded)


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _rgb(line, cb, cr, offset, factor, matrix, coded):
    rv, gu, gv, bu = matrix
    for k in range(line.shape[0]):
        luma = (np.float32(line[k]) - offset) * factor
        coded[0, k] = luma + rv * cr[k]
        coded[1, k] = luma - gu * cb[k] - gv * cr[k]
        coded[2, k] = luma + bu * cb[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _interpolate_rows(above, below, part, offset, factor, out):
    """Chroma between two lines of samples, -0.5..0.5."""
    for i in range(out.shape[0]):
        a, b = np.float32(above[i]), np.float32(below[i])
        out[i] = (a + part * (b - a) - offset) * factor


@line_kernel(fastmath=FAST)
def _upsample(samples, c0, columns, step, cosited, x0, out):
    """Chroma at the luma columns x0 ...

    of one line, linear between samples. samples : of the chroma columns from c0 on
    """
    n = out.shape[0]
    if step == 0:
        for k in range(n):
            out[k] = samples[np.uintp(x0 - c0 + k)]
        return
    last = columns - 1
    if step == 1:
        before = np.float32(0) if cosited else np.float32(0.25)
        after = np.float32(0.5) if cosited else np.float32(0.25)
        inner, stop = max(x0 + x0 % 2, 2), min(x0 + n, 2 * last)
        stop = inner + max(stop - inner, 0) // 2 * 2  # in pairs where both neighbours exist
        if stop > inner:
            own, earlier, pairs = (
                samples[inner // 2 - c0 :],
                samples[inner // 2 - c0 - 1 :],
                out[inner - x0 : stop - x0],
            )
            for i in range((stop - inner) // 2):
                a, b, c = earlier[i], own[i], own[i + 1]
                pairs[2 * i] = b + before * (a - b)
                pairs[2 * i + 1] = b + after * (c - b)
        for q in range(n - (stop - inner)):
            k = q if stop == inner or x0 + q < inner else q + stop - inner
            i = (x0 + k) >> 1
            m, part = (min(i + 1, last), after) if (x0 + k) & 1 else (max(i - 1, 0), before)
            out[k] = samples[i - c0] + part * (samples[m - c0] - samples[i - c0])
        return
    scale = np.float32(1.0 / (1 << step))
    shift = np.float32(0) if cosited else np.float32(0.5) * scale - np.float32(0.5)
    for k in range(n):
        c = min(max(np.float32(x0 + k) * scale + shift, np.float32(0)), np.float32(last))
        i = np.int32(c)
        m = min(i + 1, last)
        out[k] = samples[i - c0] + (c - np.float32(i)) * (samples[m - c0] - samples[i - c0])


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def to_luma_and_chroma(diff, to_yuv, dy, d_cb, d_cr):
    """R'G'B' differences (3 n,) to luma and chroma (n,)."""
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(dy.shape[0]):
        i = np.uintp(k) * three
        r, g, b = diff[i], diff[i + one], diff[i + two]
        dy[k] = to_yuv[0, 0] * r + to_yuv[0, 1] * g + to_yuv[0, 2] * b
        d_cb[k] = to_yuv[1, 0] * r + to_yuv[1, 1] * g + to_yuv[1, 2] * b
        d_cr[k] = to_yuv[2, 0] * r + to_yuv[2, 1] * g + to_yuv[2, 2] * b


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def add_steps(line, diff, factor, low, high):
    """Adds diff (n,) x factor, rounded, to stored samples; legal ones stay legal, others go
    no further out.
    """
    for k in range(diff.shape[0]):
        old = np.int32(line[k])
        line[k] = min(
            max(old + np.int32(np.rint(diff[k] * factor)), min(old, low)), max(old, high)
        )


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def reduce_line(line, step, weights, out):
    """out[i] = weighted sum of the samples of `line` from i << step on."""
    if step == 1 and weights.shape[0] == 3:
        for i in range(out.shape[0]):
            out[i] = (
                weights[0] * line[2 * i]
                + weights[1] * line[2 * i + 1]
                + weights[2] * line[2 * i + 2]
            )
        return
    out[:] = 0
    for k in range(weights.shape[0]):
        for i in range(out.shape[0]):
            out[i] += weights[k] * line[np.uintp((i << step) + k)]


@numba.njit(cache=True, nogil=True)
def taps(step, tent):
    """Offsets from a chroma sample's first luma sample (from, to) and the weights of the
    luma samples there.
    """
    n = 1 << step
    low = 1 - n if tent else 0
    weights = np.empty(n - low, np.float32)
    for k in range(low, n):
        weights[k - low] = (n - abs(k)) / (n * n) if tent else 1.0 / n
    return low, n, weights


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def clipped_differences(before, after):
    """after = after - before (n,), coded, with `after` kept between black and white or
    where `before` already lay beyond.
    """
    zero, one = np.float32(0), np.float32(1)
    for k in range(before.shape[0]):
        b = before[k]
        after[k] = min(max(after[k], min(b, zero)), max(b, one)) - b


@lru_cache(maxsize=8)
def decode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `apply_curve`: from coded values to linear light."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        toe = _DARKEST ** (1 / power)
        slope = toe / _DARKEST
    return np.array([toe, 1 / slope, alpha - 1, 1 / alpha, power, 1, 0], np.float32)


@lru_cache(maxsize=8)
def encode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `apply_curve`: from linear light to coded values."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        slope = _DARKEST ** (1 / power) / _DARKEST
        toe = _DARKEST * slope
    return np.array([toe / slope, slope, 0, 1, 1 / power, alpha, alpha - 1], np.float32)


@line_kernel(fastmath=FAST, error_model="numpy")
def apply_curve(values, curve, base, mantissa, out):
    """out[k] = the curve of values[k] (n,) float32, odd in the value; base, mantissa (n,)
    float32 : scratch.
    curve : toe, factor of the line up to it, then what is added, factor, power, factor and
    what is taken off above it
    """
    n = values.shape[0]
    toe, line, add, scale, power, gain, minus = (
        curve[0],
        curve[1],
        curve[2],
        curve[3],
        curve[4],
        curve[5],
        curve[6],
    )
    for k in range(n):
        base[k] = max((abs(values[k]) + add) * scale, np.float32(1e-30))
    _power(base[:n], power, mantissa[:n], out)
    for k in range(n):
        v = values[k]
        a = abs(v)
        c = a * line if a <= toe else gain * out[k] - minus
        out[k] = c if v >= np.float32(0) else -c


@line_kernel(fastmath=FAST, error_model="numpy")
def power_of(values, power, base, mantissa, out):
    """out[k] = values[k]^power (n,) float32 of values >= 0; base, mantissa (n,) float32 :
    scratch.
    """
    n = values.shape[0]
    for k in range(n):
        base[k] = max(values[k], np.float32(1e-30))
    _power(base[:n], power, mantissa[:n], out)


@line_kernel(fastmath=FAST, error_model="numpy")
def _power(base, power, mantissa, out):
    """out = base^power (n,) of positive normal float32; `base` and `mantissa` are used up."""
    one, middle, shift = (
        np.float32(1),
        np.int32(0x3F3504F3),
        np.int32(23),
    )  # the bits of sqrt(1/2)
    bits, inner = base.view(np.int32), mantissa.view(np.int32)
    for k in range(bits.shape[0]):
        inner[k] = bits[k] - (
            ((bits[k] - middle) >> shift) << shift
        )  # sqrt(1/2) .. sqrt(2)
    for k in range(bits.shape[0]):
        m = mantissa[k]
        z = (m - one) / (m + one)
        q = z * z
        series = np.float32(0.577078016) + q * (
            np.float32(0.412198583) + q * np.float32(0.320598898)
        )
        series = z * (
            np.float32(2.885390082) + q * (np.float32(0.961796694) + q * series)
        )  # log2 m
        x = power * (np.float32((bits[k] - middle) >> shift) + series)
        x = min(max(x, np.float32(-126)), np.float32(127))
        whole = np.int32(x + np.float32(128.5)) - np.int32(128)
        f = x - np.float32(whole)  # -0.5 .. 0.5
        two = np.float32(0.00961812911) + f * (
            np.float32(0.00133335581) + f * np.float32(0.000154035304)
        )
        two = np.float32(0.240226507) + f * (np.float32(0.0555041087) + f * two)
        out[k] = one + f * (np.float32(0.693147181) + f * two)  # 2^f
        bits[k] = (whole + np.int32(127)) << shift
    for k in range(bits.shape[0]):
        out[k] *= base[k]
