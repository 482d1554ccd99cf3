"""Compiled: what comes down from the ladder, layers over one another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the shadow, as the composite
has it, so what a blurred edge lets through is known.
"""

# mypy: disable-error-code="no-untyped-def, call-arg"
from __future__ import annotations

import numba
import numpy as np

from arfx.stages.dof.ladder import ALIGN_PX, SHARP_PX
from arfx.stages.dof.spread import light_of_row
from arfx.stages.four import put_four

_FLAGS = {"contract", "nsz", "arcp"}
# State of a pixel of the result: the composite's bits; something sharp laid there; light spread there.
SHARP_BITS = int(np.float32(SHARP_PX).view(np.int32))
KEPT, TRIED, LAID = np.uint8(0), np.uint8(1), np.uint8(2)


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _all_blurred(light, radius, y, lo, hi):  # pragma: no cover - compiled
    """Whether every pixel of row y, columns lo..hi, has a blur circle and got light."""
    bits, faintest = radius[y, lo:hi].view(np.int32), np.float32(np.inf)
    least = np.int32(0x7F800000)
    for x in range(len(bits)):  # of floats >= 0, ordered as their values are
        least = min(least, bits[x])
    for x in range(lo, hi):
        faintest = min(faintest, light[4 * x + 3])
    return hi > lo and faintest > 0 and least > SHARP_BITS


@numba.njit(cache=True, nogil=True)
def _copy(colours, out):  # pragma: no cover - compiled
    """out (n, 3) = colours: said with slices, numba would compile a message about shapes for seconds."""
    for x in range(len(colours)):
        for c in range(3):
            out[x, c] = colours[x, c]


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def lay_real(
    out, state, image, top, begin, end, values, table, lead_y, lead_x, lo, hi, radius, patch, box, kept
):  # fmt: skip  # pragma: no cover - compiled
    """Columns begin..end of out (rows, w, 3) = the real scene blurred where light of it was spread to, there state (rows, w)
    = LAID; else the composite's own bits, image (h, w, 3) from its row `top`. lo..hi lies within begin..end.

    values … hi : of `Spread.rows`;  patch, box : the real scene in place of image, as `deposit_real`
    """
    whole = kept.shape[0] == 0
    light, between = np.empty(4 * out.shape[1], np.float32), np.empty(4 * (out.shape[1] + ALIGN_PX), np.float32)
    for j in range(out.shape[0]):
        y = top + j
        light_of_row(light, y, values, table, lead_y, lead_x, lo, hi, between)
        from_x, until_x = (box[0], box[2]) if box[1] <= y < box[3] else (0, 0)  # columns of the patch
        _copy(image[y, begin:lo], out[j, begin:lo])
        _copy(image[y, hi:end], out[j, hi:end])
        if _all_blurred(light, radius, y, lo, hi):
            state[j, lo:hi] = LAID
            flat = out[j].reshape(-1)
            for x in range(lo, hi - 1):
                r, g, b, w = light[4 * x], light[4 * x + 1], light[4 * x + 2], light[4 * x + 3]
                inverse = np.float32(1) / w
                put_four(flat, 3 * x, r * inverse, g * inverse, b * inverse, w * inverse)
            inverse = np.float32(1) / light[4 * hi - 1]
            for c in range(3):
                flat[3 * (hi - 1) + c] = light[4 * (hi - 1) + c] * inverse
            continue
        for x in range(lo, hi):
            w = light[4 * x + 3]
            if not w > 0:
                out[j, x, 0], out[j, x, 1], out[j, x, 2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
                continue
            state[j, x] = LAID
            if radius[y, x] > SHARP_PX:
                inverse = np.float32(1) / w
                for c in range(3):
                    out[j, x, c] = light[4 * x + c] * inverse
            else:
                share = np.float32(1) if whole else kept[y, x]
                inverse = np.float32(1) / (w + share)
                for c in range(3):
                    own = patch[y - box[1], x - from_x, c] if from_x <= x < until_x else image[y, x, c]
                    out[j, x, c] = (light[4 * x + c] + share * own) * inverse


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _any_sharp(light, radius, coverage, y, begin, end):  # pragma: no cover - compiled
    """Whether a pixel of row y without a blur circle is covered, or gets light."""
    circles, least = radius[y, begin:end], np.float32(np.inf)
    for x in range(len(circles)):
        least = min(least, circles[x])
    if least > SHARP_PX:
        return False
    covered, shone = coverage[y, begin:end], light[4 * begin : 4 * end]
    found = False
    for x in range(len(circles)):
        found |= (circles[x] <= SHARP_PX) & ((shone[np.uintp(4 * x + 3)] > 0) | (covered[x] > 0))
    return found


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS, error_model="numpy")
def _lay_blurred(flat, left, light, gap, begin, end, factors):  # pragma: no cover - compiled
    """Light of columns begin..end over a row of out, flat (3 w,), of which column begin is `left`. factors : (2, w) scratch"""
    inverse, through = factors[0, : end - begin], factors[1, : end - begin]
    own, let = light[4 * begin : 4 * end], gap[4 * begin : 4 * end]
    to = flat[3 * left : 3 * (left + end - begin)]
    one, zero = np.float32(1), np.float32(0)
    for i in range(len(inverse)):
        w = own[np.uintp(4 * i + 3)]
        share = one / (w + let[np.uintp(4 * i + 3)])
        inverse[i] = share if w > 0 else zero
        through[i] = max(one - w * share, zero) if w > 0 else one
    for i in range(len(inverse)):
        for c in range(3):
            at, of = np.uintp(3 * i + c), np.uintp(4 * i + c)
            to[at] = to[at] * through[i] + own[of] * inverse[i]


