"""What reading, editing and dimming do with a line of samples: transfer functions, chroma
between its samples and back, and differences added to what is stored. Compiled.

A pixel's three values lie side by side in a line, (3 w,).

Transfer functions go without tables. A power is 2^(p log2 x), each by a short series: three
times as quick as looking values up, and no table competes with the picture for the cache.
Error: below 2e-6 of the value, and of the power."""

# mypy: disable-error-code="no-untyped-def, index, assignment, call-arg, var-annotated"
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic

from arfx.core.colour import Transfer
from arfx.core.compiled import FAST, line_kernel

# Under this linear value a pure power is replaced by the chord to zero: less than 1e-7 of
# white in coded values.
_DARKEST = 1e-17
MARGIN = 16  # values by which scratch lines are longer than the picture's part
_F, _I = np.float32, np.int32


class Planes(NamedTuple):
    """Stored samples and what they stand for.

    planes : whole lines of luma, Cb and Cr, of green, blue and red, or three times of grey
    size : columns and rows of the picture;  steps : log2 of the chroma step (x, y)
    middle : (x, y) 0 where chroma lies on the left/top luma sample of its group, 0.5 in its
    middle;  stored : (3, 5) of each plane's samples: that of 0, size of a step, steps up to 1,
    lowest and highest legal one
    rgb_from_planes, planes_from_rgb : (3, 3), coded;  decoding, encoding : for `curved`
    across, down : weights of the luma samples from 2^step - 1 before to 2^step - 1 behind a
    group's first one in its chroma"""

    planes: tuple[np.ndarray, np.ndarray, np.ndarray]
    size: tuple[int, int]
    steps: tuple[int, int]
    middle: tuple[np.float32, np.float32]
    stored: tuple[tuple[np.float32, ...], ...]
    rgb_from_planes: tuple[tuple[np.float32, ...], ...]
    planes_from_rgb: tuple[tuple[np.float32, ...], ...]
    decoding: tuple[np.float32, ...]
    encoding: tuple[np.float32, ...]
    across: np.ndarray
    down: np.ndarray


@intrinsic
def bits_of(_context: Any, value: Any) -> Any:
    """The bits of a float32 as int32, and those of an int32 as float32."""
    kind = types.int32 if value == types.float32 else types.float32

    def made(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(kind))

    return kind(value), made


@line_kernel(fastmath=FAST, error_model="numpy")
def power_of(base, power):
    """base^power of a float32 >= 0."""
    one, middle, shift = _F(1), _I(0x3F3504F3), _I(23)  # the bits of sqrt(1/2)
    bits = bits_of(max(base, _F(1e-30)))
    exponent = _I(_I(bits - middle) >> shift)
    m = bits_of(_I(bits - _I(exponent << shift)))  # sqrt(1/2) .. sqrt(2)
    z = (m - one) / (m + one)
    q = z * z
    series = _F(0.577078016) + q * (_F(0.412198583) + q * _F(0.320598898))
    series = z * (_F(2.885390082) + q * (_F(0.961796694) + q * series))  # log2 m
    x = min(max(power * (_F(exponent) + series), _F(-126)), _F(127))
    rounding = _F(3 << 22)  # added to it, a number loses what is behind the point
    whole = x + rounding
    f = x - (whole - rounding)  # -0.5 .. 0.5
    two = _F(0.00961812911) + f * (_F(0.00133335581) + f * _F(0.000154035304))
    two = _F(0.240226507) + f * (_F(0.0555041087) + f * two)
    two = one + f * (_F(0.693147181) + f * two)  # 2^f
    return two * bits_of(_I(_I(bits_of(whole) + _I(127)) << shift))


@line_kernel(fastmath=FAST, error_model="numpy")
def curved(value, curve):
    """A float32 on a curve, odd in the value. curve : toe, factor of the line up to it, then
    what is added, factor, power, factor and what is taken off above it
    """
    a = abs(value)
    above = curve[5] * power_of((a + curve[2]) * curve[3], curve[4]) - curve[6]
    c = a * curve[1] if a <= curve[0] else above
    return c if value >= _F(0) else -c


