"""Between stored planes and linear light, over a rectangle only: compiled loops, and how
they are called.

Nothing is clipped when reading: values beyond black and white (limited range, out-of-gamut
chroma) come out below 0 and above 1."""

# mypy: disable-error-code="no-untyped-def, index, assignment"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.colour import yuv_from_rgb
from arfx.core.compiled import FAST, line_kernel
from arfx.core.rect import Rect
from arfx.media.dimming import dim_luma
from arfx.media.lines import (
    Chroma,
    Luma,
    Planes,
    add_steps,
    apply_curve,
    chroma_span,
    clipped_differences,
    coded_line,
    decode_curve,
    encode_curve,
    line_scratch,
    reduce_line,
    taps,
    to_luma_and_chroma,
)
from arfx.media.planes import FrameFormat, chroma_size


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def linear_from_yuv(planes: Planes, rect, curve, out):
    """out (h, w, 3) float32 linear RGB of coded `rect` (x0, y0, x1, y1).
    Chroma is interpolated linearly between its true positions, from samples outside the
    rectangle too."""
    scratch = line_scratch(11, rect[2] - rect[0])
    _linear_lines(planes, rect, curve, out, scratch)


@line_kernel(fastmath=FAST)
def _linear_lines(planes: Planes, rect, curve, out, scratch):
    # a line at a time in steps without branches, of which the compiler makes vector code
    x0, y0, x1, y1 = rect
    w, (c0, c1) = x1 - x0, chroma_span(x0, x1, planes.steps[0], planes.chroma_size[0])
    coded, light = scratch[:3], scratch[3:6]
    samples, cb, cr, base, mantissa = (
        scratch[6, : c1 - c0],
        scratch[7, :w],
        scratch[8, :w],
        scratch[9],
        scratch[10],
    )
    for j in range(y1 - y0):
        coded_line(planes, y0 + j, x0, samples, cb, cr, coded)
        for c in range(3):
            apply_curve(coded[c, :w], curve, base, mantissa, light[c])
        for k in range(w):
            out[j, k, 0], out[j, k, 1], out[j, k, 2] = light[0, k], light[1, k], light[2, k]


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def linear_at_yuv(planes: Planes, pixels, curve, out):
    """out (n, 3) = linear_from_yuv of single pixels (n, 2), x and y, coded."""
    y, u, v, (sx, sy), cosited, (cw, ch), (yo, yf, co, cf), (rv, gu, gv, bu) = planes
    zero = np.float32(0)
    coded = np.empty((3, len(pixels)), np.float32)
    for k in range(len(pixels)):
        x, row = pixels[k, 0], pixels[k, 1]
        p = (
            np.float32(x / (1 << sx))
            if cosited[0]
            else np.float32((x + 0.5) / (1 << sx) - 0.5)
        )
        q = (
            np.float32(row / (1 << sy))
            if cosited[1]
            else np.float32((row + 0.5) / (1 << sy) - 0.5)
        )
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
        coded[0, k], coded[1, k], coded[2, k] = (
            luma + rv * cr,
            luma - gu * cb - gv * cr,
            luma + bu * cb,
        )
    light, base, mantissa = (
        np.empty_like(coded[0]),
        np.empty_like(coded[0]),
        np.empty_like(coded[0]),
    )
    for c in range(3):
        apply_curve(coded[c], curve, base, mantissa, light)
        for k in range(len(light)):
            out[k, c] = light[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def _all_finite(before, after):
    """Whether all float32 with these bits are finite: none has all bits of its exponent set."""
    infinite, highest = np.int32(0x7F800000), np.int32(0)
    for k in range(before.shape[0]):
        highest = max(highest, max(before[k] & infinite, after[k] & infinite))
    return highest < infinite


@numba.njit(cache=True, nogil=True)
def _zero_nonfinite(before, after, clean_before, clean_after):
    """Copies both lines with 0 for pixels that have a value that is not finite; returns how
    many.
    """
    infinite, bad = np.int32(0x7F800000), 0
    for k in range(0, before.shape[0], 3):
        nonfinite = False
        for c in range(k, k + 3):
            nonfinite |= ((before[c] & infinite) == infinite) | (
                (after[c] & infinite) == infinite
            )
        bad += nonfinite
        for c in range(k, k + 3):
            clean_before[c] = np.int32(0) if nonfinite else before[c]
            clean_after[c] = np.int32(0) if nonfinite else after[c]
    return bad


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def edit_luma(
    y,
    rect,
    columns,
    before_bits,
    after_bits,
    curve,
    luma: Luma,
    step,
    cosited,
    chroma: Chroma,
):
    """Adds the luma difference to plane y in place; sets the chroma differences of each
    line, reduced to chroma columns.

    rect : x0, y0, x1, y1;  columns : (h, 2), outside of which nothing is looked at, from x0
    *_bits : (h, w, 3) float32 linear light as int32;  step : log2 of the chroma step across
    cosited : a chroma sample lies on the left luma sample and takes a tent of differences,
    else a box
    chroma : of the columns from x0 >> step on
    Beyond the rectangle the difference is zero, beyond the picture its edge goes on.
    Returns how many pixels of `after` or `before` are not finite; those are left alone."""
    w = rect[2] - rect[0]
    scratch, clean = line_scratch(5, 3 * w), np.empty((2, 3 * w), np.int32)
    tapped = taps(step, cosited and step > 0)
    wide = np.empty(
        (2, (chroma.lines.shape[2] << step) + tapped[1] - tapped[0]), np.float32
    )
    work = tapped, wide, scratch, clean
    return _edit_lines(
        y, rect, columns, before_bits, after_bits, curve, luma, step, chroma, work
    )


@line_kernel(fastmath=FAST)
def _edit_lines(
    y, rect, columns, before_bits, after_bits, curve, luma: Luma, step, chroma: Chroma, work
):
    (low_tap, high_tap, weights), wide, scratch, clean = work
    to_yuv, factor, low, high, picture_width = luma
    lines, changed_columns = chroma
    x0, y0, _, y1 = rect
    h, n = y1 - y0, lines.shape[2]
    bad = 0
    before, after, base, mantissa, dy = (
        scratch[0],
        scratch[1],
        scratch[2],
        scratch[3],
        scratch[4],
    )
    start = ((x0 >> step) << step) + low_tap  # luma column of the first tap
    # a line at a time from the first pixel that changes to the last, in steps of which the
    # compiler makes vector code (it does not where they stand together in one function); a
    # pixel between them that does not change has difference 0
    for j in range(h):
        b, a = before_bits[j].reshape(-1), after_bits[j].reshape(-1)
        first, last = 3 * columns[j, 0], 3 * columns[j, 1]
        if not _all_finite(b[first:last], a[first:last]):
            bad += _zero_nonfinite(
                b[first:last], a[first:last], clean[0, first:last], clean[1, first:last]
            )
            b, a = clean[0], clean[1]
        while first < last and b[first] == a[first]:
            first += 1
        while last > first and b[last - 1] == a[last - 1]:
            last -= 1
        first, last = first // 3, (last + 2) // 3
        changed_columns[j, 0], changed_columns[j, 1] = 0, 0
        m = last - first
        if m <= 0:
            continue
        apply_curve(b[3 * first : 3 * last].view(np.float32), curve, base, mantissa, before)
        apply_curve(a[3 * first : 3 * last].view(np.float32), curve, base, mantissa, after)
        clipped_differences(before[: 3 * m], after)
        wide[:] = 0
        at = x0 + first - start
        to_luma_and_chroma(
            after, to_yuv, dy[:m], wide[0, at : at + m], wide[1, at : at + m]
        )
        add_steps(y[y0 + j, x0 + first : x0 + last], dy[:m], factor, low, high)
        c0 = max(((x0 + first - high_tap + 1) >> step) - (x0 >> step), 0)
        c1 = min(((x0 + last - 1 - low_tap) >> step) + 1 - (x0 >> step), n)
        changed_columns[j, 0], changed_columns[j, 1] = c0, c1
        for c in range(2):
            if x0 + first == 0:
                wide[c, :at] = wide[c, at]
            if x0 + last == picture_width:
                wide[c, at + m :] = wide[c, at + m - 1]
            reduce_line(wide[c, c0 << step :], step, weights, lines[c, j, c0:c1])
    return bad


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def edit_chroma(plane, lines, changed_columns, rect, height, steps, cosited, factor, legal):
    """Adds the chroma differences that `edit_luma` left, (h, n) in their changed columns,
    to one chroma plane in place.
    height : of the picture;  legal : lowest, highest stored value
    cosited : a sample lies on the top luma sample of its group, else in the middle
    Only samples on the grid inside the rectangle, grown to that grid, can change."""
    total = np.empty(lines.shape[1], np.float32)
    tapped = taps(steps[1], cosited and steps[1] > 0)
    _edit_chroma_lines(
        plane, lines, changed_columns, rect, height, steps, factor, legal, tapped, total
    )


@line_kernel(fastmath=FAST)
def _edit_chroma_lines(
    plane, lines, changed_columns, rect, height, steps, factor, legal, tapped, total
):
    x0, y0, _, y1 = rect
    sx, sy = steps
    ca, n = x0 >> sx, lines.shape[1]
    low_tap, high_tap, weights = tapped
    for r in range(y0 >> sy, -(-y1 >> sy)):
        a, b = n, 0
        for k in range(low_tap, high_tap):
            yy = min(max((r << sy) + k, 0), height - 1)
            if y0 <= yy < y1 and changed_columns[yy - y0, 1] > changed_columns[yy - y0, 0]:
                a, b = (
                    min(a, changed_columns[yy - y0, 0]),
                    max(b, changed_columns[yy - y0, 1]),
                )
        if b <= a:
            continue
        total[a:b] = 0
        for k in range(low_tap, high_tap):
            yy = min(max((r << sy) + k, 0), height - 1)
            if y0 <= yy < y1:
                from_, to = changed_columns[yy - y0, 0], changed_columns[yy - y0, 1]
                weight, line = weights[k - low_tap], lines[yy - y0]
                for i in range(from_, to):
                    total[i] += line[i] * weight
        add_steps(plane[r, ca + a : ca + b], total[a:b], factor, legal[0], legal[1])


def read_yuv(planes: list[np.ndarray], f: FrameFormat, r: Rect) -> np.ndarray:
    """(h, w, 3) float32 linear RGB of a coded rectangle."""
    out = np.empty((r.height, r.width, 3), np.float32)
    linear_from_yuv(
        _kernel_planes(planes, f), (r.x0, r.y0, r.x1, r.y1), decode_curve(f.transfer), out
    )
    return out


def read_yuv_at(planes: list[np.ndarray], f: FrameFormat, pixels: np.ndarray) -> np.ndarray:
    """(n, 3) float32 linear RGB of coded pixels (n, 2), x and y."""
    out = np.empty((len(pixels), 3), np.float32)
    linear_at_yuv(
        _kernel_planes(planes, f),
        np.ascontiguousarray(pixels, np.int32),
        decode_curve(f.transfer),
        out,
    )
    return out


def edit_yuv(
    planes: list[np.ndarray],
    f: FrameFormat,
    r: Rect,
    columns: np.ndarray | None,
    before: np.ndarray,
    after: np.ndarray,
) -> int:
    """As `Frame.edited`, in place and coded. Returns how many pixels are not finite."""
    whole = (
        np.tile(np.array([0, r.width], np.int32), (r.height, 1))
        if columns is None
        else columns
    )
    chroma = _chroma(r, f)
    bad = edit_luma(
        planes[0],
        (r.x0, r.y0, r.x1, r.y1),
        _bits(whole),
        _bits(before),
        _bits(after),
        encode_curve(f.transfer),
        _luma(f),
        f.layout.sub_x,
        f.cosited[0],
        chroma,
    )
    _edit_chroma(planes, f, r, chroma)
    return int(bad)


def dim_yuv(
    planes: list[np.ndarray],
    f: FrameFormat,
    r: Rect,
    hole: Rect,
    transmittance: np.ndarray,
    opacity: float,
    bias: np.ndarray,
) -> None:
    """As `Frame.dimmed`, in place and coded."""
    _, _, alpha, power = f.transfer.curve
    curves = (
        decode_curve(f.transfer),
        encode_curve(f.transfer),
        np.array([1 / power, alpha - 1], np.float32),
    )
    chroma = _chroma(r, f)
    dim_luma(
        _kernel_planes(planes, f),
        (r.x0, r.y0, r.x1, r.y1),
        (hole.x0, hole.y0, hole.x1, hole.y1),
        _read_only(transmittance),
        np.float32(opacity),
        bias.astype(np.float32),
        curves,
        _luma(f),
        chroma,
    )
    _edit_chroma(planes, f, r, chroma)


def _kernel_planes(planes: list[np.ndarray], f: FrameFormat) -> Planes:
    to_rgb, (yo, yn), (co, cn) = (
        np.linalg.inv(yuv_from_rgb(f.matrix)),
        f.luma_steps,
        f.chroma_steps,
    )
    scale = np.float32(yo), np.float32(1 / yn), np.float32(co), np.float32(1 / cn)
    matrix = (
        np.float32(to_rgb[0, 2]),
        np.float32(-to_rgb[1, 1]),
        np.float32(-to_rgb[1, 2]),
        np.float32(to_rgb[2, 1]),
    )
    y, u, v = planes[:3]
    return Planes(
        y,
        u,
        v,
        (f.layout.sub_x, f.layout.sub_y),
        f.cosited,
        chroma_size(f.layout, f.width, f.height),
        scale,
        matrix,
    )


def _luma(f: FrameFormat) -> Luma:
    return Luma(
        yuv_from_rgb(f.matrix).astype(np.float32),
        np.float32(f.luma_steps[1]),
        *f.legal[:2],
        f.width,
    )


def _chroma(r: Rect, f: FrameFormat) -> Chroma:
    columns = -(-r.x1 >> f.layout.sub_x) - (r.x0 >> f.layout.sub_x)
    return Chroma(
        np.empty((2, r.height, columns), np.float32), np.empty((r.height, 2), np.int32)
    )


def _edit_chroma(planes: list[np.ndarray], f: FrameFormat, r: Rect, chroma: Chroma) -> None:
    rect, steps = (r.x0, r.y0, r.x1, r.y1), (f.layout.sub_x, f.layout.sub_y)
    for plane, lines in zip(planes[1:3], chroma.lines, strict=True):
        edit_chroma(
            plane,
            lines,
            chroma.changed_columns,
            rect,
            f.height,
            steps,
            f.cosited[1],
            np.float32(f.chroma_steps[1]),
            f.legal[2:],
        )


def _bits(array: np.ndarray) -> np.ndarray:
    """A contiguous array of 32 bits as int32, not to be written."""
    return _read_only(array.view(np.int32))


def _read_only(array: np.ndarray) -> np.ndarray:
    """A view that is not to be written: whoever made the array, it is one type to the compiler."""
    out = array.view()
    out.flags.writeable = False
    return out
