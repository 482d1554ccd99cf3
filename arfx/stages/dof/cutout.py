"""Something cut out before the real scene (the virtual object, or a real plane of limited size): its blur radius.

Outside of its outline the radius of the nearest part goes on. What the outline lets through is then spread with the same
discs as what it covers: the two add up to 1, and the share that is covered stays right inside, at the edge, and where near
parts stand before far ones.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.rect import Rect

TILE_PX = 8


@numba.njit(cache=True, nogil=True, error_model="numpy")
def object_radius(radius, coverage, depth, near, far, px_per_dioptre, focus, limit):  # pragma: no cover - compiled
    """radius (h, w) of covered pixels from their depth, m, held to near..far; -1 where nothing is; 0 where the
    depth is not a distance. Returns the least and the largest; (inf, -1) where there is none."""
    h, w = radius.shape
    least, largest = np.float32(np.inf), np.float32(-1)
    for y in range(h):
        line = radius[y]
        for x in range(w):
            z = depth[y, x]
            r = min(px_per_dioptre * abs(focus - np.float32(1) / min(max(z, near), far)), limit)
            r = r if z > 0 else np.float32(0)
            line[x] = r if coverage[y, x] > 0 else np.float32(-1)
        for x in range(w):
            r = line[x]
            largest = max(largest, r)
            least = min(least, r if r >= 0 else np.float32(np.inf))
    return least, largest


def continue_outside(radius: np.ndarray, coverage: np.ndarray, rect: Rect, reach_px: float) -> None:
    """Fill radius (h, w), -1 outside, by the nearest tiles' mean up to at least `reach_px` away. In place.

    Tiles lie on a grid of the frame, so that a pixel gets the same from any rectangle that holds what is near it.
    """
    lead_x, lead_y = rect.x0 % TILE_PX, rect.y0 % TILE_PX
    sums = _tile_sums(radius, coverage, lead_x, lead_y)
    mean, known = np.zeros(sums.shape[:2], np.float32), sums[..., 1] > 0
    mean[known] = sums[known, 0] / sums[known, 1]
    _grow(mean, known, int(np.ceil(reach_px / TILE_PX)) + 2)
    _fill(radius, mean, known, lead_x, lead_y)


@numba.njit(cache=True, nogil=True)
def _tile_sums(radius, coverage, lead_x, lead_y):  # pragma: no cover - compiled
    h, w = radius.shape
    out = np.zeros(((lead_y + h - 1) // TILE_PX + 1, (lead_x + w - 1) // TILE_PX + 1, 2), np.float64)
    for y in range(h):
        for x in range(w):
            if radius[y, x] >= 0:
                t = out[(y + lead_y) // TILE_PX, (x + lead_x) // TILE_PX]
                t[0] += coverage[y, x] * radius[y, x]
                t[1] += coverage[y, x]
    return out


@numba.njit(cache=True, nogil=True)
def _grow(mean, known, steps):  # pragma: no cover - compiled
    """So many tiles further, in place: each time the mean of the known ones among the eight around."""
    h, w = mean.shape
    edge, asked = np.empty((h * w, 2), np.int32), np.zeros((h, w), np.bool_)  # tiles found last, then those beside them
    count = 0
    for y in range(h):
        for x in range(w):
            if known[y, x]:
                edge[count, 0], edge[count, 1] = y, x
                count += 1
    beside, value = np.empty((h * w, 2), np.int32), np.empty(h * w, np.float32)
    for _ in range(steps):
        found = 0
        for k in range(count):
            for j in range(max(edge[k, 0] - 1, 0), min(edge[k, 0] + 2, h)):
                for i in range(max(edge[k, 1] - 1, 0), min(edge[k, 1] + 2, w)):
                    if not known[j, i] and not asked[j, i]:
                        asked[j, i] = True
                        beside[found, 0], beside[found, 1] = j, i
                        found += 1
        if found == 0:
            return
        for k in range(found):
            total, near = 0.0, 0
            for j in range(max(beside[k, 0] - 1, 0), min(beside[k, 0] + 2, h)):
                for i in range(max(beside[k, 1] - 1, 0), min(beside[k, 1] + 2, w)):
                    if known[j, i]:
                        total += mean[j, i]
                        near += 1
            value[k] = total / near
        for k in range(found):
            mean[beside[k, 0], beside[k, 1]], known[beside[k, 0], beside[k, 1]] = value[k], True
        edge, beside, count = beside, edge, found


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _fill(radius, mean, known, lead_x, lead_y):  # pragma: no cover - compiled
    """Bilinear between the centres of known tiles."""
    h, w = radius.shape
    th, tw = mean.shape
    step, half = np.float32(1.0 / TILE_PX), np.float32(0.5)
    total, weight = np.empty(tw, np.float32), np.empty(tw, np.float32)  # of a row, by column of tiles
    for y in range(h):
        v = (np.float32(y + lead_y) + half) * step - half
        j = int(np.floor(v))
        t = v - np.float32(j)
        a, b = min(max(j, 0), th - 1), min(max(j + 1, 0), th - 1)
        for i in range(tw):
            above, below = (np.float32(1) - t) * np.float32(known[a, i]), t * np.float32(known[b, i])
            total[i], weight[i] = above * mean[a, i] + below * mean[b, i], above + below
        for x in range(w):
            if radius[y, x] >= 0:
                continue
            u = (np.float32(x + lead_x) + half) * step - half
            i = int(np.floor(u))
            s = u - np.float32(i)
            p, q = min(max(i, 0), tw - 1), min(max(i + 1, 0), tw - 1)
            share = weight[p] + (weight[q] - weight[p]) * s
            if share > np.float32(1e-6):
                radius[y, x] = (total[p] + (total[q] - total[p]) * s) / share
