"""Colour of the cells: exact means in linear light, washes that join alike neighbours, tone.

A wash is what a painter lays on in one go: neighbouring cells of nearly one colour. Their colours
are drawn together over the graph of neighbours, with a weight that falls with their difference, so
that cells vanish in even areas and stay where the picture changes.
Cost: O(pixels) once for the means, O(cells) after. Source: docs/methods/watercolor.md#cells.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, kernel
from arfx.core.parallel import parallel_rows
from arfx.stages.watercolor.labels import bucket_sites
from arfx.stages.watercolor.sites import STEPS

NEIGHBOURS = 8  # stored of a cell; a Voronoi cell has 6 on average
REACH = (
    1.4  # sizes of a cell: sites that far apart have nothing to do with each other
)
_MANY = (
    8  # below this many pixels a cell, sums over bands would cost more than they save
)
_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
_F = np.float32


def mean_colours(
    image: ndarray, labellings: Sequence[ndarray], count: int
) -> tuple[ndarray, ndarray]:
    """((count, 3) float32 mean linear RGB of each cell, black without a pixel; (count,) float32
    its pixels, the mean over the labellings). Sums are float64.

    image : (h, w, 3) float32;  labellings : (h, w) int32 each, 0 ... count - 1"""
    height, width = image.shape[:2]

    def sums(labels: ndarray, first: int, last: int) -> ndarray:
        total = np.zeros((count, 4))
        _sum_rows(image, labels, first, last, total)
        return total

    total, unit = (
        np.zeros((count, 4)),
        height if count * _MANY > height * width else 2,
    )
    for labels in labellings:
        for part in parallel_rows(partial(sums, labels), height, unit):
            total += part
    colour = total[:, :3] / np.maximum(total[:, 3:], 1)
    return colour.astype(np.float32), (total[:, 3] / len(labellings)).astype(
        np.float32
    )


@kernel()
def _sum_rows(image, labels, first, last, total):  # pragma: no cover - compiled
    """total (count, 4) : sums of red, green, blue, pixels over rows first ... last - 1"""
    for y in range(first, last):
        for x in range(image.shape[1]):
            k = labels[y, x]
            for c in range(3):
                total[k, c] += image[y, x, c]
            total[k, 3] += 1.0


def neighbours(x: ndarray, y: ndarray, size: ndarray) -> tuple[ndarray, ndarray]:
    """(near (n, NEIGHBOURS) int32 sites around each, the nearest, itself behind the last; weight
    (n, NEIGHBOURS) float32 0..1).

    x, y, size (n,) float32 : sites and the sizes of cells there, 1/STEPS px. What counts is how
    far apart sites are, never the pixels that their cells share: a border of a pixel or two comes
    and goes as the picture moves, and washes would with it."""
    n = len(x)
    shape = max(n, 1), NEIGHBOURS  # without a site there is one cell
    near = np.zeros(shape, np.int32)
    weight = np.zeros(shape, np.float32)
    if n < 2:
        return near, weight
    places = np.stack([x, y])
    corner, extent = places.min(1), np.ptp(places, axis=1).astype(float)
    spacing = np.sqrt(extent.prod() / n)
    side = max(REACH * spacing, extent.max() / 8192, float(STEPS))
    columns, rows = (int(along // side) + 1 for along in extent)
    left, top, side_px = (float(along) / STEPS for along in (*corner, side))
    start, order = bucket_sites((x, y), (left, top), side_px, rows, columns)
    sharp = np.float32(1 / REACH**2) / (size[order] ** 2)
    sites = np.stack([*(places - corner[:, None]).take(order, 1), sharp])
    grid = start, order, np.float32(side), rows, columns
    parallel_rows(partial(_find_neighbours, sites, grid, near, weight), n)
    return near, weight


@kernel(fastmath=FAST, error_model="numpy")
def _find_neighbours(
    sites, grid, near, weight, first, last
):  # pragma: no cover - compiled
    """Of the sites first ... last - 1 of the buckets' order.

    sites (3, n) : x, y from the first bucket's corner, 1 / reach^2, in the buckets' order
    grid : start, order of `bucket_sites`, side of a bucket, rows, columns"""
    start, order, side, rows, columns = grid
    share = np.empty(start[-1], np.float32)
    which = np.empty(start[-1], np.int32)
    for k in range(first, last):
        x = sites[0, k]
        y = sites[1, k]
        sharp = sites[2, k]
        own = _F(1) / np.sqrt(sharp)
        left = max(int((x - own) / side), 0)
        right = min(int((x + own) / side), columns - 1)
        top = max(int((y - own) / side), 0)
        bottom = min(int((y + own) / side), rows - 1)
        count = 0
        for i in range(top, bottom + 1):
            for m in range(start[i * columns + left], start[i * columns + right + 1]):
                dx = sites[0, m] - x
                dy = sites[1, m] - y
                # a pair reaches as far as the smaller of both
                value = _F(1) - (dx * dx + dy * dy) * max(sites[2, m], sharp)
                share[count] = value
                which[count] = m
                count += (value > 0) & (m != k)
        while count > NEIGHBOURS:  # without the farthest
            least = np.argmin(share[:count])
            count -= 1
            share[least] = share[count]
            which[least] = which[count]
        site = order[k]
        near[site] = site
        for m in range(count):
            near[site, m] = order[which[m]]
            weight[site, m] = share[m] * share[m]


def smooth_washes(
    colours: ndarray,
    near: ndarray,
    weight: ndarray,
    area: ndarray,
    contrast: float,
    rounds: int,
    step: float = 1.0,
) -> ndarray:
    """(n, 3) float32 square roots of the colours (near to what is coded), alike neighbours drawn
    together.

    colours : (n, 3) linear;  near, weight : of `neighbours`
    area (n,) : pixels of the cells: one of few counts little
    contrast : difference of square roots at which the pull has fallen to a quarter
    step : how many rounds each stands for: a cell's own colour counts so much less"""
    root = np.sqrt(np.clip(colours, 0, 1)).astype(np.float32)
    if not rounds:
        return root
    usual = 0.25 * max(float(np.median(area)), 1.0)
    confidence = (area / (area + usual)).astype(np.float32)
    how = np.float32(1 / max(contrast, 1e-3) ** 2), np.float32(1 / step)
    for _ in range(rounds):
        out = np.empty_like(root)
        one_round = partial(_smooth_round, root, near, weight, confidence, how, out)
        parallel_rows(one_round, len(root))
        root = out
    return root


