"""Nearest sites by every pair of pixel and site, in float64."""

from __future__ import annotations

import numpy as np

from arfx.core.rect import Rect
from arfx.stages.watercolor.label_kernels import MIDDLE, TILE
from arfx.stages.watercolor.labels import Wobble
from arfx.stages.watercolor.sites import STEPS, Sites

_AT_ONCE = 1 << 22  # distances in memory at a time


def nearest_two(
    sites: Sites, rect: Rect, moved: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(first, second (h, w) int, how much farther the second is (h, w) px): sites by |p -
    s|^2 - weight.

    Of equal distances the lower number wins. moved (2, h, w) : displacement of the pixels,
    1/STEPS px"""
    y, x = np.mgrid[rect.y0 : rect.y1, rect.x0 : rect.x1] * float(STEPS)
    place = (np.stack([x, y]) + moved).reshape(2, -1)
    columns = (
        np.asarray(v, float)[:, None] for v in (sites.x, sites.y, sites.weight)
    )
    site_x, site_y, weight = columns
    parts = []
    for p in np.array_split(
        place, max(place.shape[1] * len(sites) // _AT_ONCE, 1), axis=1
    ):
        away = (p[0] - site_x) ** 2 + (p[1] - site_y) ** 2 - weight
        first, columns_ = away.argmin(0), np.arange(p.shape[1])
        nearest = away[first, columns_]
        away[first, columns_] = np.inf
        second = away.argmin(0) if len(sites) > 1 else first
        farther = np.sqrt(away[second, columns_]) - np.sqrt(nearest)
        parts.append((first, second, farther / STEPS))
    first, second, farther = (
        np.concatenate(c).reshape(x.shape) for c in zip(*parts, strict=True)
    )
    return first, second, farther


def displacement(wobble: Wobble, rect: Rect) -> np.ndarray:
    """(2, h, w) 1/STEPS px by which the pixels of `rect` are displaced."""
    n = wobble.positions.shape[0]
    own = np.arange(TILE) * STEPS - MIDDLE
    squares = wobble.positions.reshape(n, n, 2, TILE, TILE) - np.stack(
        np.meshgrid(own, own)
    )
    tile = squares.transpose(2, 0, 3, 1, 4).reshape(2, n * TILE, n * TILE)
    rows = np.arange(wobble.y + rect.y0, wobble.y + rect.y1) % tile.shape[1]
    columns = np.arange(wobble.x + rect.x0, wobble.x + rect.x1) % tile.shape[2]
    return np.asarray(tile[:, rows[:, None], columns], float)
