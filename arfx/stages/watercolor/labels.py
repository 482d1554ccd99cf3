"""Nearest-site labels, exact: a tile of 16 x 16 pixels only meets the sites that can win one of its pixels.

Distance is that of a power diagram, |p - s|^2 - weight; with all weights 0 the cells are Voronoi cells. Sites and pixels lie
on a grid of 1/8 px, so that distances are integers; of equal distances the site of the lower number wins. Pixels may be
displaced (wobble) before they ask. A tile collects the sites around it, prunes them and compares what is left (label_kernels).
Cost: O(pixels x some 20 candidates). Source: docs/methods/watercolor.md#labels; tiles in place of cones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

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
    nearest_sites,
    pack,
    prune,
)
from arfx.stages.watercolor.sites import STEPS, Sites

_U = np.uint64


@dataclass(frozen=True, eq=False)
class Labels:
    """first (h, w) int32 : the nearest site;  second (h, w) int32 : the next one, where it is near
    inside (h, w) uint8 : 0 on the border between both, SOLID from `blend_px` off it;  count : of sites
    second and inside are (0, 0) where borders were not asked for."""

    first: np.ndarray
    second: np.ndarray
    inside: np.ndarray
    count: int


def unlabelled(height: int, width: int, count: int, borders: bool) -> Labels:
    """Every pixel in cell 0."""
    first = np.zeros((height, width), np.int32)
    if not borders:
        return Labels(first, np.zeros((0, 0), np.int32), np.zeros((0, 0), np.uint8), count)
    return Labels(first, first, np.full((height, width), SOLID, np.uint8), count)


@dataclass(frozen=True, eq=False)
class Wobble:
    """Displacement of pixels before they ask, repeated: the same wherever the tiles of labels begin.

    tile (2, n, n) int8 : along x and y, 1/STEPS px;  x, y : where in it pixel (0, 0) of the frame lies
    positions (n/TILE, n/TILE, 2, PIXELS) float32 : displaced positions of a tile's pixels, 1/STEPS px from their middle
    boxes (n/TILE, n/TILE, 4) float32 : around these: middle, half sides"""

    tile: np.ndarray
    positions: np.ndarray
    boxes: np.ndarray
    x: int = 0
    y: int = 0

    def at(self, x: int, y: int) -> Wobble:
        return replace(self, x=x, y=y)


def make_wobble(tile: np.ndarray) -> Wobble:
    """tile (2, n, n) whole numbers of 1/STEPS px, |.| <= 127; n a multiple of TILE."""
    n = tile.shape[1] // TILE
    own = np.arange(TILE, dtype=np.float32) * STEPS - MIDDLE
    squares = tile.reshape(2, n, TILE, n, TILE).transpose(1, 3, 0, 2, 4) + np.stack(
        np.broadcast_arrays(own, own[:, None])
    )
    positions = np.ascontiguousarray(squares, np.float32).reshape(n, n, 2, PIXELS)
    low, high = positions.min(-1), positions.max(-1)
    boxes = np.concatenate([(low + high) / 2, (high - low) / 2], -1)
    return Wobble(tile.astype(np.int8), positions, np.ascontiguousarray(boxes, np.float32))


STILL = make_wobble(np.zeros((2, TILE, TILE)))


def _grid(count: int, rect: Rect, wobble: Wobble) -> tuple[int, int, int, int, int]:
    """(x, y of the first tile in rect, <= 0, side of a bucket px, rows, columns): buckets of some two sites."""
    x, y = -((wobble.x + rect.x0) % TILE), -((wobble.y + rect.y0) % TILE)
    spacing, longest = np.sqrt(rect.area / max(count, 1)), max(rect.width, rect.height)
    side = int(max(1, min(round(1.5 * spacing), longest)))
    return x, y, side, -(-(rect.height - y) // side), -(-(rect.width - x) // side)


def sort_sites(sites: Sites, rect: Rect, wobble: Wobble = STILL) -> Sites:
    """The same sites, numbered as `label` meets them."""
    if not len(sites) or rect.empty:
        return sites
    x, y, side, gh, gw = _grid(len(sites), rect, wobble)
    _, order = bucket_sites(
        sites.x, sites.y, float(rect.x0 + x), float(rect.y0 + y), float(side), gh, gw
    )
    return Sites(
        *(a.take(order) for a in (sites.x, sites.y, sites.weight, sites.key, sites.u, sites.v))
    )


def label(
    sites: Sites,
    rect: Rect,
    wobble: Wobble = STILL,
    blend_px: float = 0.0,
    mask: np.ndarray | None = None,
) -> Labels:
    """Labels of the pixels of `rect`.

    blend_px : as in Labels, 0 = no borders;  mask (h, w) bool : only these are asked for, the others hold anything
    Without a site every pixel is labelled 0 and count is 1."""
    h, w = rect.height, rect.width
    n, borders = len(sites), blend_px > 0
    if n == 0 or h == 0 or w == 0:
        return unlabelled(h, w, max(n, 1), borders)
    first = np.zeros((h, w), np.int32)
    second = np.zeros((h, w) if borders else (0, 0), np.int32)
    inside = np.empty((h, w) if borders else (0, 0), np.uint8)
    x0, y0, side, gh, gw = _grid(n, rect, wobble)
    start, order = bucket_sites(
        sites.x, sites.y, float(rect.x0 + x0), float(rect.y0 + y0), float(side), gh, gw
    )
    position = np.zeros((3, n + STEP), np.float32)
    position[0, :n], position[1, :n] = (
        sites.x[order] - STEPS * (rect.x0 + x0),
        sites.y[order] - STEPS * (rect.y0 + y0),
    )
    position[2, :n] = sites.weight[order]
    mask = np.zeros((0, 0), bool) if mask is None else mask
    tile = (wobble.y + rect.y0 + y0) // TILE, (wobble.x + rect.x0 + x0) // TILE
    buckets, blend = Buckets(position, order, start, side, gh, gw), np.float32(blend_px * STEPS)
    displaced, out = (wobble.positions, wobble.boxes, *tile), (first, second, inside)
    parallel_rows(
        lambda a, b: _label(buckets, displaced, blend, mask, x0, y0, a, b, out), h - y0, TILE
    )
    if (order[1:] < order[:-1]).any():
        first, second = order[first], order[second]
    return Labels(first, second, inside, n)


@numba.njit(cache=True, nogil=True)
def bucket_sites(sx, sy, x0, y0, side, gh, gw):  # pragma: no cover - compiled
    """(start (gh gw + 1), order (n,)) : sites by bucket, in each by number. Sites outside count to the nearest bucket."""
    n = sx.shape[0]
    start, at = np.zeros(gh * gw + 1, np.int32), np.empty(n, np.int32)
    for k in range(n):
        i = np.int64(np.floor((sy[k] / STEPS - y0) / side))
        j = np.int64(np.floor((sx[k] / STEPS - x0) / side))
        at[k] = min(max(i, 0), gh - 1) * gw + min(max(j, 0), gw - 1)
        start[at[k] + 1] += 1
    for k in range(gh * gw):
        start[k + 1] += start[k]
    free, order = start[:-1].copy(), np.empty(n, np.int32)
    for k in range(n):
        order[free[at[k]]] = k
        free[at[k]] += 1
    return start, order


@numba.njit(cache=True, nogil=True)
def _label(
    buckets: Buckets, displaced, blend, mask, x0, y0, y_first, y_last, out
):  # pragma: no cover - compiled
    """Rows y_first ... y_last - 1 of tiles that begin at (x0, y0). out : first, second, inside, of `Labels`

    displaced : positions and boxes of a `Wobble`, row and column there of the first tile"""
    (positions, boxes, row, column), (first, second, inside) = displaced, out
    h, w = first.shape
    packed, packed_wide = np.empty((2, PIXELS), np.float32), np.empty((2, PIXELS))
    n1, n2, inset = (
        np.empty(PIXELS, np.int32),
        np.empty(PIXELS, np.int32),
        np.empty(PIXELS, np.uint8),
    )
    size, borders = buckets.position.shape[1] + STEP, blend > 0
    number, found, away = (
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.float32),
    )
    rows, more_rows = np.zeros((6, size), np.float32), np.empty((3, size))
    sites, narrow = (
        LocalSites(rows[0], rows[1], rows[2], number),
        Candidates(rows[3], rows[4], rows[5]),
    )
    best, wide = (
        np.empty((4, STEP), np.float32),
        Candidates(more_rows[0], more_rows[1], more_rows[2]),
    )
    spacing = buckets.side * STEPS * np.sqrt(buckets.gh * buckets.gw / buckets.order.shape[0])
    usual = np.float32(
        1.5 * spacing + 2 * blend
    )  # how far around a tile it looks at first: mostly enough
    for ty in range(y_first + y0, min(y_last + y0, h), TILE):
        for tx in range(x0, w, TILE):
            top, left, bottom, end = max(ty, 0), max(tx, 0), min(ty + TILE, h), min(tx + TILE, w)
            if mask.shape[0] > 0 and not mask[top:bottom, left:end].any():
                continue
            i, j = (
                (row + (ty - y0) // TILE) % positions.shape[0],
                (column + (tx - x0) // TILE) % positions.shape[1],
            )
            box = boxes[i, j, 0], boxes[i, j, 1], boxes[i, j, 2], boxes[i, j, 3]
            x, y = (
                np.float32((tx - x0) * STEPS + MIDDLE),
                np.float32((ty - y0) * STEPS + MIDDLE),
            )  # its middle
            reach = max(abs(box[0]) + box[2], abs(box[1]) + box[3])  # of its positions from there
            more, wanted, count, root = np.float32(-1), usual, 0, np.float32(0)
            while more < wanted:
                more = wanted
                count = collect(buckets, x, y, more + reach, more + reach, sites)
                # a site that comes within `blend` of winning is at most 2 blend farther than the winner
                root = np.sqrt(bound(sites, count, box, best)) + 2 * blend
                wanted = root if count > 0 else 2 * more
            n = prune(sites, count, box, root * root, away, found)
            unit, most = pack(sites, found, n, reach, narrow)
            if most < EXACT:
                nearest_sites(narrow, n, unit, positions[i, j], blend, packed, n1, n2, inset)
            else:
                pack(sites, found, n, reach, wide)
                nearest_sites(wide, n, unit, positions[i, j], blend, packed_wide, n1, n2, inset)
            for m in range(n):
                found[m] = number[found[m]]
            for i in range(top, bottom):
                for j in range(left, end):
                    a, b, q = _U(i), _U(j), _U((i - ty) * TILE + j - tx)
                    first[a, b] = found[_U(n1[q])]
                    if borders:
                        second[a, b], inside[a, b] = found[_U(n2[q])], inset[q]
