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
    first, last, pairs = x0 // 2, (x1 + 1) // 2, x1 // 2
    begin, end = around = max(first - 1, 0), min(last + 1, columns)
    # of the row, with a value before the first and after the last: what it is now, what it was, how much of the image goes
    now, was, less = (
        np.empty(3 * columns + 6, np.float32),
        np.empty(3 * columns + 6, np.float32),
        np.empty(columns + 2, np.float32),
    )
    sides = np.empty((2, 7 * columns), np.float32)  # the same, of the left pixels of the pairs, and of the right ones
    one = np.float32(1)
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
        _pairs_of_row(blurred[a].reshape(-1), blurred[b].reshape(-1), t, around, first, last, now, sides, 0)
        if least >= one:  # nothing of the image is left
            for k in range(first, pairs):
                n, x = np.uintp(3 * k), np.uintp(6 * k)
                for c in range(3):
                    q = np.uintp(c)
                    to[x + q], to[x + np.uintp(3) + q] = sides[0, n + q], sides[1, n + q]
            if pairs < last:  # the last column of an odd number
                to[6 * pairs : 6 * pairs + 3] = sides[0, 3 * pairs : 3 * last]
            continue
        _pairs_of_row(before[a].reshape(-1), before[b].reshape(-1), t, around, first, last, was, sides, 3 * columns)
        if begin == 0:
            less[0] = less[1]
        if end == columns:
            less[columns + 1] = less[columns]
        _between(less, 1, first, last, sides, 6 * columns)
        for k in range(first, last):
            for side in range(2 if k < pairs else 1):
                n, m, x = np.uintp(3 * k), np.uintp(3 * (columns + k)), np.uintp(6 * k + 3 * side)
                s = sides[side, np.uintp(6 * columns + k)]
                for c in range(3):
                    q = np.uintp(c)
                    v, old = sharp[x + q], sides[side, m + q]
                    to[x + q] = v + (sides[side, n + q] - old) - s * (v - old)


@line_kernel(fastmath={"contract", "nsz", "arcp"})
def _pairs_of_row(upper, lower, t, around, first, last, line, sides, at):  # pragma: no cover - compiled
    """sides[:, at + ...], three values a pixel, of the pairs first..last of a row that lies t of the way from one line of half
    the size to the next. around : first and last pixel there that are looked at;  line : scratch"""
    n = len(line) - 6
    for k in range(3 * around[0], 3 * around[1]):
        line[k + 3] = upper[k] + (lower[k] - upper[k]) * t
    for k in range(3):
        if around[0] == 0:
            line[k] = line[3 + k]
        if 3 * around[1] == n:
            line[n + 3 + k] = line[n + k]
    _between(line, 3, first, last, sides, at)


@line_kernel(fastmath={"contract", "nsz", "arcp"})
def _between(line, width, first, last, sides, at):  # pragma: no cover - compiled
    """Of each pair's pixels, a quarter of the way from the value of half the size to the neighbour on that side. line : values of
    half the size, one pixel more before them"""
    here, count = line[width * (first + 1) : width * (last + 1)], width * (last - first)
    before, after = line[width * first : width * last], line[width * (first + 2) : width * (last + 2)]
    left, right = sides[0, at + width * first : at + width * last], sides[1, at + width * first : at + width * last]
    for n in range(count):
        left[n] = here[n] + (before[n] - here[n]) * np.float32(0.25)
    for n in range(count):
        right[n] = here[n] + (after[n] - here[n]) * np.float32(0.25)
