"""Nearest-site labels, exact: a tile of 8 x 8 pixels only meets the sites that can win one of its pixels.

Distance is that of a power diagram, |p - s|^2 - weight; with all weights 0 the cells are Voronoi cells. Sites and pixels lie
on a grid of 1/8 px, so that distances are integers; of equal distances the site of the lower number wins. Pixels may be
displaced (wobble) before they ask. A block of 2 x 2 tiles collects the sites around it once; its tiles prune them and compare
what is left (label_kernels). Cost: O(pixels x some 10 candidates). Source: docs/methods/watercolor.md#labels; tiles in place of
cones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.stages.watercolor.label_kernels import (
    BLOCK,
    FAR,
    MIDDLE,
    PACKED,
    PACKED_LIMIT,
    PIXELS,
    SOLID,
    STEP,
    TILE,
    Buckets,
    Candidates,
    LocalSites,
    border_insets,
    bound,
    collect,
    compact,
    label_tile,
    nearest_float64,
    nearest_two,
    pack,
    pad_far,
    prune,
    renumber,
    sort_by_label,
)  # fmt: skip
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
    positions (n/8, n/8, 2, PIXELS) float32 : displaced positions of each 8 x 8 pixels, 1/STEPS px from their middle
    boxes (n/8, n/8, 4) int32 : around these: middle, half sides"""

    tile: np.ndarray
    positions: np.ndarray
    boxes: np.ndarray
    x: int = 0
    y: int = 0

    def at(self, x: int, y: int) -> Wobble:
        return replace(self, x=x, y=y)


def make_wobble(tile: np.ndarray) -> Wobble:
    """tile (2, n, n) whole numbers of 1/STEPS px, |.| <= 127; n a multiple of 8."""
    n = tile.shape[1] // TILE
    own = np.arange(TILE, dtype=np.float32) * STEPS - MIDDLE
    squares = tile.reshape(2, n, TILE, n, TILE).transpose(1, 3, 0, 2, 4) + np.stack(np.broadcast_arrays(own, own[:, None]))
    positions = np.ascontiguousarray(squares, np.float32).reshape(n, n, 2, PIXELS)
    low, high = positions.min(-1).astype(np.int32), positions.max(-1).astype(np.int32)
    middle = (low + high) // 2
    boxes = np.concatenate([middle, np.maximum(high - middle, middle - low)], -1)
    return Wobble(tile.astype(np.int8), positions, np.ascontiguousarray(boxes, np.int32))


STILL = make_wobble(np.zeros((2, TILE, TILE)))


