"""Occluders before the real scene (the virtual object, real planes of limited size): their blur radius.

Outside of the outline the radius of the nearest part is extrapolated. What the outline lets through is then spread with the
same discs as what it covers: the two weights add up to 1, and coverage is right inside, at the edge, and where near parts
stand before far ones."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.rect import Rect

TILE_PX = 8


@numba.njit(cache=True, nogil=True, error_model="numpy")
def object_radius(radius, coverage, depth, near, far, optics):  # pragma: no cover - compiled
    """radius (h, w) of covered pixels from their depth, m, clipped to near..far; -1 where nothing is; 0 where the
    depth is not a distance. Returns the least and the largest; (inf, -1) where there is none."""
    px_per_dioptre, focus, limit = optics
    h, w = radius.shape
    smallest, largest = np.float32(np.inf), np.float32(-1)
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
            smallest = min(smallest, r if r >= 0 else np.float32(np.inf))
    return smallest, largest


def extrapolate_radius(radius: np.ndarray, coverage: np.ndarray, rect: Rect, covered: Rect) -> None:
    """Fill radius (h, w) of `rect`, -1 outside, by the nearest tiles' mean up to at least twice their radius away. In place.

    covered : outside of it nothing is covered
    Tiles lie on a grid of the frame, so that a pixel gets the same from any rectangle that holds what is near it.
    Farther away no light of the layer comes together with what is let through there."""
    offset_x, offset_y = rect.x0 % TILE_PX, rect.y0 % TILE_PX
    part = covered.shift(-rect.x0, -rect.y0)
    mean, left_px, known = _tile_means(
        radius, coverage, offset_x, offset_y, (part.x0, part.y0, part.x1, part.y1)
    )
    _grow(mean, left_px, known)
    _fill(radius, mean, known, offset_x, offset_y)


@numba.njit(cache=True, nogil=True)
def _tile_means(radius, coverage, offset_x, offset_y, covered):  # pragma: no cover - compiled
    """Of each tile: mean radius, how far it is to go on (px), and whether anything is in it."""
    h, w = radius.shape
    th, tw = (offset_y + h - 1) // TILE_PX + 1, (offset_x + w - 1) // TILE_PX + 1
    mean, left_px, known = (
        np.zeros((th, tw), np.float32),
        np.zeros((th, tw), np.float32),
        np.zeros((th, tw), np.bool_),
    )
    for j in range((covered[1] + offset_y) // TILE_PX, (covered[3] - 1 + offset_y) // TILE_PX + 1):
        ya, yb = (
            max(j * TILE_PX - offset_y, covered[1]),
            min((j + 1) * TILE_PX - offset_y, covered[3]),
        )
        for i in range(
            (covered[0] + offset_x) // TILE_PX, (covered[2] - 1 + offset_x) // TILE_PX + 1
        ):
            xa, xb = (
                max(i * TILE_PX - offset_x, covered[0]),
                min((i + 1) * TILE_PX - offset_x, covered[2]),
            )
            total, weight, largest = np.float64(0), np.float64(0), np.float32(0)
            for y in range(ya, yb):
                for x in range(xa, xb):
                    r, c = radius[np.uintp(y), np.uintp(x)], coverage[np.uintp(y), np.uintp(x)]
                    c = c if r >= 0 else np.float32(0)
                    total += c * r
                    weight += c
                    largest = max(largest, r)
            if weight > 0:
                mean[j, i], left_px[j, i], known[j, i] = total / weight, 2 * largest, True
    return mean, left_px, known


@numba.njit(cache=True, nogil=True)
def _grow(mean, left_px, known):  # pragma: no cover - compiled
    """Tile by tile outwards, two tiles farther than left_px, in place: each time the mean of the known ones among the eight
    around. left_px : of a tile, how much farther it is to go on"""
    h, w = mean.shape
    edge, asked = (
        np.empty((h * w, 2), np.int32),
        np.zeros((h, w), np.bool_),
    )  # tiles found last, then those beside them
    count = 0
    for y in range(h):
        for x in range(w):
            if known[y, x]:
                edge[count, 0], edge[count, 1] = y, x
                count += 1
    beside, value = np.empty((h * w, 2), np.int32), np.empty((h * w, 2), np.float32)
    while True:
        found = 0
        for k in range(count):
            if left_px[edge[k, 0], edge[k, 1]] <= -2 * TILE_PX:
                continue
            for j in range(max(edge[k, 0] - 1, 0), min(edge[k, 0] + 2, h)):
                for i in range(max(edge[k, 1] - 1, 0), min(edge[k, 1] + 2, w)):
                    if not known[j, i] and not asked[j, i]:
                        asked[j, i] = True
                        beside[found, 0], beside[found, 1] = j, i
                        found += 1
        if found == 0:
            return
        for k in range(found):
            total, near, largest = 0.0, 0, np.float32(-np.inf)
            for j in range(max(beside[k, 0] - 1, 0), min(beside[k, 0] + 2, h)):
                for i in range(max(beside[k, 1] - 1, 0), min(beside[k, 1] + 2, w)):
                    if known[j, i]:
                        total += mean[j, i]
                        near += 1
                        largest = max(largest, left_px[j, i])
            value[k, 0], value[k, 1] = total / near, largest - TILE_PX
        for k in range(found):
            j, i = beside[k, 0], beside[k, 1]
            mean[j, i], left_px[j, i], known[j, i] = value[k, 0], value[k, 1], True
        edge, beside, count = beside, edge, found


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _fill(radius, mean, known, offset_x, offset_y):  # pragma: no cover - compiled
    """Bilinear between the centres of known tiles."""
    h, w = radius.shape
    th, tw = mean.shape
    step, half, middle = np.float32(1.0 / TILE_PX), np.float32(0.5), TILE_PX // 2
    total, weight = (
        np.empty(tw, np.float32),
        np.empty(tw, np.float32),
    )  # of a row, by column of tiles
    for y in range(h):
        v = (np.float32(y + offset_y) + half) * step - half
        j = int(np.floor(v))
        t = v - np.float32(j)
        a, b = min(max(j, 0), th - 1), min(max(j + 1, 0), th - 1)
        for i in range(tw):
            above, below = (
                (np.float32(1) - t) * np.float32(known[a, i]),
                t * np.float32(known[b, i]),
            )
            total[i], weight[i] = above * mean[a, i] + below * mean[b, i], above + below
        for i in range(-1, tw):  # pixels from the middle of tile i to that of the next
            p, q = max(i, 0), min(i + 1, tw - 1)
            if weight[p] <= 0 and weight[q] <= 0:
                continue
            first = i * TILE_PX + middle - offset_x
            for x in range(max(first, 0), min(first + TILE_PX, w)):
                s = (np.float32(x - first) + half) * step
                weight_here = weight[p] + (weight[q] - weight[p]) * s
                r = (total[p] + (total[q] - total[p]) * s) / weight_here
                known_here = radius[np.uintp(y), np.uintp(x)] >= 0 or weight_here <= np.float32(
                    1e-6
                )
                radius[np.uintp(y), np.uintp(x)] = (
                    radius[np.uintp(y), np.uintp(x)] if known_here else r
                )
