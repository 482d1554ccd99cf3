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

_MOST = np.float32(2**24 - 1)
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


def label(sites: Sites, rect: Rect, wobble: np.ndarray | None = None, blend_px: float = 0.0) -> Labels:
    """Labels of the pixels of `rect`.

    wobble : (h, w, 2) int16 displacement in 1/STEPS px, at most `reach` of it is allowed for;  blend_px : see Labels
    Without a site every pixel is labelled 0 and count is 1.
    """
    h, w = rect.height, rect.width
    first = np.zeros((h, w), np.int32)
    n = len(sites)
    if n == 0 or h == 0 or w == 0:
        return Labels(first, first, np.full((h, w), SOLID, np.uint8), max(n, 1))
    borders = blend_px > 0
    second = np.zeros((h, w), np.int32) if borders else first
    inside = np.full((h, w), SOLID, np.uint8)
    spacing = np.sqrt(h * w / n)
    # buckets of about a site or two each, whole tiles wide
    bucket = int(TILE * max(1, min(np.ceil(spacing / TILE), np.ceil(max(h, w) / TILE))))
    gh, gw = -(-h // bucket), -(-w // bucket)
    start, order = _bucketed(sites.x, sites.y, rect.x0, rect.y0, bucket, gh, gw)
    wobble = np.zeros((0, 0, 2), np.int16) if wobble is None else wobble
    reach = float(np.abs(wobble).max()) if wobble.size else 0.0
    wide = spacing * 4 + reach / STEPS + 2 * blend_px > _FAR_PX
    kind = np.float64 if wide else np.float32
    x, y, weight = (a.astype(np.float64) for a in (sites.x, sites.y, sites.weight))
    place = np.stack([x - STEPS * rect.x0, y - STEPS * rect.y0, weight]).astype(kind)

    def one(y0: int, y1: int) -> None:
        _label(place, order, start, bucket, gh, gw, wobble, kind(reach), kind(blend_px * STEPS), y0, y1, first, second, inside)

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
def _label(place, order, start, bucket, gh, gw, wobble, reach, blend, y_first, y_last, first, second, inside):  # pragma: no cover
    h, w = first.shape
    zero, inf = reach * 0, reach * 0 + np.inf
    px, py = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    d1, d2 = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    n1, n2 = np.empty(TILE * TILE, np.int32), np.empty(TILE * TILE, np.int32)
    found = np.empty(order.shape[0], np.int32)
    share = np.empty(TILE * TILE, np.uint8)
    k1, k2 = np.empty(TILE * TILE, place.dtype), np.empty(TILE * TILE, place.dtype)
    sx, sy, sw = np.empty(PACKED, place.dtype), np.empty(PACKED, place.dtype), np.empty(PACKED, place.dtype)
    moved = wobble.shape[0] > 0
    side = zero + bucket * STEPS
    for ty in range(y_first, y_last, TILE):
        rows = min(TILE, h - ty)
        for tx in range(0, w, TILE):
            cols = min(TILE, w - tx)
            # the pixels' places, and the box that holds them
            left, right = zero + tx * STEPS - reach, zero + (tx + cols - 1) * STEPS + reach
            top, bottom = zero + ty * STEPS - reach, zero + (ty + rows - 1) * STEPS + reach
            for y in range(TILE):
                for x in range(TILE):
                    px[y * TILE + x] = (tx + min(x, cols - 1)) * STEPS
                    py[y * TILE + x] = (ty + min(y, rows - 1)) * STEPS
            if moved:
                for y in range(rows):
                    for x in range(cols):
                        px[y * TILE + x] += wobble[ty + y, tx + x, 0]
                        py[y * TILE + x] += wobble[ty + y, tx + x, 1]
            # a bound that no pixel's nearest site exceeds: the farthest pixel's distance to the best site
            gy, gx = ty // bucket, tx // bucket
            bound, ring = inf, 0
            while ring <= max(gh, gw):
                gap = (ring - 1) * side - reach
                if ring > 1 and gap > 0 and gap * gap > bound:
                    break
                for i in range(max(gy - ring, 0), min(gy + ring, gh - 1) + 1):
                    step = 1 if i == gy - ring or i == gy + ring else 2 * ring
                    for j in range(gx - ring, gx + ring + 1, step):
                        if j < 0 or j >= gw:
                            continue
                        for m in range(start[i * gw + j], start[i * gw + j + 1]):
                            k = order[m]
                            dx = max(place[0, k] - left, right - place[0, k])
                            dy = max(place[1, k] - top, bottom - place[1, k])
                            bound = min(bound, dx * dx + dy * dy - place[2, k])
                ring += 1
            if blend > 0:
                # a site that comes within `blend` of winning is at most 2 blend farther than the winner
                root = np.sqrt(bound) + 2 * blend
                bound = root * root + 1
            candidates, ring = 0, 0
            while ring <= max(gh, gw):
                gap = (ring - 1) * side - reach
                if ring > 1 and gap > 0 and gap * gap > bound:
                    break
                for i in range(max(gy - ring, 0), min(gy + ring, gh - 1) + 1):
                    step = 1 if i == gy - ring or i == gy + ring else 2 * ring
                    for j in range(gx - ring, gx + ring + 1, step):
                        if j < 0 or j >= gw:
                            continue
                        for m in range(start[i * gw + j], start[i * gw + j + 1]):
                            k = order[m]
                            dx = max(left - place[0, k], place[0, k] - right, zero)
                            dy = max(top - place[1, k], place[1, k] - bottom, zero)
                            if dx * dx + dy * dy - place[2, k] <= bound:
                                found[candidates] = k
                                candidates += 1
                ring += 1
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
            for y in range(rows):
                for x in range(cols):
                    first[ty + y, tx + x] = n1[y * TILE + x]
            if blend > 0:
                _inside(d1, d2, n1, n2, blend, share)
                for y in range(rows):
                    for x in range(cols):
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
    if candidates == 1:
        k2[:] = k1


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