def _grid(count: int, rect: Rect, wobble: Wobble) -> tuple[int, int, int, int, int]:
    """(x, y of the first tile in rect, <= 0, side of a bucket px, rows, columns): buckets of about one site."""
    x, y = -((wobble.x + rect.x0) % TILE), -((wobble.y + rect.y0) % TILE)
    spacing, longest = np.sqrt(rect.area / max(count, 1)), max(rect.width, rect.height)
    side = int(TILE * max(1, min(np.round(spacing / TILE), np.ceil(longest / TILE))))
    return x, y, side, -(-(rect.height - y) // side), -(-(rect.width - x) // side)


def sort_sites(sites: Sites, rect: Rect, wobble: Wobble = STILL) -> Sites:
    """The same sites, numbered so that `label` need not sort what it finds."""
    if not len(sites) or rect.empty:
        return sites
    x, y, side, gh, gw = _grid(len(sites), rect, wobble)
    _, order = bucket_sites(sites.x, sites.y, float(rect.x0 + x), float(rect.y0 + y), float(side), gh, gw)
    return Sites(*_reorder(order, sites.x, sites.y, sites.weight, sites.key, sites.u, sites.v))


def label(
    sites: Sites, rect: Rect, wobble: Wobble = STILL, blend_px: float = 0.0, mask: np.ndarray | None = None
) -> Labels:  # fmt: skip
    """Labels of the pixels of `rect`.

    blend_px : as in Labels, 0 = no borders;  mask (h, w) bool : only these are asked for, the others hold anything
    Without a site every pixel is labelled 0 and count is 1."""
    h, w = rect.height, rect.width
    n, borders = len(sites), blend_px > 0
    if n == 0 or h == 0 or w == 0:
        return unlabelled(h, w, max(n, 1), borders)
    first = np.empty((h, w), np.int32)
    second = np.empty((h, w) if borders else (0, 0), np.int32)
    inside = np.empty((h, w) if borders else (0, 0), np.uint8)
    x0, y0, side, gh, gw = _grid(n, rect, wobble)
    start, order = bucket_sites(sites.x, sites.y, float(rect.x0 + x0), float(rect.y0 + y0), float(side), gh, gw)
    position, ordered = _positions(order, sites.x, sites.y, sites.weight, STEPS * rect.x0, STEPS * rect.y0)
    mask = np.zeros((0, 0), bool) if mask is None else mask
    tile = (wobble.y + rect.y0 + y0) // TILE, (wobble.x + rect.x0 + x0) // TILE
    buckets, blend = Buckets(position, order, start, side, gh, gw), np.float32(blend_px * STEPS)
    displaced, out = (wobble.positions, wobble.boxes, *tile), (first, second, inside)
    parallel_rows(lambda a, b: _label(buckets, ordered, displaced, blend, mask, x0, y0, a, b, out), h - y0, BLOCK)
    return Labels(first, second, inside, n)


@numba.njit(cache=True, nogil=True)
def _reorder(order, x, y, weight, key, u, v):  # pragma: no cover - compiled
    n = order.shape[0]
    a, b, c = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    d, e, f = np.empty(n, np.int64), np.empty(n, np.float32), np.empty(n, np.float32)
    for k in range(n):
        m = order[k]
        a[k], b[k], c[k], d[k], e[k], f[k] = x[m], y[m], weight[m], key[m], u[m], v[m]
    return a, b, c, d, e, f


@numba.njit(cache=True, nogil=True)
def _positions(order, x, y, weight, x0, y0):  # pragma: no cover - compiled
    """(x, y, weight (3, n + STEP) int32 in that order, relative to (x0, y0), 1/STEPS px; whether that is the sites' own)."""
    n, ordered = order.shape[0], True
    out = np.zeros((3, n + STEP), np.int32)
    for k in range(n):
        m = order[k]
        ordered = ordered and m == k
        out[0, k], out[1, k] = np.int32(x[m]) - np.int32(x0), np.int32(y[m]) - np.int32(y0)
        out[2, k] = np.int32(max(weight[m], -np.float32(FAR) * np.float32(FAR)))
    return out, ordered


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
def _label(buckets: Buckets, ordered, displaced, blend, mask, x0, y0, y_first, y_last, out):  # pragma: no cover - compiled
    """Rows y_first ... y_last - 1 of tiles that begin at (x0, y0). out : first, second, inside, of `Labels`

    displaced : positions and boxes of a `Wobble`, row and column there of the first tile"""
    order, (positions, boxes, row, column), (first, second, inside) = buckets.order, displaced, out
    h, w = first.shape
    k1, k2 = np.empty(PIXELS, np.float32), np.empty(PIXELS, np.float32)
    n1, n2, inset = np.empty(PIXELS, np.int32), np.empty(PIXELS, np.int32), np.empty(PIXELS, np.uint8)
    size = order.shape[0] + 2 * STEP
    lx, ly, lw, number = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32)
    away, found, sites = np.empty(size, np.int32), np.empty(size, np.int32), LocalSites(lx, ly, lw, number)
    ca, cb, cc = np.empty(PACKED, np.float32), np.empty(PACKED, np.float32), np.empty(PACKED, np.float32)
    ta, tb, tc = np.empty(PACKED, np.float32), np.empty(PACKED, np.float32), np.empty(PACKED, np.float32)
    near, names = np.empty(PACKED, np.int32), np.empty(PACKED, np.int32)
    block, own = Candidates(ca, cb, cc, near), Candidates(ta, tb, tc, names)  # candidates of all four tiles, of one
    borders, flat = blend > 0, positions.reshape(-1)
    reach = np.int32((np.abs(boxes[..., :2]) + boxes[..., 2:]).max())  # of a tile's positions from its middle
    half = np.int32(reach + TILE * STEPS // 2)
    every = np.arange(order.shape[0]).astype(np.int32)
    # how far around a block it looks at first: mostly enough
    usual = buckets.side * STEPS * 1.5 + 2 * blend
    for by in range(y_first + y0, min(y_last + y0, h), BLOCK):
        for bx in range(x0, w, BLOCK):
            mx, my = np.int32(bx * STEPS + STEPS * (BLOCK - 1) // 2), np.int32(by * STEPS + STEPS * (BLOCK - 1) // 2)
            # the block's middle from the first bucket's corner
            ox, oy = np.int64(mx - x0 * STEPS), np.int64(my - y0 * STEPS)
            r, wanted, count, far = np.int64(0), np.int64(half + usual), 0, False
            while r < wanted and not far:
                r = wanted
                count = collect(buckets, oy - r, ox - r, oy + r, ox + r, mx, my, sites)
                full = pad_far(count, sites)
                # what may matter to one of its tiles lies no farther off the box of its positions than this
                root = np.sqrt(np.float64(bound(sites, full, np.int32(0), np.int32(0), half, half))) + 2 * blend
                if count > 0:
                    far = root > FAR - 2 * half
                    wanted = np.int64(root) + half + 1
                else:
                    wanted = 2 * r
            if not far:
                count = prune(sites, full, np.int32(0), np.int32(0), half, half, np.int32(root * root) + 1, away, found)
                compact(count, found, sites)
            if not ordered and not far:
                sort_by_label(order, count, sites, away)
            full = pad_far(count, sites)
            # mostly one list does for all four tiles: to look for the nearest alone costs less than to prune
            whole = ordered and not far and not borders and count <= PACKED
            if whole:
                whole = pack(sites, every, count, 0, 0, np.float32(half), block) < PACKED_LIMIT
            for tile in range(4):
                down, right = tile >> 1, tile & 1
                ty, tx = by + TILE * down, bx + TILE * right
                top, left, bottom, end = max(ty, 0), max(tx, 0), min(ty + TILE, h), min(tx + TILE, w)
                if top >= bottom or left >= end:
                    continue
                if mask.shape[0] > 0 and not mask[top:bottom, left:end].any():
                    continue
                i = (row + (ty - y0) // TILE) % positions.shape[0]
                j = (column + (tx - x0) // TILE) % positions.shape[1]
                half_tile = TILE * STEPS // 2
                own_x, own_y = np.int32((2 * right - 1) * half_tile), np.int32((2 * down - 1) * half_tile)
                if whole and end - left == TILE and bottom - top == TILE:
                    at = (i * positions.shape[1] + j) * 2 * PIXELS
                    label_tile(block, np.float32(own_x), np.float32(own_y), count, flat, at, k1, first, top, left)
                    continue
                p, n, fits = positions[i, j], 0, False
                if not far:
                    cx, cy = np.int32(own_x + boxes[i, j, 0]), np.int32(own_y + boxes[i, j, 1])
                    hx, hy = boxes[i, j, 2], boxes[i, j, 3]
                    # a site that comes within `blend` of winning is at most 2 blend farther than the winner
                    root = np.sqrt(np.float64(bound(sites, full, cx, cy, hx, hy))) + 2 * blend
                    n = prune(sites, full, cx, cy, hx, hy, np.int32(root * root) + 1, away, found)
                    if n <= PACKED:
                        fits = pack(sites, found, n, own_x, own_y, np.float32(reach), own) < PACKED_LIMIT
                if fits and ordered and not borders and end - left == TILE and bottom - top == TILE:
                    at = (i * positions.shape[1] + j) * 2 * PIXELS
                    label_tile(own, np.float32(0), np.float32(0), n, flat, at, k1, first, top, left)
                    continue
                if fits:
                    nearest_two(own, n, p, k1, k2)
                    if n == 1:
                        k2[:] = np.float32(2e9)  # there is no other near enough
                    border_insets(p, k1, k2, blend if borders else np.float32(1), n1, n2, inset)
                    renumber(n2, names)
                    renumber(n1, names)
                else:
                    for m in range(n):
                        found[m] = number[found[m]]
                    tile_x, tile_y = np.float64(tx * STEPS + MIDDLE), np.float64(ty * STEPS + MIDDLE)
                    which = every if far else found
                    nearest_float64(buckets, which, order.shape[0] if far else n, tile_x, tile_y, p, blend, n1, n2, inset)
                if not ordered:
                    renumber(n1, order)
                    if borders:
                        renumber(n2, order)
                for y in range(top, bottom):
                    for x in range(left, end):
                        j, i, q = _U(y), _U(x), _U((y - ty) * TILE + x - tx)
                        first[j, i] = n1[q]
                        if borders:
                            second[j, i], inside[j, i] = n2[q], inset[q]