def decode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `curved`: from coded values to linear light."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        toe = _DARKEST ** (1 / power)
        slope = toe / _DARKEST
    return np.array([toe, 1 / slope, alpha - 1, 1 / alpha, power, 1, 0], np.float32)


def encode_curve(transfer: Transfer) -> np.ndarray:
    """(7,) float32 for `curved`: from linear light to coded values."""
    toe, slope, alpha, power = transfer.curve
    if toe == 0:
        slope = _DARKEST ** (1 / power) / _DARKEST
        toe = _DARKEST * slope
    return np.array([toe / slope, slope, 0, 1, 1 / power, alpha, alpha - 1], np.float32)


@line_kernel(fastmath=FAST)
def coded_line(p: Planes, row, x0, scratch, out):
    """out (3 w,) = R'G'B' of w pixels of one line from column x0 on.
    scratch : (3, w + MARGIN). Chroma is linear between its samples."""
    (width, height), (sx, sy) = p.size, p.steps
    w = out.shape[0] // 3
    last = (height - 1) >> sy
    place = (_F(row) + p.middle[1]) / _F(1 << sy) - p.middle[1]
    place = min(max(place, _F(0)), _F(last))
    r0 = _I(place)
    r1, part = min(r0 + 1, last), place - _F(r0)
    first = (x0 >> sx) - 1  # with one sample more at both ends
    n = ((x0 + w - 1) >> sx) - first + 2
    a, b = max(-first, 0), min(n, -(-width >> sx) - first)
    samples = scratch[2, :n]
    for c in range(1, 3):
        plane, zero, scale = p.planes[c], p.stored[c][0], p.stored[c][1]
        above, below = plane[r0, first + a : first + b], plane[r1, first + a : first + b]
        inner = samples[a:b]
        for i in range(b - a):
            top = _F(above[i])
            inner[i] = (top + part * (_F(below[i]) - top) - zero) * scale
        samples[0], samples[n - 1] = samples[a], samples[b - 1]
        _upsample(samples, sx, p.middle[0], scratch[c - 1])
    start = x0 - ((x0 >> sx) << sx)
    luma = p.planes[0][row, x0 : x0 + w]
    _to_rgb(
        luma, scratch[0, start:], scratch[1, start:], p.stored[0], p.rgb_from_planes, out
    )


@line_kernel(fastmath=False)  # so sums of three products are rounded alike everywhere
def _to_rgb(luma, u, v, stored, m, out):
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(luma.shape[0]):
        i, y = np.uintp(k) * three, (_F(luma[k]) - stored[0]) * stored[1]
        out[i] = m[0][0] * y + m[0][1] * u[k] + m[0][2] * v[k]
        out[i + one] = m[1][0] * y + m[1][1] * u[k] + m[1][2] * v[k]
        out[i + two] = m[2][0] * y + m[2][1] * u[k] + m[2][2] * v[k]


@line_kernel(fastmath=FAST)
def _upsample(samples, step, middle, out):
    """Between samples (n,): values at the luma columns of all groups but the outer two."""
    n = samples.shape[0] - 2
    if step == 1:  # in pairs
        before, after = middle * _F(0.5), _F(0.5) - middle * _F(0.5)
        for i in range(n):
            a, b, c = samples[i], samples[i + 1], samples[i + 2]
            out[2 * i] = b + before * (a - b)
            out[2 * i + 1] = b + after * (c - b)
        return
    for k in range(1 << step):
        part = (_F(k) + middle) / _F(1 << step) - middle
        other = samples[2:] if part >= 0 else samples
        for i in range(n):
            own = samples[i + 1]
            out[(i << step) + k] = own + abs(part) * (other[i] - own)


