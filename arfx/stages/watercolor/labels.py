"""Nearest-site labels, exact: a tile of 8 x 8 pixels only meets the sites that can win one of its pixels.

Distance is that of a power diagram, |p - s|^2 - weight; with all weights 0 the cells are Voronoi cells. Sites and pixels lie
on a grid of 1/8 px, so that distances are integers and float32 holds them exactly (float64 where cells are larger than
400 px); of equal distances the site of the lower number wins. Pixels may be displaced (wobble) before they ask.
Cost: O(pixels x some 6 candidates). Source: SYSTEMS.md S3 step 2; tiles in place of cones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from arfx.core.rect import Rect
from arfx.stages.watercolor.bands import by_bands
from arfx.stages.watercolor.sites import STEPS, Sites

TILE = 8
_FAR_PX = 400.0
PACKED = 64  # candidates whose number fits one float32 together with their distance, exactly, ...
PACKED_DISTANCE = 1 << 18  # ... which is below this, in 1/STEPS^2 px^2

_MOST = np.float32(2**24 - PACKED)  # number 0, and as far as can be
SOLID = 255  # a pixel this far inside its cell takes nothing of its neighbour's colour


@dataclass(frozen=True, eq=False)
class Labels:
    """first (h, w) int32 : the nearest site;  second (h, w) int32 : the next one, where it is near
    inside (h, w) uint8 : 0 on the border between both, SOLID from `blend_px` off it;  count : of sites
    """

    first: np.ndarray
    second: np.ndarray
    inside: np.ndarray
    count: int

    @property
    def bytes(self) -> int:
        return self.first.nbytes + self.second.nbytes + self.inside.nbytes


def label(
    sites: Sites, rect: Rect, wobble: np.ndarray | None = None, blend_px: float = 0.0, reach: float | None = None
) -> Labels:  # fmt: skip
    """Labels of the pixels of `rect`.

    wobble : (2, h, w) float32 displacement along x and y, in 1/STEPS px, whole numbers;  blend_px : see Labels
    reach : no displacement is larger, 1/STEPS px; None = measured
    Without a site every pixel is labelled 0 and count is 1.
    """
    h, w = rect.height, rect.width
    n = len(sites)
    if n == 0 or h == 0 or w == 0:
        first = np.zeros((h, w), np.int32)
        return Labels(first, first, np.full((h, w), SOLID, np.uint8), max(n, 1))
    borders = blend_px > 0
    first = np.empty((h, w), np.int32)
    second = np.empty((h, w), np.int32) if borders else first
    inside = np.empty((h, w), np.uint8) if borders else np.full((h, w), SOLID, np.uint8)
    spacing = np.sqrt(h * w / n)
    # buckets of about a site or two each, whole tiles wide
    bucket = int(TILE * max(1, min(np.ceil(spacing / TILE), np.ceil(max(h, w) / TILE))))
    gh, gw = -(-h // bucket), -(-w // bucket)
    start, order = _bucketed(sites.x, sites.y, rect.x0, rect.y0, bucket, gh, gw)
    wobble = np.zeros((2, 0, 0), np.float32) if wobble is None else wobble
    if reach is None:
        reach = float(np.abs(wobble).max()) if wobble.size else 0.0
    wide = spacing * 4 + reach / STEPS + 2 * blend_px > _FAR_PX
    kind = np.float64 if wide else np.float32
    x, y, weight = (a.astype(np.float64) for a in (sites.x, sites.y, sites.weight))
    place = np.stack([x - STEPS * rect.x0, y - STEPS * rect.y0, weight]).astype(kind)

    by_bucket = np.ascontiguousarray(place[:, order])

    def one(y0: int, y1: int) -> None:
        _label(
            place,
            by_bucket,
            order,
            start,
            bucket,
            gh,
            gw,
            wobble,
            kind(reach),
            kind(blend_px * STEPS),
            y0,
            y1,
            first,
            second,
            inside,
        )

    by_bands(one, h, TILE)
    return Labels(first, second, inside, n)


@numba.njit(cache=True, nogil=True)
def _bucketed(sx, sy, x0, y0, bucket, gh, gw):  # pragma: no cover - compiled
    """(start (gh gw + 1), order (n,)) : sites by bucket, in each by number. Sites outside count to the nearest bucket."""
    n = sx.shape[0]
    start, at = np.zeros(gh * gw + 1, np.int32), np.empty(n, np.int32)
    for k in range(n):
        i = np.int64(np.floor((sy[k] / STEPS - y0) / bucket))
        j = np.int64(np.floor((sx[k] / STEPS - x0) / bucket))
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
    place, sorted_, order, start, bucket, gh, gw, wobble, reach, blend, y_first, y_last, first, second, inside
):  # pragma: no cover
    h, w = first.shape
    zero, inf = reach * 0, reach * 0 + np.inf
    px, py = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    d1, d2 = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    n1, n2 = np.empty(TILE * TILE, np.int32), np.empty(TILE * TILE, np.int32)
    own_x, own_y = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    for q in range(TILE * TILE):
        own_x[q], own_y[q] = (q % TILE) * STEPS, (q // TILE) * STEPS
    found = np.empty(order.shape[0] + 1, np.int32)
    share = np.empty(TILE * TILE, np.uint8)
    k1, k2 = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    sx, sy, sw = np.empty(PACKED, place.dtype), np.empty(PACKED, place.dtype), np.empty(PACKED, place.dtype)
    moved = wobble.shape[1] > 0
    side, half = zero + bucket * STEPS, zero + 0.5
    for ty in range(y_first, y_last, TILE):
        rows = min(TILE, h - ty)
        for tx in range(0, w, TILE):
            cols = min(TILE, w - tx)
            # the pixels' places, and the box that holds them
            left, right = zero + tx * STEPS - reach, zero + (tx + cols - 1) * STEPS + reach
            top, bottom = zero + ty * STEPS - reach, zero + (ty + rows - 1) * STEPS + reach
            base_x, base_y = zero + tx * STEPS, zero + ty * STEPS
            for q in range(TILE * TILE):
                px[q] = base_x + own_x[q]
                py[q] = base_y + own_y[q]
            if moved:
                for y in range(rows):
                    if cols == TILE:
                        for x in range(TILE):  # of fixed length: one step of a vector unit
                            px[y * TILE + x] += wobble[0, ty + y, tx + x]
                            py[y * TILE + x] += wobble[1, ty + y, tx + x]
                    else:
                        for x in range(cols):
                            px[y * TILE + x] += wobble[0, ty + y, tx + x]
                            py[y * TILE + x] += wobble[1, ty + y, tx + x]
            # a bound that no pixel's nearest site exceeds: of each quarter the farthest pixel's distance to its best site
            gy, gx = ty // bucket, tx // bucket
            middle_x, middle_y = (left + right) * half, (top + bottom) * half
            wide, high = (right - left) * half * half + reach, (bottom - top) * half * half + reach
            bound, window = inf, np.int64(1)
            while bound == inf:
                b0, b1, b2, b3 = inf, inf, inf, inf
                for i in range(max(gy - window, 0), min(gy + window, gh - 1) + 1):
                    for m in range(start[i * gw + max(gx - window, 0)], start[i * gw + min(gx + window, gw - 1) + 1]):
                        # the quarters' middles lie `wide`, `high` off the tile's; so do their corners of them
                        ex, ey, cw = sorted_[0, m] - middle_x, sorted_[1, m] - middle_y, sorted_[2, m]
                        near_x, far_x = abs(ex + wide) + wide, abs(ex - wide) + wide
                        near_y, far_y = abs(ey + high) + high, abs(ey - high) + high
                        near_x, far_x, near_y, far_y = near_x * near_x, far_x * far_x, near_y * near_y - cw, far_y * far_y - cw
                        b0, b1 = min(b0, near_x + near_y), min(b1, far_x + near_y)
                        b2, b3 = min(b2, near_x + far_y), min(b3, far_x + far_y)
                bound = max(max(b0, b1), max(b2, b3))
                window *= 2
            # a site that comes within `blend` of winning is at most 2 blend farther than the winner
            root = np.sqrt(bound) + 2 * blend
            bound = root * root + 1
            # what lies outside a window of buckets is at least its size away
            window = np.int64(np.ceil((root + 1 + reach) / side))
            candidates = np.int64(0)
            for i in range(max(gy - window, 0), min(gy + window, gh - 1) + 1):
                for m in range(start[i * gw + max(gx - window, 0)], start[i * gw + min(gx + window, gw - 1) + 1]):
                    dx = max(left - sorted_[0, m], sorted_[0, m] - right, zero)
                    dy = max(top - sorted_[1, m], sorted_[1, m] - bottom, zero)
                    found[candidates] = order[m]
                    candidates += np.int64(dx * dx + dy * dy - sorted_[2, m] <= bound)
            if candidates > PACKED:
                found[:candidates].sort()
            else:
                for m in range(1, candidates):
                    k, at = found[m], m
                    while at > 0 and found[at - 1] > k:
                        found[at] = found[at - 1]
                        at -= 1
                    found[at] = k
            span = np.sqrt(bound) + np.float32(1.415) * (2 * reach + (TILE - 1) * STEPS)
            if candidates <= PACKED and span * span < PACKED_DISTANCE:
                for m in range(candidates):
                    k = found[m]
                    sx[m], sy[m], sw[m] = place[0, k], place[1, k], place[2, k]
                _nearest_packed(sx, sy, sw, candidates, px, py, k1, k2, blend > 0)
                _unpacked(k1, found, n1, d1)
                if blend > 0:
                    _unpacked(k2, found, n2, d2)
            else:
                _nearest(place, found, candidates, px, py, d1, d2, n1, n2)
            if blend > 0:
                _inside(d1, d2, n1, n2, blend, share)
            for y in range(rows):
                if cols == TILE:
                    for x in range(TILE):
                        first[ty + y, tx + x] = n1[y * TILE + x]
                    if blend > 0:
                        for x in range(TILE):
                            second[ty + y, tx + x] = n2[y * TILE + x]
                        for x in range(TILE):
                            inside[ty + y, tx + x] = share[y * TILE + x]
                else:
                    for x in range(cols):
                        first[ty + y, tx + x] = n1[y * TILE + x]
                        if blend > 0:
                            second[ty + y, tx + x] = n2[y * TILE + x]
                            inside[ty + y, tx + x] = share[y * TILE + x]


@numba.njit(cache=True, nogil=True)
def _unpacked(packed, found, number, distance):  # pragma: no cover - compiled
    for q in range(TILE * TILE):
        d = np.floor(packed[q] * np.float32(1.0 / PACKED))
        distance[q] = d
        number[q] = np.int32(packed[q] - d * np.float32(PACKED))
    for q in range(TILE * TILE):
        number[q] = found[number[q]]


@numba.njit(cache=True, nogil=True, fastmath={"nnan", "ninf", "nsz"})
def _nearest_packed(sx, sy, sw, candidates, px, py, k1, k2, two):  # pragma: no cover - compiled
    """Distance and number of the nearest candidate to each pixel of a tile, and of the next, packed in one float32 each,
    both integers: the lesser is the nearer site, or of two as near the one of the lower number."""
    k1[:] = _MOST
    k2[:] = _MOST
    for m in range(candidates):
        cx, cy, add = sx[m], sy[m], np.float32(m) - sw[m] * np.float32(PACKED)
        if two:
            for q in range(TILE * TILE):
                ex, ey = px[q] - cx, py[q] - cy
                k = (ex * ex + ey * ey) * np.float32(PACKED) + add
                a, b = k1[q], k2[q]
                other = a if a > k else k
                k2[q] = b if b < other else other
                k1[q] = a if a < k else k
        else:
            for q in range(TILE * TILE):
                ex, ey = px[q] - cx, py[q] - cy
                k = (ex * ex + ey * ey) * np.float32(PACKED) + add
                a = k1[q]
                k1[q] = a if a < k else k


@numba.njit(cache=True, nogil=True)
def _nearest(place, found, candidates, px, py, d1, d2, n1, n2):  # pragma: no cover - compiled
    """The same for many candidates or far ones. found ascends."""
    d1[:] = np.inf
    d2[:] = np.inf
    n1[:] = found[0]
    n2[:] = found[0]
    for m in range(candidates):
        k = found[m]
        cx, cy, cw = place[0, k], place[1, k], place[2, k]
        for q in range(TILE * TILE):
            ex, ey = px[q] - cx, py[q] - cy
            d = ex * ex + ey * ey - cw
            if d < d1[q]:
                d1[q], n1[q], d2[q], n2[q] = d, k, d1[q], n1[q]
            elif d < d2[q]:
                d2[q], n2[q] = d, k


@numba.njit(cache=True, nogil=True)
def _inside(d1, d2, n1, n2, blend, share):  # pragma: no cover - compiled
    """How much farther the next site is than the nearest, 0..SOLID: SOLID is 2 blend. Half of it is about the way to the
    border between the two."""
    factor = np.float32(SOLID) / np.float32(2 * blend)
    for q in range(TILE * TILE):
        s = (np.sqrt(np.float32(d2[q])) - np.sqrt(np.float32(d1[q]))) * factor
        share[q] = np.uint8(np.int32(min(s, np.float32(SOLID))))
    for q in range(TILE * TILE):
        n2[q] = n2[q] if share[q] < np.uint8(SOLID) else n1[q]


def merged(whole: Labels, part: Labels, mask: np.ndarray, x0: int, y0: int) -> Labels:
    """`whole`, and from (x0, y0) on where the mask says so `part`, whose cells are numbered on."""
    first, second, inside = whole.first.copy(), whole.second.copy(), whole.inside.copy()
    _merge(first, second, inside, part.first, part.second, part.inside, mask, x0, y0, whole.count)
    return Labels(first, second, inside, whole.count + part.count)


@numba.njit(cache=True, nogil=True)
def _merge(first, second, inside, own_first, own_second, own_inside, mask, x0, y0, start):  # pragma: no cover - compiled
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if mask[y, x]:
                first[y0 + y, x0 + x] = own_first[y, x] + start
                second[y0 + y, x0 + x] = own_second[y, x] + start
                inside[y0 + y, x0 + x] = own_inside[y, x]
