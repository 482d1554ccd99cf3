"""Labels and means by other means than the kernels', in float64: every site asks every pixel, or a search tree finds the sites.
Slow; the yardstick for them, and the level reference."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from arfx.core.rect import Rect
from arfx.stages.watercolor.label_kernels import SOLID
from arfx.stages.watercolor.labels import Labels, unlabelled
from arfx.stages.watercolor.sites import STEPS, Sites

_BRUTE = 1 << 28  # sites x pixels up to which every pair is looked at
_TIES = 8
_AT_ONCE = 1 << 22  # distances in memory at a time


def nearest_labels(
    x_px: np.ndarray, y_px: np.ndarray, weight_px2: np.ndarray, px: np.ndarray, py: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(first, second) (n,) int32: of the sites (k,), the nearest to the positions (n,) and the next, by |p - s|^2 - weight.

    Of equal distances the lower number wins."""
    first, second = np.zeros(len(px), np.int32), np.zeros(len(px), np.int32)
    step = max(1, _AT_ONCE // max(len(x_px), 1))
    for a in range(0, len(px), step):
        part = slice(a, a + step)
        d = (px[part, None] - x_px) ** 2 + (py[part, None] - y_px) ** 2 - weight_px2
        first[part] = d.argmin(1)
        if len(x_px) > 1:
            d[np.arange(len(d)), first[part]] = np.inf
            second[part] = d.argmin(1)
        else:
            second[part] = first[part]
    return first, second


def reference_labels(sites: Sites, rect: Rect, wobble: np.ndarray | None = None, blend_px: float = 0.0) -> Labels:
    """The same as labels.label, in float64 and by other means: every pair of site and pixel, or where those are too many
    a search tree (the weight as a third coordinate) whose nearest few are compared exactly."""
    h, w = rect.height, rect.width
    if not len(sites):
        return unlabelled(h, w, 1, blend_px > 0)
    x, y, weight = (np.asarray(a, float) for a in (sites.x, sites.y, sites.weight))
    py, px = np.mgrid[rect.y0 : rect.y1, rect.x0 : rect.x1].astype(float) * STEPS
    if wobble is not None and wobble.size:
        px, py = px + wobble[0], py + wobble[1]
    px, py = px.ravel(), py.ravel()
    if len(sites) * px.size <= _BRUTE:
        first, second = nearest_labels(x, y, weight, px, py)
    else:
        first, second = _by_tree(x, y, weight, px, py)
    if blend_px > 0:
        d1, d2 = (np.sqrt((px - x[k]) ** 2 + (py - y[k]) ** 2 - weight[k]) for k in (first, second))
        inset = (d2 - d1) * (SOLID / (2 * blend_px * STEPS))
        near = (inset < SOLID) & (second != first)
        solid = np.where(near, inset, SOLID).astype(np.uint8)
        second = np.where(solid < SOLID, second, first)
    else:
        return Labels(first.reshape(h, w), np.zeros((0, 0), np.int32), np.zeros((0, 0), np.uint8), len(sites))
    return Labels(first.reshape(h, w), second.reshape(h, w), solid.reshape(h, w), len(sites))


def _by_tree(x: np.ndarray, y: np.ndarray, weight: np.ndarray, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k = min(_TIES, len(x))
    tree = cKDTree(np.stack([x, y, np.sqrt(-weight)], -1))
    _, near = tree.query(np.stack([px, py, np.zeros_like(px)], -1), k=k)
    near = np.sort(near.reshape(len(px), k), axis=1)
    d = (px[:, None] - x[near]) ** 2 + (py[:, None] - y[near]) ** 2 - weight[near]
    rows = np.arange(len(px))
    best = d.argmin(1)
    d[rows, best] = np.inf
    other = d.argmin(1) if k > 1 else best
    return near[rows, best].astype(np.int32), near[rows, other].astype(np.int32)
