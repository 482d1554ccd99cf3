"""Compiled: blurred layers over one another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the shadow, as the composite
has it, so what a blurred edge lets through is known."""

# mypy: disable-error-code="no-untyped-def, call-arg"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.dof.pyramid import ALIGN_PX, SHARP_PX
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.splat import OccluderPixels
from arfx.stages.dof.spread import BlurredRows, light_of_row

_FLAGS = {"contract", "nsz", "arcp"}
# State of a pixel of the result: the composite's bits; covered by something sharp alone; reached by blurred light.
UNTOUCHED, SHARP, BLURRED = np.uint8(0), np.uint8(1), np.uint8(2)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def composite_real(
    out, state, top, begin, end, shed: BlurredRows, radius, real: RealPixels, visibility
):  # pragma: no cover - compiled
    """Columns begin..end of out (rows, w, 3) = the real scene from its row `top`, blurred where light of it was spread to, there
    state (rows, w) = BLURRED. The columns of `shed` lie within begin..end."""
    image, patch, box = real
    lo, hi = shed.lo, shed.hi
    light, between = (
        np.empty(4 * out.shape[1], np.float32),
        np.empty(4 * (out.shape[1] + ALIGN_PX), np.float32),
    )
    for j in range(out.shape[0]):
        y = top + j
        light_of_row(light, y, shed, lo, hi, between)
        line, sharp, r = out[j].reshape(-1), image[y].reshape(-1), radius[y]
        whole = visibility.shape[0] == 0
        visible = r if whole else visibility[y]
        a, b = (
            (min(max(box[0], begin), end), min(max(box[2], begin), end))
            if box[1] <= y < box[3]
            else (end, end)
        )
        behind = patch[y - box[1]].reshape(-1) if a < b else sharp
        for first, last, source, left in (
            (begin, a, sharp, 0),
            (a, b, behind, box[0]),
            (b, end, sharp, 0),
        ):
            p, q = min(max(lo, first), last), min(max(hi, first), last)  # columns with light
            line[3 * first : 3 * p] = source[3 * (first - left) : 3 * (p - left)]
            _add_sharp(line, state[j], light, r, source, (p, q, left), visible, whole)
            line[3 * q : 3 * last] = source[3 * (q - left) : 3 * (last - left)]


@line_kernel(fastmath=_FLAGS)
def _add_sharp(
    out, state, light, radius, sharp, columns, visible, whole
):  # pragma: no cover - compiled
    """Where there is light (4 w,): that and what stays of sharp (3 n,), together 1; elsewhere sharp; to out (3 w,).

    columns : first, behind the last, and that at which `sharp` begins;  visible : (w,) fraction of what is sharp, unless whole"""
    first = 3 * columns[2]
    for x in range(columns[0], columns[1]):
        i, j, k, n = np.uintp(4 * x), np.uintp(3 * x), np.uintp(3 * x - first), np.uintp(x)
        w, d, e, f = (
            light[i + np.uintp(3)],
            sharp[k],
            sharp[k + np.uintp(1)],
            sharp[k + np.uintp(2)],
        )
        if not w > 0:
            out[j], out[j + np.uintp(1)], out[j + np.uintp(2)] = d, e, f
            continue
        state[n] = BLURRED
        fraction = np.float32(0)
        if radius[n] <= SHARP_PX:
            fraction = np.float32(1) if whole else visible[n]
        inverse = np.float32(1) / (w + fraction)
        a, b, c = light[i], light[i + np.uintp(1)], light[i + np.uintp(2)]
        a, b, c = (
            (a + fraction * d) * inverse,
            (b + fraction * e) * inverse,
            (c + fraction * f) * inverse,
        )
        out[j], out[j + np.uintp(1)], out[j + np.uintp(2)] = a, b, c


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def composite_occluder(
    out, state, columns, at, own: BlurredRows, occluded: BlurredRows, pixels: OccluderPixels
):  # pragma: no cover - compiled
    """Columns (begin, end) of rows of an occluder over out (rows, w, 3).

    at : the rows begin at row `first` of the layer, the layer's column 0 is `left` of out's
    own, occluded : its light and the weight of what it lets through
    state : set BLURRED where any of it is spread, else SHARP; returns whether any is set SHARP"""
    (begin, end), (first, left) = columns, at
    radius, colour, coverage, opacity = pixels
    width, any_sharp = radius.shape[1], False
    light, through = np.empty(4 * width, np.float32), np.empty(4 * width, np.float32)
    between = np.empty(4 * (width + ALIGN_PX), np.float32)
    for y in range(out.shape[0]):
        light_of_row(light, first + y, own, begin, end, between)
        light_of_row(through, first + y, occluded, begin, end, between)
        for x in range(begin, end):
            w = light[4 * x + 3]
            c = coverage[y, x] * opacity
            sharp_weight = np.float32(1) if radius[y, x] <= SHARP_PX else np.float32(0)
            if not (w > 0 or sharp_weight * c > 0):
                continue
            total = w + through[4 * x + 3] + sharp_weight
            if state[y, left + x] == UNTOUCHED:
                state[y, left + x] = SHARP
                any_sharp = True
            if w > 0:
                state[y, left + x] = BLURRED
            w += sharp_weight * c
            inverse = np.float32(1) / total
            background = max(np.float32(1) - w * inverse, np.float32(0))
            for k in range(3):
                v = light[4 * x + k]
                if sharp_weight * c > 0:
                    v += colour[y, x, k] * opacity * sharp_weight
                out[y, left + x, k] = out[y, left + x, k] * background + v * inverse
    return any_sharp


@line_kernel()
def restore(
    out, state, top, columns, any_sharp, real: RealPixels, own, at
):  # pragma: no cover - compiled
    """The composite's own bits where nothing was spread to after all. out (rows, w, 3) : its row 0 is the picture's row `top`

    columns : (begin, end) of out;  any_sharp : whether any pixel is SHARP, else those outside of `own` are right already
    own : (bh, bw, 3) of the composite, in place at = x0, y0, x1, y1 of the picture; elsewhere it is the real scene"""
    image, patch, box = real
    begin, end = columns
    for j in range(out.shape[0]):
        y = top + j
        if any_sharp:
            for x in range(begin, end):
                if state[j, x] == SHARP:
                    behind = box[0] <= x < box[2] and box[1] <= y < box[3]
                    for c in range(3):
                        out[j, x, c] = (
                            patch[y - box[1], x - box[0], c] if behind else image[y, x, c]
                        )
        if at[1] <= y < at[3]:
            for x in range(max(begin, at[0]), min(end, at[2])):
                if state[j, x] != BLURRED:
                    for c in range(3):
                        out[j, x, c] = own[y - at[1], x - at[0], c]
