"""Nearest-site labels, exact: a tile of 16 x 16 pixels only meets sites that can win one of its
pixels.

Distance is that of a power diagram, |p - s|^2 - weight; with all weights 0 the cells are Voronoi
cells. Sites and pixels lie on a grid of 1/8 px, so that distances are integers; of equal distances
the site of the lower number wins. Pixels may be displaced (wobble) before they ask. A tile
collects the sites around it, prunes them and compares what is left (label_kernels).
Cost: O(pixels x some 20 candidates). Source: docs/methods/watercolor.md#labels; tiles in place of
cones."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.stages.watercolor.label_kernels import (
    EXACT,
    MIDDLE,
    PIXELS,
    SOLID,
    STEP,
    TILE,
    Buckets,
    Candidates,
    LocalSites,
    bound,
    collect,
    nearest,
    nearest_of_far,
    nearest_two,
    pack,
    prune,
)
from arfx.stages.watercolor.sites import STEPS, Sites

_U = np.uint64
EVERY_PIXEL = np.zeros((0, 0), bool)


@dataclass(frozen=True, eq=False)
class Labels:
    """first (h, w) int32 : the nearest site;  second (h, w) int32 : the next one, where it is near
    inside (h, w) uint8 : 0 on the border between both, SOLID from `blend_px` off it
    count : of sites;  second and inside are (0, 0) where borders were not asked for"""

    first: ndarray
    second: ndarray
    inside: ndarray
    count: int

    def overlaid(
        self, other: Labels, where: ndarray, part: tuple[slice, slice]
    ) -> Labels:
        """With those of `other`, numbered on from these, at its pixels `where`.

        other : labels of this part, rows and columns"""
        arrays = []
        for name, start in (
            ("first", self.count),
            ("second", self.count),
            ("inside", 0),
        ):
            array = getattr(self, name).copy()
            if array.size:
                np.copyto(array[part], getattr(other, name) + start, where=where)
            arrays.append(array)
        first, second, inside = arrays
        return Labels(first, second, inside, self.count + other.count)


class Wobble(NamedTuple):
    """Displacement of pixels before they ask, repeated: the same wherever tiles of labels begin.

    positions (n, n, 2, PIXELS) float32 : displaced positions of a tile's pixels, 1/STEPS px from
        the tile's middle;  boxes (n, n, 4) float32 : around these: middle, half sides
    x, y : where in it pixel (0, 0) of the frame lies, px"""

    positions: ndarray
    boxes: ndarray
    x: int = 0
    y: int = 0


def make_wobble(tile: ndarray) -> Wobble:
    """tile (2, m, m) whole numbers of 1/STEPS px, along x and y; m a multiple of TILE."""
    n = tile.shape[1] // TILE
    own = np.arange(TILE, dtype=np.float32) * STEPS - MIDDLE
    squares = tile.reshape(2, n, TILE, n, TILE).transpose(1, 3, 0, 2, 4)
    squares = squares + np.stack(np.broadcast_arrays(own, own[:, None]))
    positions = np.ascontiguousarray(squares, np.float32).reshape(n, n, 2, PIXELS)
    low, high = positions.min(-1), positions.max(-1)
    return Wobble(positions, np.concatenate([(low + high) / 2, (high - low) / 2], -1))


STILL = make_wobble(np.zeros((2, TILE, TILE)))


def _bucketed(sites: Sites, rect: Rect, wobble: Wobble) -> tuple[Buckets, int, int]:
    """Buckets of some two sites; x, y of the first tile in the rectangle, <= 0, px."""
    x, y = -((wobble.x + rect.x0) % TILE), -((wobble.y + rect.y0) % TILE)
    spacing = np.sqrt(rect.area / len(sites))
    side = int(max(1, min(round(1.5 * spacing), max(rect.width, rect.height))))
    rows, columns = -(-(rect.height - y) // side), -(-(rect.width - x) // side)
    left, top = rect.x0 + x, rect.y0 + y
    places = sites.x, sites.y
    start, order = bucket_sites(places, (left, top), side, rows, columns)
    position = np.zeros((3, len(sites) + STEP), np.float32)
    moved = sites.x - STEPS * left, sites.y - STEPS * top, sites.weight
    position[:, : len(sites)] = np.stack(moved)[:, order]
    return Buckets(position, order, start, side, rows, columns), x, y


def sort_sites(sites: Sites, rect: Rect, wobble: Wobble = STILL) -> Sites:
    """The same sites, numbered as `label` meets them."""
    if not len(sites) or rect.empty:
        return sites
    order = _bucketed(sites, rect, wobble)[0].order
    return Sites(*(getattr(sites, column.name)[order] for column in fields(sites)))


def label(
    sites: Sites,
    rect: Rect,
    wobble: Wobble = STILL,
    blend_px: float = 0.0,
    mask: ndarray = EVERY_PIXEL,
) -> Labels:
    """Labels of the pixels of `rect`.

    blend_px : as in Labels, 0 = no borders
    mask (h, w) bool : only these are asked for, the others hold anything; empty = all
    Without a site every pixel is labelled 0 and count is 1."""
    n, shape = len(sites), (rect.height, rect.width)
    of_borders = shape if blend_px > 0 else (0, 0)
    first = np.zeros(shape, np.int32)
    second = np.zeros(of_borders, np.int32)
    inside = np.full(of_borders, SOLID, np.uint8)
    if n == 0 or rect.empty:
        return Labels(first, second, inside, max(n, 1))
    buckets, x, y = _bucketed(sites, rect, wobble)
    # its tile (0, 0) is the first one in rect
    column, row = (wobble.x + rect.x0 + x) // TILE, (wobble.y + rect.y0 + y) // TILE
    moved = wobble._replace(x=column, y=row)
    blend, out = np.float32(blend_px * STEPS), (first, second, inside)

    label_rows = partial(_label_rows, buckets, moved, blend, mask, (x, y), out)
    parallel_rows(label_rows, rect.height - y, TILE)
    if (np.diff(buckets.order) < 0).any():
        first, second = buckets.order[first], buckets.order[second]
    return Labels(first, second, inside, n)


def bucket_sites(
    sites: tuple[ndarray, ndarray],
    corner: tuple[float, float],
    side: float,
    rows: int,
    columns: int,
) -> tuple[ndarray, ndarray]:
    """(start (rows columns + 1), order (n,)) : sites by bucket, in each by number.

    Sites outside count to the nearest bucket. sites : x, y, 1/STEPS px;  corner, side : px"""
    x, y = (
        np.floor((np.asarray(along, float) / STEPS - first) / side)
        for along, first in zip(sites, corner, strict=True)
    )
    bucket = np.clip(y, 0, rows - 1) * columns + np.clip(x, 0, columns - 1)
    bucket = bucket.astype(np.int32)
    ends = np.cumsum(np.bincount(bucket, minlength=rows * columns))
    start = np.concatenate([[0], ends]).astype(np.int32)
    return start, np.argsort(bucket, kind="stable").astype(np.int32)


@kernel()
def _label_rows(
    buckets: Buckets, wobble: Wobble, blend, mask, corner, out, y_first, y_last
):  # pragma: no cover - compiled
    """Rows y_first ... y_last - 1 of tiles that begin at `corner`. out : of `Labels`

    wobble : its x, y are the column and row there of the first tile"""
    (x0, y0), (first, second, inside) = corner, out
    h, w = first.shape
    positions, boxes, column, row = wobble
    size = buckets.position.shape[1] + STEP
    borders = blend > 0
    local = np.zeros((6, size), np.float32)
    number = np.empty(size, np.int32)
    found = np.empty(size, np.int32)
    sites = LocalSites(local[0], local[1], local[2], number)
    candidates = Candidates(local[3], local[4], local[5])
    away = np.empty(size, np.float32)
    best = np.empty(STEP, np.float32)
    keys = np.empty((2, PIXELS), np.float32)
    n1 = np.empty(PIXELS, np.int32)
    n2 = np.empty(PIXELS, np.int32)
    inset = np.empty(PIXELS, np.uint8)
    spacing = (
        buckets.side
        * STEPS
        * np.sqrt(buckets.rows * buckets.columns / buckets.order.size)
    )
    # how far around a tile it looks at first: mostly enough
    usual = np.float32(1.5 * spacing + 2 * blend)
    for ty in range(y_first + y0, min(y_last + y0, h), TILE):
        for tx in range(x0, w, TILE):
            top = max(ty, 0)
            left = max(tx, 0)
            bottom = min(ty + TILE, h)
            right = min(tx + TILE, w)
            if mask.size > 0 and not mask[top:bottom, left:right].any():
                continue
            i = (row + (ty - y0) // TILE) % positions.shape[0]
            j = (column + (tx - x0) // TILE) % positions.shape[1]
            box = boxes[i, j, 0], boxes[i, j, 1], boxes[i, j, 2], boxes[i, j, 3]
            # its middle, and how far its positions reach from there
            x = np.float32((tx - x0) * STEPS + MIDDLE)
            y = np.float32((ty - y0) * STEPS + MIDDLE)
            reach = max(abs(box[0]) + box[2], abs(box[1]) + box[3])
            more = np.float32(-1)
            wanted = usual
            count = 0
            root = np.float32(0)
            while more < wanted:
                more = wanted
                count = collect(buckets, x, y, more + reach, sites)
                # a site within `blend` of winning is at most 2 blend farther than the winner
                root = np.sqrt(bound(sites, count, box, best)) + 2 * blend
                wanted = root if count > 0 else 2 * more
            n = prune(sites, count, box, root * root, away, found)
            unit, most = pack(sites, found, n, reach, candidates)
            p = positions[i, j]
            if most >= EXACT:
                nearest_of_far(sites, found, n, p, blend, n1, n2, inset)
            elif borders:
                nearest_two(candidates, n, unit, p, blend, keys, n1, n2, inset)
            else:
                nearest(candidates, n, unit, p, keys[0], n1)
            for m in range(n):
                found[m] = number[found[m]]
            for y_px in range(top, bottom):
                for x_px in range(left, right):
                    a = _U(y_px)
                    b = _U(x_px)
                    q = _U((y_px - ty) * TILE + x_px - tx)
                    first[a, b] = found[_U(n1[q])]
                    if borders:
                        second[a, b] = found[_U(n2[q])]
                        inside[a, b] = inset[q]
