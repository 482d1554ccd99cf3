"""Colour of the cells: exact means in linear light, washes that join alike neighbours, tone.

A wash is what a painter lays on in one go: neighbouring cells of nearly one colour. Their colours are drawn together over
the graph of neighbours, with a weight that falls with their difference, so that cells vanish in even areas and stay where
the picture changes. Cost: O(pixels) once for the means, O(cells) after. Source: docs/methods/watercolor.md#cells."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numba
import numpy as np

from arfx.core.layers import packed
from arfx.core.parallel import parallel_rows
from arfx.stages.four import add_four
from arfx.stages.watercolor.label_kernels import Buckets
from arfx.stages.watercolor.labels import Labels, bucket_sites
from arfx.stages.watercolor.rows import (
    Cells,
    Picture,
    combine_labels,
    read_labels,
    read_pixels,
    union_span,
)
from arfx.stages.watercolor.sites import STEPS

NEIGHBOURS = 8  # stored of a cell; a Voronoi cell has 6 on average
REACH = 1.4  # sizes of a cell: sites that far apart have nothing to do with each other
_STEP = 16  # sites in `neighbours`
_MANY = 8  # below this many pixels per cell, sums over bands would cost more than they save
_FAST = {"contract", "nsz", "arcp"}
_U = np.uint64  # an index of that type is not looked at for a minus: loops stay simple


def means(image: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32 mean linear RGB of each cell, black for cells without a pixel. Sums are float64.

    image : (h, w, 3) float32;  labels : (h, w) int32, 0 ... count - 1"""
    whole = Labels(labels, np.zeros((0, 0), np.int32), np.zeros((0, 0), np.uint8), count)
    return cell_colours(Picture(packed(image)), combine_labels(whole))[:, :3]


def cell_colours(picture: Picture, cells: Cells) -> np.ndarray:
    """(count, 4) float32: means as above, and the number of pixels."""
    (h, w), count = picture.image.shape[:2], cells.cell_count

    def one(y0: int, y1: int) -> np.ndarray:
        total = np.zeros((count, 4))
        _sum_rows(picture, cells, y0, y1, total)
        return total

    first, *others = [one(0, h)] if count * _MANY > h * w else parallel_rows(one, h, 2)
    for more in others:
        first += more
    return _divided(first)


def mean_colours(each: Sequence[np.ndarray]) -> np.ndarray:
    """`cell_colours` of cells whose pixels were counted at several places: mean of all, mean number."""
    if len(each) == 1:
        return each[0]
    total = np.sum(
        [np.column_stack([c[:, :3] * c[:, 3:], c[:, 3:]]) for c in each], axis=0, dtype=float
    )
    return np.asarray(_divided(total) / np.array([1, 1, 1, len(each)], np.float32))


@numba.njit(cache=True, nogil=True)
def _divided(total):  # pragma: no cover - compiled
    """(count, 4) float32: means and number, of sums and number."""
    out = np.empty(total.shape, np.float32)
    for k in range(total.shape[0]):
        n = max(total[k, 3], 1.0)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = (
            total[k, 0] / n,
            total[k, 1] / n,
            total[k, 2] / n,
            total[k, 3],
        )
    return out


@numba.njit(cache=True, nogil=True)
def _sum_rows(picture: Picture, cells: Cells, y0, y1, total):  # pragma: no cover - compiled
    """total (count, 4) : sums of red, green, blue, pixels over rows y0 ... y1 - 1. Where the object may lie rows are put
    together in buffers."""
    image, patch, py, px = picture
    first, mask, ly, lx = cells.first, cells.mask, cells.y, cells.x
    w = first.shape[1]
    left, right = union_span(px, patch.shape[1], lx, mask.shape[1])
    buffer, numbers, sums = np.empty(3 * w, np.float32), np.empty(w, np.int32), total.reshape(-1)
    for y in range(y0, y1):
        line, a = image[y].reshape(-1), first[y]
        if py <= y < py + patch.shape[0] or ly <= y < ly + mask.shape[0]:
            read_pixels(picture, y, left, right, buffer)
            read_labels(cells, y, left, right, numbers)
            _add(line[: 3 * left], a[:left], sums)
            _add(buffer[3 * left : 3 * right], numbers[left:right], sums)
            _add(line[3 * right :], a[right:], sums)
        else:
            _add(line, a, sums)


@numba.njit(cache=True, nogil=True)
def _add(line, a, sums):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        i = _U(3) * _U(x)
        add_four(sums, a[x], line[i], line[i + _U(1)], line[i + _U(2)], np.float32(1))