@numba.njit(cache=True, nogil=True)
def _uncover(line, state, begin, end, patch, from_x, until_x):  # pragma: no cover - compiled
    """Columns begin..end of a row of out that are KEPT, where from_x..until_x holds a patch (n, 3): set to that."""
    first, last = max(begin, from_x), min(end, until_x)
    if first >= last:
        return
    found = np.uint8(0)
    for x in range(first, last):
        found |= state[x]
    if found == KEPT:
        _copy(patch[first - from_x : last - from_x], line[first:last])
        return
    for x in range(first, last):
        if state[x] == KEPT:
            for c in range(3):
                line[x, c] = patch[x - from_x, c]


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def lay_cut(
    out, state, top, begin, end, left, first, values, table, lead_y, lead_x,
    gap_values, gap_table, gap_lead_y, gap_lead_x, radius, colour, coverage, opacity, image, patch, box,
):  # fmt: skip  # pragma: no cover - compiled
    """Put columns begin..end of a cut-out layer over out (rows, w, 3); its column 0 is `left` of out's.

    first : row of the layer that is out's first;  values … lead_x, gap_values … : of its light and its gap, `Spread.rows`
    state : set LAID where any of it is spread, else TRIED; returns whether any is set TRIED
    image, patch, box : the real scene, from row `top`, for pixels that hold the composite's bits as yet
    colour is looked at where something covers.
    """
    width, tried = radius.shape[1], False
    light, gap = np.empty(4 * width, np.float32), np.empty(4 * width, np.float32)
    between, factors = np.empty(4 * (width + ALIGN_PX), np.float32), np.empty((2, width), np.float32)
    for y in range(out.shape[0]):
        light_of_row(light, first + y, values, table, lead_y, lead_x, begin, end, between)
        light_of_row(gap, first + y, gap_values, gap_table, gap_lead_y, gap_lead_x, begin, end, between)
        from_x, until_x = (box[0], box[2]) if box[1] <= top + y < box[3] else (0, 0)  # columns of the patch
        if not _any_sharp(light, radius, coverage, y, begin, end):
            x = begin
            while x < end:
                first_x = x
                while x < end and light[4 * x + 3] > 0:
                    x += 1
                a, b = left + first_x, left + x
                if x > first_x:
                    _uncover(out[y], state[y], a, b, patch[top + y - box[1]] if until_x > from_x else out[y], from_x, until_x)
                    state[y, a:b] = LAID
                x += 1
            _lay_blurred(out[y].reshape(-1), left + begin, light, gap, begin, end, factors)
            continue
        for x in range(begin, end):
            w = light[4 * x + 3]
            c = coverage[y, x] * opacity
            sharp = radius[y, x] <= SHARP_PX
            if not (w > 0 or (sharp and c > 0)):
                continue
            own = np.float32(1) if sharp else np.float32(0)
            total = w + gap[4 * x + 3] + own
            if state[y, left + x] == KEPT:
                i = left + x
                for k in range(3):
                    out[y, i, k] = patch[top + y - box[1], i - from_x, k] if from_x <= i < until_x else image[top + y, i, k]
                state[y, left + x] = TRIED
                tried = True
            if w > 0:
                state[y, left + x] = LAID
            w += own * c
            inverse = np.float32(1) / total
            through = max(np.float32(1) - w * inverse, np.float32(0))
            for k in range(3):
                v = light[4 * x + k]
                if own * c > 0:
                    v += colour[y, x, k] * opacity
                out[y, left + x, k] = out[y, left + x, k] * through + v * inverse
    return tried


@numba.njit(cache=True, nogil=True)
def restore(out, state, image, top, begin, end):  # pragma: no cover - compiled
    """The composite's own bits where nothing was spread to after all. out (rows, w, 3), image (h, w, 3) from row `top`"""
    for j in range(out.shape[0]):
        for x in range(begin, end):
            if state[j, x] == TRIED:
                for c in range(3):
                    out[j, x, c] = image[top + j, x, c]
