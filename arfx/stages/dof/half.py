"""The level draft: blurred at half the size, over which what is sharp lies at the whole size.

A pixel of it stands for 2 x 2 of the picture, counted from the frame's corner. Averaging over them and interpolating back
blur too: the discs are made smaller by that, and those that blur less are a little too large. What the whole picture shows
beyond the half one is added as far as a pixel's light is its own. Cost: O(pixels)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.parallel import parallel_map
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.stages.dof import corrected
from arfx.stages.dof.layer import strips
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.pyramid import Pyramid
from arfx.stages.dof.surfaces import Real
from arfx.stages.half import halved


def render(
    now: Layers, facts: FrameFacts, frame: Rect, out: Rect, real: Real, grid: np.ndarray, coc: CircleOfConfusion,
    pyramid: Pyramid, params: DofParams,
) -> Pixels:  # fmt: skip
    """As `corrected.render`. grid : of the picture at half the size;  the borders of now's rectangle are even, or the frame's"""
    rect, sharp = _half(now.rect), now.written[Layer.IMAGE]
    share = np.ones((rect.height, rect.width), np.float32)
    coc = replace(coc, px_per_dioptre=coc.px_per_dioptre / 2, limit_px=coc.limit_px / 2)
    facts = facts.with_(model_box=_half(facts.model_box))
    small, rows = _half_layers(now), Rect(now.rect.x0, out.y0, now.rect.x1, out.y1)
    wanted = _half(out).pad(1).clip(rect)  # whole pixels lie between half ones
    made = corrected.render(small, facts, _half(frame), wanted, real, grid, coc, pyramid, params, share)
    changed = [part for r in made.written.rects if not (part := _double(r).clip(rows)).empty]
    around = [r.pad(1).clip(rect) for r in made.written.rects]
    blurred, before = (packed(pixels.over(rect, around)) for pixels in (made, small.written[Layer.IMAGE]))
    image = packed(sharp.over(now.rect, changed))
    result = np.empty(image.shape, np.float32)

    def lay_over(part: Rect) -> None:
        part = part.shift(-now.rect.x0, -now.rect.y0)
        _lay_over(result, image, blurred, before, share, np.array(part.to_json()))

    parallel_map(lay_over, [Rect(r.x0, r.y0 + a, r.x1, r.y0 + b) for r in changed for a, b in strips(r)])
    return Pixels(now.rect, result, sharp, written=changed)


def _half(rect: Rect) -> Rect:
    whole = rect.align(2, 2)
    return Rect(whole.x0 // 2, whole.y0 // 2, whole.x1 // 2, whole.y1 // 2)


def _double(rect: Rect) -> Rect:
    return Rect(2 * rect.x0, 2 * rect.y0, 2 * rect.x1, 2 * rect.y1)


def _half_layers(now: Layers) -> Layers:
    """The layers at half the size, of which any part is made where it is asked for."""
    rect = _half(now.rect)

    def part_of(name: Layer, made: Callable[[np.ndarray], np.ndarray], part: Rect) -> np.ndarray:
        return made(now.crop(_double(part).clip(now.rect))[name])

    how = {
        **dict.fromkeys((Layer.PLATE, Layer.IMAGE, Layer.VIRTUAL, Layer.SHADOW), halved), Layer.COVERAGE: _means,
        Layer.DEPTH: _nearest, Layer.REAL_DEPTH: lambda depth: depth[::2, ::2],
    }  # fmt: skip
    return Layers(rect, {name: Pixels(rect, rest=partial(part_of, name, made)) for name, made in how.items()})


def _means(values: np.ndarray) -> np.ndarray:
    """(h, w) to half the size."""
    values = np.pad(values, ((0, values.shape[0] % 2), (0, values.shape[1] % 2)), "edge")
    return cv2.resize(values, (values.shape[1] // 2, values.shape[0] // 2), interpolation=cv2.INTER_AREA)


def _nearest(depth: np.ndarray) -> np.ndarray:
    """The least of 2 x 2."""
    depth = np.pad(depth, ((0, depth.shape[0] % 2), (0, depth.shape[1] % 2)), "edge")
    upper = np.minimum(depth[::2], depth[1::2])
    return np.minimum(upper[:, ::2], upper[:, 1::2])


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _lay_over(out, image, blurred, before, share, part):  # pragma: no cover - compiled
    """out = image + blurred - before - (1 - share) x (image - before), (h, w, 3), within part (4,): x0, y0, x1, y1, x0 even.

    blurred, before (ceil(h / 2), ceil(w / 2), 3), share (ceil(h / 2), ceil(w / 2)) : linear between; the image's own bits where
    blurred is before and share is 1"""
    x0, y0, x1, y1 = part
    rows, columns = share.shape
    first, last = x0 // 2, (x1 + 1) // 2
    begin, end = max(first - 1, 0), min(last + 1, columns)
    # of the row, with a value before the first and after the last: what it is now, what it was, how much of the image goes
    now, was = np.empty(3 * (columns + 2), np.float32), np.empty(3 * (columns + 2), np.float32)
    less, quarter, one = np.empty(columns + 2, np.float32), np.float32(0.25), np.float32(1)
    left, right = np.empty(3 * columns, np.float32), np.empty(3 * columns, np.float32)
    for y in range(y0, y1):
        j = (y + 1) // 2 - 1
        t = np.float32(0.25) if y % 2 else np.float32(0.75)
        a, b = max(j, 0), min(j + 1, rows - 1)
        top, bottom, most, least = share[a], share[b], np.float32(0), one
        for i in range(begin, end):
            less[i + 1] = one - (top[i] + (bottom[i] - top[i]) * t)
            most, least = max(most, less[i + 1]), min(least, less[i + 1])
        to, sharp = out[y].reshape(-1), image[y].reshape(-1)
        if most <= 0:
            to[3 * x0 : 3 * x1] = sharp[3 * x0 : 3 * x1]
            continue
        c, d, e, f = blurred[a].reshape(-1), blurred[b].reshape(-1), before[a].reshape(-1), before[b].reshape(-1)
        for n in range(3 * begin, 3 * end):
            now[n + 3] = c[n] + (d[n] - c[n]) * t
        if least < one:
            for n in range(3 * begin, 3 * end):
                was[n + 3] = e[n] + (f[n] - e[n]) * t
        if begin == 0:
            less[0], now[:3], was[:3] = less[1], now[3:6], was[3:6]
        if end == columns:
            n, less[columns + 1] = 3 * columns, less[columns]
            now[n + 3 : n + 6], was[n + 3 : n + 6] = now[n : n + 3], was[n : n + 3]
        i = first
        while i < last:
            run, i = i, last if least >= one else i  # as far as nothing of the image is left
            while i < last and min(less[i], min(less[i + 1], less[i + 2])) >= one:
                i += 1
            if i > run:
                _between(now, 3 * run, 3 * i, left, right)
                pairs = min(i, x1 // 2)
                _interleave(to[6 * run : 6 * pairs], left[3 * run : 3 * pairs], right[3 * run : 3 * pairs])
                if pairs < i:  # the last column of an odd number
                    to[6 * pairs : 6 * pairs + 3] = left[3 * pairs : 3 * pairs + 3]
                continue
            for side in range(min(2, x1 - 2 * i)):
                k = i + 2 * side  # of the neighbour, in `less`
                s = less[i + 1] + (less[k] - less[i + 1]) * quarter
                for ch in range(3):
                    n, m, x = 3 * (i + 1) + ch, 3 * k + ch, 3 * (2 * i + side) + ch
                    old = was[n] + (was[m] - was[n]) * quarter
                    new = now[n] + (now[m] - now[n]) * quarter
                    to[x] = sharp[x] + (new - old) - s * (sharp[x] - old)
            i += 1


@line_kernel(fastmath={"contract", "nsz", "arcp"})
def _between(line, begin, end, left, right):  # pragma: no cover - compiled
    """Values begin..end of left and right: a quarter of the way from those of line, which has three more before it, to the next
    on that side."""
    here, before, after = line[begin + 3 : end + 3], line[begin:end], line[begin + 6 : end + 6]
    a, b = left[begin:end], right[begin:end]
    for n in range(len(a)):
        a[n] = here[n] + (before[n] - here[n]) * np.float32(0.25)
    for n in range(len(b)):
        b[n] = here[n] + (after[n] - here[n]) * np.float32(0.25)


@line_kernel()
def _interleave(out, left, right):  # pragma: no cover - compiled
    """out : left's first pixel, right's first, left's second, ..."""
    for k in range(len(left) // 3):
        n, x = np.uintp(3 * k), np.uintp(6 * k)
        n1, n2 = n + np.uintp(1), n + np.uintp(2)
        out[x], out[x + np.uintp(1)], out[x + np.uintp(2)] = left[n], left[n1], left[n2]
        out[x + np.uintp(3)], out[x + np.uintp(4)], out[x + np.uintp(5)] = right[n], right[n1], right[n2]
