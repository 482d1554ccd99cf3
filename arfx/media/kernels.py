"""Between stored planes and linear light, over a rectangle only: compiled loops, and how
they are called.

Nothing is clipped when reading: values beyond black and white (limited range, out-of-gamut
chroma) come out below 0 and above 1."""

# mypy: disable-error-code="no-untyped-def, index, assignment"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.colour import yuv_from_rgb
from arfx.core.rect import Rect
from arfx.media.lines import (
    FAST,
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
def edit_luma(y, rect, before, after, curve, luma: Luma, step, cosited, lines):
    """Adds the luma difference to plane y in place; sets the chroma differences of each
    line, reduced to chroma columns.

    rect : x0, y0, x1, y1;  before, after : (h, w, 3) float32 linear light
    step : log2 of the chroma step across;  cosited : a chroma sample lies on the left luma
    sample and takes a tent of differences, else a box
    lines : (2, h, n) float32 Cb and Cr differences, -0.5..0.5, of the columns from x0 >> step
    on, to be set
    Beyond the rectangle the difference is zero, beyond the picture its edge goes on."""
    to_yuv, factor, low, high, picture_width = luma
    x0, y0, x1, y1 = rect
    scratch = line_scratch(5, 3 * (x1 - x0))
    b, a, base, mantissa, dy = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    low_tap, high_tap, weights = taps(step, cosited and step > 0)
    wide = np.empty((2, (lines.shape[2] << step) + high_tap - low_tap), np.float32)
    start = ((x0 >> step) << step) + low_tap  # luma column of the first tap
    lines[:] = 0
    # a line at a time from the first pixel that changes to the last, in steps of which the
    # compiler makes vector code (it does not where they stand together in one function); a
    # pixel between them that does not change has difference 0
    for j in range(y1 - y0):
        old, new = before[j].reshape(-1), after[j].reshape(-1)
        first, last = 0, old.shape[0]
        while first < last and old[first] == new[first]:
            first += 1
        while last > first and old[last - 1] == new[last - 1]:
            last -= 1
        first, last = first // 3, (last + 2) // 3
        m = last - first
        if m <= 0:
            continue
        apply_curve(old[3 * first : 3 * last], curve, base, mantissa, b)
        apply_curve(new[3 * first : 3 * last], curve, base, mantissa, a)
        clipped_differences(b[: 3 * m], a)
        wide[:] = 0
        at = x0 + first - start
        to_luma_and_chroma(a, to_yuv, dy[:m], wide[0, at : at + m], wide[1, at : at + m])
        add_steps(y[y0 + j, x0 + first : x0 + last], dy[:m], factor, low, high)
        for c in range(2):
            if x0 + first == 0:
                wide[c, :at] = wide[c, at]
            if x0 + last == picture_width:
                wide[c, at + m :] = wide[c, at + m - 1]
            reduce_line(wide[c], step, weights, lines[c, j])


@numba.njit(cache=True, nogil=True, fastmath=FAST)
def edit_chroma(plane, lines, rect, height, steps, cosited, factor, legal):
    """Adds the chroma differences that `edit_luma` left, (h, n), to one chroma plane in
    place.
    height : of the picture;  legal : lowest, highest stored value
    cosited : a sample lies on the top luma sample of its group, else in the middle
    Only samples on the grid inside the rectangle, grown to that grid, can change."""
    x0, y0, _, y1 = rect
    sx, sy = steps
    low_tap, high_tap, weights = taps(sy, cosited and sy > 0)
    total = np.empty(lines.shape[1], np.float32)
    for r in range(y0 >> sy, -(-y1 >> sy)):
        total[:] = 0
        for k in range(low_tap, high_tap):
            yy = min(max((r << sy) + k, 0), height - 1)
            if y0 <= yy < y1:
                weight, line = weights[k - low_tap], lines[yy - y0]
                for i in range(total.shape[0]):
                    total[i] += line[i] * weight
        row = plane[r, x0 >> sx : (x0 >> sx) + total.shape[0]]
        add_steps(row, total, factor, legal[0], legal[1])


def read_yuv(planes: list[np.ndarray], f: FrameFormat, r: Rect) -> np.ndarray:
    """(h, w, 3) float32 linear RGB of a coded rectangle."""
    out = np.empty((r.height, r.width, 3), np.float32)
    linear_from_yuv(
        _kernel_planes(planes, f), (r.x0, r.y0, r.x1, r.y1), decode_curve(f.transfer), out
    )
    return out


def edit_yuv(
    planes: list[np.ndarray],
    f: FrameFormat,
    r: Rect,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """As `Frame.edited`, in place and coded. before, after : `packed` float32"""
    rect, steps = (r.x0, r.y0, r.x1, r.y1), (f.layout.sub_x, f.layout.sub_y)
    to_yuv = yuv_from_rgb(f.matrix).astype(np.float32)
    luma = Luma(to_yuv, np.float32(f.luma_steps[1]), *f.legal[:2], f.width)
    columns = -(-r.x1 >> steps[0]) - (r.x0 >> steps[0])
    lines = np.empty((2, r.height, columns), np.float32)
    curve = encode_curve(f.transfer)
    edit_luma(planes[0], rect, before, after, curve, luma, steps[0], f.cosited[0], lines)
    factor = np.float32(f.chroma_steps[1])
    for plane, own in zip(planes[1:3], lines, strict=True):
        edit_chroma(plane, own, rect, f.height, steps, f.cosited[1], factor, f.legal[2:])


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