@kernel(fastmath=FAST, error_model="numpy")
def _smooth_round(
    root, near, weight, confidence, how, out, first, last
):  # pragma: no cover - compiled
    """Cells first ... last - 1. how : 1 / contrast^2, weight of a cell's own colour"""
    one, (sharp, own) = _F(1), how
    for k in range(first, last):
        total = own
        for c in range(3):
            out[k, c] = own * root[k, c]
        for m in range(NEIGHBOURS):
            j = np.uint64(near[k, m])
            apart = _F(0)
            for c in range(3):
                step = root[j, c] - root[k, c]
                apart += step * step
            w = one / (one + apart * sharp)
            w *= w * weight[k, m] * confidence[j]
            for c in range(3):
                out[k, c] += w * root[j, c]
            total += w
        for c in range(3):
            out[k, c] /= total


def adjust_tone(
    root: ndarray, lightness: float, saturation: float, deepest: float
) -> ndarray:
    """(n, 3) float32 square roots of colours, thinner (paper shows through) and more or less
    saturated.

    lightness : v becomes 1 - (1 - v)^(1 + lightness)
    saturation : factor on the distance from grey
    deepest : square root that black becomes: no wash is black"""
    thin = 1 - (1 - np.minimum(root, 1)) ** (1 + lightness)  # rounding may pass 1
    thin = deepest + (1 - deepest) * thin
    grey = (thin @ _LUMA)[:, None]
    return np.asarray(
        np.clip(grey + saturation * (thin - grey), 0, 1).astype(np.float32)
    )