def neighbours(x: np.ndarray, y: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(near (n, NEIGHBOURS) int32 sites around each, the nearest, itself behind the last; weight (n, NEIGHBOURS) float32
    0..1).

    x, y, size (n,) float32 : sites and the sizes of cells there, 1/STEPS px. What counts is how far apart sites are, never the
    pixels that their cells share: a border of a pixel or two comes and goes as the picture moves, and washes would with it."""
    n = len(x)
    near, weight = np.zeros((n, NEIGHBOURS), np.int32), np.zeros((n, NEIGHBOURS), np.float32)
    if n < 2:
        return near, weight
    left, right, top, bottom = float(x.min()), float(x.max()), float(y.min()), float(y.max())
    side = max(
        REACH * np.sqrt((right - left) * (bottom - top) / n),
        (right - left) / 8192,
        (bottom - top) / 8192,
        float(STEPS),
    )
    gw, gh = int((right - left) // side) + 1, int((bottom - top) // side) + 1
    start, order = bucket_sites(x, y, left / STEPS, top / STEPS, side / STEPS, gh, gw)
    position = np.zeros((3, n + _STEP), np.float32)
    position[0, :n], position[1, :n], position[2, :n] = (
        x[order],
        y[order],
        np.float32(1 / REACH**2) / (size[order] ** 2),
    )
    buckets = Buckets(position, order, start, side, gh, gw)
    parallel_rows(lambda a, b: _find_neighbours(buckets, left, top, a, b, near, weight), n)
    return near, weight


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _find_neighbours(
    buckets: Buckets, left, top, a, b, near, weight
):  # pragma: no cover - compiled
    """Of the sites a ... b - 1 of the buckets' order; their position (3, n) : x, y, 1 / reach^2"""
    position, order, start, side, gh, gw = buckets
    one, capacity = np.float32(1), start[gh * gw] + 2 * _STEP
    s, found = np.empty(capacity, np.float32), np.empty(capacity, np.int32)
    px, py, ps = position[0], position[1], position[2]
    for k in range(a, b):
        x, y, sharp, own = px[k], py[k], ps[k], one / np.sqrt(ps[k])
        x0, x1 = (
            max(np.int64((x - own - left) / side), 0),
            min(np.int64((x + own - left) / side), gw - 1),
        )
        y0, y1 = (
            max(np.int64((y - own - top) / side), 0),
            min(np.int64((y + own - top) / side), gh - 1),
        )
        n = _U(0)
        for i in range(y0, y1 + 1):  # type: ignore[call-overload, operator]
            begin, end = start[i * gw + x0], start[i * gw + x1 + 1]
            for c in range(begin, end, _STEP):
                for q in range(
                    _STEP
                ):  # of fixed length; what is too much is overwritten by the next row
                    j, to = _U(c) + _U(q), n + _U(q)
                    ex, ey = px[j] - x, py[j] - y
                    # a pair reaches as far as the smaller of both
                    s[to], found[to] = one - (ex * ex + ey * ey) * max(ps[j], sharp), c + q
                n += _U(min(_STEP, end - c))
        within = _U(0)
        for q in range(np.int64(n)):
            v, m = s[_U(q)], found[_U(q)]
            s[within], found[within] = v, m
            within += _U(v > 0) & _U(m != k)
        site, count = order[k], np.int64(within)
        while count > NEIGHBOURS:  # without the farthest
            last = 0
            for q in range(1, count):
                last = q if s[q] < s[last] else last
            count -= 1
            s[last], found[last] = s[count], found[count]
        near[site] = site
        for q in range(count):
            near[site, q], weight[site, q] = order[found[q]], s[q] * s[q]


def smooth_washes(
    colours: np.ndarray,
    near: np.ndarray,
    weight: np.ndarray,
    area: np.ndarray,
    contrast: float,
    rounds: int,
    step: float = 1.0,
) -> np.ndarray:
    """(n, 3) float32 square roots of the colours (near to what is coded), alike neighbours drawn together.

    colours : (n, 3) linear;  near, weight : of `neighbours`;  area (n,) : pixels of the cells: one of few counts little
    contrast : difference of square roots at which the pull has fallen to a quarter
    step : how many rounds each stands for: a cell's own colour counts so much less"""
    root = np.sqrt(np.clip(colours, 0, 1)).astype(np.float32)
    if not rounds or not near.shape[1]:
        return root
    confidence = (area / (area + 0.25 * max(float(np.median(area)), 1.0))).astype(np.float32)
    sharp, own = np.float32(1 / max(contrast, 1e-3) ** 2), np.float32(1 / step)
    for _ in range(rounds):
        out = np.empty_like(root)
        parallel_rows(
            partial(_smooth_washes, root, near, weight, confidence, (sharp, own), out), len(root)
        )
        root = out
    return root


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _smooth_washes(root, near, weight, confidence, how, out, a, b):  # pragma: no cover - compiled
    """how : 1 / contrast^2, weight of a cell's own colour"""
    one, (sharp, own) = np.float32(1), how
    for k in range(a, b):
        r, g, b_ = root[k, 0], root[k, 1], root[k, 2]
        sr, sg, sb, total = own * r, own * g, own * b_, own
        for m in range(NEIGHBOURS):
            j = np.uint64(near[k, m])
            dr, dg, db = root[j, 0] - r, root[j, 1] - g, root[j, 2] - b_
            w = one / (one + (dr * dr + dg * dg + db * db) * sharp)
            w *= w * weight[k, m] * confidence[j]
            sr += w * root[j, 0]
            sg += w * root[j, 1]
            sb += w * root[j, 2]
            total += w
        out[k, 0], out[k, 1], out[k, 2] = sr / total, sg / total, sb / total


def adjust_tone(
    root: np.ndarray, lightness: float, saturation: float, deepest: float
) -> np.ndarray:
    """(n, 3) float32 square roots of colours, thinner (paper shows through) and more or less saturated.

    lightness : v becomes 1 - (1 - v)^(1 + lightness);  saturation : factor on the distance from grey
    deepest : square root that black becomes: no wash is black"""
    if (lightness, saturation, deepest) == (0, 1, 0):
        return root
    thin = deepest + (1 - deepest) * (
        1 - (1 - np.minimum(root, 1)) ** (1 + lightness)
    )  # rounding may pass 1
    grey = thin @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    out: np.ndarray = np.clip(grey[:, None] + saturation * (thin - grey[:, None]), 0, 1).astype(
        np.float32
    )
    return out
