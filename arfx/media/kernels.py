"""Between stored planes and linear light, over a rectangle only: compiled loops, and how
they are called.

Nothing is clipped when reading: values beyond black and white (limited range, out-of-gamut
chroma) come out below 0 and above 1. RGB and grey go the same way, with another matrix."""

# mypy: disable-error-code="no-untyped-def, index, assignment, call-arg"
from __future__ import annotations

from functools import lru_cache
from typing import Any

import numba
import numpy as np

from arfx.core.colour import yuv_from_rgb
from arfx.core.compiled import FAST, line_kernel
from arfx.media.lines import (
    MARGIN,
    Planes,
    add_chroma,
    add_to_line,
    bits_of,
    coded_line,
    curved,
    decode_curve,
    encode_curve,
    limited,
    power_of,
)
from arfx.media.planes import FrameFormat


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def read(p: Planes, rect, out):
    """out (h, w, 3) float32 linear RGB of coded `rect` (x0, y0, x1, y1).
    Chroma is interpolated linearly between its true positions, from samples outside the
    rectangle too."""
    _read_lines(p, rect, out, np.empty((3, out.shape[1] + MARGIN), np.float32))


@line_kernel(fastmath=FAST)
def _read_lines(p: Planes, rect, out, scratch):
    for j in range(out.shape[0]):
        line = out[j].reshape(-1)
        coded_line(p, rect[1] + j, rect[0], scratch, line)
        for i in range(line.shape[0]):
            line[i] = curved(line[i], p.decoding)


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def read_at(p: Planes, pixels, out):
    """out (n, 3) = `read` of single pixels (n, 2), x and y, coded."""
    _read_pixels(p, pixels, out, np.empty((3, 2 + MARGIN), np.float32))


@line_kernel(fastmath=FAST)
def _read_pixels(p: Planes, pixels, out, scratch):
    line, k, n = out.reshape(-1), 0, pixels.shape[0]
    while k < n:
        x, row = pixels[k, 0], pixels[k, 1]
        pair = k + 1 < n and pixels[k + 1, 0] == x + 1 and pixels[k + 1, 1] == row
        end = k + 1 + pair
        coded_line(p, row, x, scratch, line[3 * k : 3 * end])
        k = end
    for i in range(line.shape[0]):
        line[i] = curved(line[i], p.decoding)