@line_kernel(fastmath=FAST)
def _add_steps(line, differences, stored):
    """Differences (n,) in steps, rounded, to stored samples; legal ones stay legal, others
    go no further out."""
    scale, low, high = stored[2], stored[3], stored[4]
    for k in range(differences.shape[0]):
        old = _F(line[k])
        new = old + np.rint(differences[k] * scale)
        line[k] = _I(min(max(new, min(old, low)), max(old, high)))


@line_kernel(fastmath=FAST)
def limited(before, after):
    """after - before, coded, with `after` kept between black and white or where `before`
    already lay beyond."""
    return min(max(after, min(before, _F(0))), max(before, _F(1))) - before


@line_kernel(fastmath=FAST)
def add_to_line(p: Planes, row, x0, coded, scratch, sums, rect):
    """Adds differences of R'G'B' (3 m,) to the luma of a line from column x0 on, and those
    of chroma to their sums.

    scratch : (3, m + 2 MARGIN);  sums : (2, h, n) of the chroma of `rect`.
    Beyond the line the difference is zero, beyond the picture its edge goes on."""
    (width, height), (sx, sy) = p.size, p.steps
    left, top = rect[0] >> sx, rect[1] >> sy
    m, t = coded.shape[0] // 3, p.planes_from_rgb
    c0, c1 = x0 >> sx, min(((x0 + m - 1) >> sx) + 2, left + sums.shape[2])
    at = x0 - (c0 << sx) + (1 << sx) - 1  # place in a line of the first pixel
    end = at + m
    scratch[1:, :at] = 0
    scratch[1:, end : end + 2 * (2 << sx)] = 0
    luma, u, v = scratch[0, :m], scratch[1, at:], scratch[2, at:]
    one, two, three = np.uintp(1), np.uintp(2), np.uintp(3)
    for k in range(m):
        i = np.uintp(k) * three
        r, g, b = coded[i], coded[i + one], coded[i + two]
        luma[k] = t[0][0] * r + t[0][1] * g + t[0][2] * b
        u[k] = t[1][0] * r + t[1][1] * g + t[1][2] * b
        v[k] = t[2][0] * r + t[2][1] * g + t[2][2] * b
    _add_steps(p.planes[0][row, x0 : x0 + m], luma, p.stored[0])
    for c in range(2):
        line = scratch[1 + c]
        if x0 == 0:
            line[:at] = line[at]
        if x0 + m == width:
            line[end : end + (2 << sx)] = line[end - 1]
    for r in range(row >> sy, min((row >> sy) + 2, top + sums.shape[1])):
        weight = _F(0)
        for k in range(p.down.shape[0]):
            place = (r << sy) + k + 1 - (1 << sy)
            if min(max(place, 0), height - 1) == row:
                weight += p.down[k]
        for c in range(2 if weight > 0 else 0):
            _add_reduced(
                scratch[1 + c],
                sx,
                p.across,
                weight,
                sums[c, r - top, c0 - left : c1 - left],
            )


@line_kernel(fastmath=FAST)
def _add_reduced(line, step, weights, weight, out):
    """out[i] += weight times the weighted sum of the samples of `line` from i << step on."""
    if step == 1:
        a, b, c = weight * weights[0], weight * weights[1], weight * weights[2]
        for i in range(out.shape[0]):
            out[i] += a * line[2 * i] + b * line[2 * i + 1] + c * line[2 * i + 2]
        return
    for k in range(weights.shape[0]):
        share = weight * weights[k]
        for i in range(out.shape[0]):
            out[i] += share * line[(i << step) + k]


@line_kernel(fastmath=FAST)
def add_chroma(p: Planes, sums, rect):
    """Adds the sums that `add_to_line` left to both chroma planes."""
    left, top = rect[0] >> p.steps[0], rect[1] >> p.steps[1]
    for c in range(2):
        for r in range(sums.shape[1]):
            line = p.planes[1 + c][top + r, left : left + sums.shape[2]]
            _add_steps(line, sums[c, r], p.stored[1 + c])