@line_kernel(fastmath=FAST)
def _not_finite(before, after):
    """How many pixels of two lines (3 m,) have a value with all bits of its exponent set."""
    infinite, bad = np.int32(0x7F800000), 0
    for k in range(before.shape[0] // 3):
        highest = np.int32(0)
        for c in range(3):
            i = np.uintp(3) * np.uintp(k) + np.uintp(c)
            highest = max(
                highest, bits_of(before[i]) & infinite, bits_of(after[i]) & infinite
            )
        bad += highest == infinite
    return bad


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def edit(p: Planes, rect, columns, before, after):
    """Adds the difference of two pictures to the planes in place.

    rect : x0, y0, x1, y1;  columns : (h, 2), outside of which nothing is looked at, from x0
    before, after : (h, w, 3) float32 linear light
    Only chroma samples on the grid inside the rectangle, grown to that grid, can change.
    Returns how many pixels of `after` or `before` are not finite; their lines are left alone.
    """
    w = rect[2] - rect[0]
    work = np.empty(3 * w, np.float32), np.empty((3, w + 2 * MARGIN), np.float32)
    sums = _no_sums(p, rect)
    bad = _edit_lines(p, rect, columns, before, after, work, sums)
    add_chroma(p, sums, rect)
    return bad


@numba.njit(cache=True, nogil=True)
def _no_sums(p: Planes, rect):
    """(2, h, n) float32 zeros of a rectangle's chroma."""
    (sx, sy), (x0, y0, x1, y1) = p.steps, rect
    shape = 2, -(-y1 >> sy) - (y0 >> sy), -(-x1 >> sx) - (x0 >> sx)
    return np.zeros(shape, np.float32)


@line_kernel(fastmath=FAST)
def _span(a, b, first, last):
    """The first of the values from `first` to `last` that differs, and the one behind the
    last."""
    while first < last and a[first] == b[first]:
        first += 1
    while last > first and a[last - 1] == b[last - 1]:
        last -= 1
    return first, last


@line_kernel(fastmath=FAST)
def _edit_lines(p: Planes, rect, columns, before, after, work, sums):
    differences, scratch = work
    bad = 0
    for j in range(before.shape[0]):
        b, a = before[j].reshape(-1), after[j].reshape(-1)
        first, last = _span(b, a, 3 * columns[j, 0], 3 * columns[j, 1])
        first, last = first // 3, (last + 2) // 3
        b, a = b[3 * first : 3 * last], a[3 * first : 3 * last]
        found = _not_finite(b, a)
        bad += found
        if found or last <= first:
            continue
        d = differences[: b.shape[0]]
        for i in range(b.shape[0]):
            d[i] = limited(curved(b[i], p.encoding), curved(a[i], p.encoding))
        add_to_line(p, rect[1] + j, rect[0] + first, d, scratch, sums, rect)
    return bad


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def dim(p: Planes, rect, hole, transmittance, opacity, bias):
    """Less light on what the picture shows, in place: no picture in linear light is made.

    rect, hole : x0, y0, x1, y1, coded; inside `hole` nothing changes;  transmittance : (h,
    w, 3 or 1), of linear light
    opacity : how much of that change is shown;  bias : (3,) linear, what is no light and stays

    Without bias no linear value is needed: a coded value c above the transfer function's
    toe stands for ((c + a) / (1 + a))^power, so a fraction k of that light is coded
    k^(1/power) (c + a) - a, and one on the toe's line k c; the larger of the two (the
    smaller, of more light than there was) is off by at most .3 grey levels of 255, just
    above the toe."""
    w = rect[2] - rect[0]
    lines = np.ones((5, 3 * w), np.float32)
    for c in range(3):
        lines[4, c::3] = bias[c]
    work = lines, np.empty((3, w + 2 * MARGIN), np.float32)
    sums = _no_sums(p, rect)
    _dim_lines(p, rect, hole, transmittance, opacity, work, sums)
    add_chroma(p, sums, rect)


@line_kernel(fastmath=FAST)
def _dim_lines(p: Planes, rect, hole, transmittance, opacity, work, sums):
    lines, scratch = work
    whole, shares, roots, coded, bias = lines[0], lines[1], lines[2], lines[3], lines[4]
    biased = bias[0] != 0 or bias[1] != 0 or bias[2] != 0
    (x0, y0, x1, _), channels, one = rect, transmittance.shape[2], np.float32(1)
    power, toe = p.encoding[4], p.encoding[6]
    for j in range(transmittance.shape[0]):
        row, given = y0 + j, transmittance[j].reshape(-1)
        first, last = _span(given, whole, 0, (x1 - x0) * channels)
        first, last = first // channels, -(-last // channels)
        h0 = h1 = last
        if hole[1] <= row < hole[3]:
            h0 = min(max(hole[0] - x0, first), last)
            h1 = min(max(hole[2] - x0, first), last)
        for a, b in ((first, h0), (h1, last)):
            if a >= b:
                continue
            t, k = given[a * channels : b * channels], shares[: 3 * (b - a)]
            m, c = roots[: 3 * (b - a)], coded[: 3 * (b - a)]
            coded_line(p, row, x0 + a, scratch, c)
            for i in range(t.shape[0]):
                k[i] = max(one + opacity * (t[i] - one), np.float32(0))
            if not biased:
                for i in range(t.shape[0]):
                    m[i] = power_of(k[i], power)
            if channels == 1:
                _spread(k)
                _spread(m)
            if biased:
                for i in range(c.shape[0]):
                    m[i] = bias[i] + k[i] * (curved(c[i], p.decoding) - bias[i])
                for i in range(c.shape[0]):
                    c[i] = limited(c[i], curved(m[i], p.encoding))
            else:
                for i in range(c.shape[0]):
                    v = abs(c[i])
                    above, below = m[i] * (v + toe) - toe, k[i] * v
                    new = max(above, below) if k[i] <= one else min(above, below)
                    c[i] = limited(c[i], new if c[i] >= 0 else -new)
            add_to_line(p, row, x0 + a, c, scratch, sums, rect)


@line_kernel(fastmath=FAST)
def _spread(line):
    """The first third of the values, each three times in place of all."""
    for k in range(line.shape[0] // 3 - 1, -1, -1):
        line[3 * k] = line[3 * k + 1] = line[3 * k + 2] = line[k]


@lru_cache(maxsize=8)
def _constants(f: FrameFormat) -> tuple[Any, ...]:
    """All of `Planes` but the planes."""
    layout = f.layout
    luma, chroma = ((zero, 1 / n, n, *legal) for zero, n, *legal in f.stored)
    from_rgb = yuv_from_rgb(f.matrix)
    to_rgb = np.linalg.inv(from_rgb)
    if layout.kind == "rgb":  # as green, blue, red
        from_rgb, chroma = np.eye(3)[[1, 2, 0]], luma
        to_rgb = from_rgb.T
    elif layout.kind == "gray":  # three times the same plane: no difference of "chroma"
        from_rgb, to_rgb = from_rgb * [[1], [0], [0]], np.ones((3, 3)) * [1, 0, 0]
    steps, weights = (layout.sub_x, layout.sub_y), []
    for step, cosited in zip(steps, f.cosited, strict=True):
        n = 1 << step
        away = np.arange(1 - n, n)
        share = (n - abs(away)) / n**2 if cosited else (away >= 0) / n
        weights.append(share.astype(np.float32))
    middle = [0 if cosited else 0.5 for cosited in f.cosited]
    rows = (to_rgb, from_rgb), (decode_curve(f.transfer), encode_curve(f.transfer))
    tuples = (middle, (luma, chroma, chroma), *rows[0], *rows[1])
    return (f.width, f.height), steps, *map(_float32, tuples), *weights


def _float32(values: Any) -> Any:
    """Nested tuples of them: the compiler knows that nobody writes to these."""
    if np.ndim(values):
        return tuple(map(_float32, values))
    return np.float32(values)


def stored(planes: list[np.ndarray], f: FrameFormat) -> Planes:
    """The planes of a picture, for the functions above."""
    y, u, v = (planes * 3)[:3]
    return Planes((y, u, v), *_constants(f))


def read_only(array: np.ndarray) -> np.ndarray:
    """A view that is not to be written: whoever made the array, it is one type to the compiler."""
    out = np.ascontiguousarray(array, np.float32).view()
    out.flags.writeable = False
    return out
