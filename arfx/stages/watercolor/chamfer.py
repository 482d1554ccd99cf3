"""Labels at the ends of the ladder: OpenCV's chamfer distance (draft), and float64 with a search tree (reference)."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from arfx.core.rect import Rect
from arfx.stages.watercolor.labels import SOLID, Labels, unlabelled
from arfx.stages.watercolor.reference import nearest_labels
from arfx.stages.watercolor.sites import STEPS, Sites

_BRUTE = 1 << 28  # sites x pixels up to which every pair is looked at
_TIES = 8


def chamfer_labels(sites: Sites, rect: Rect, borders: bool = False) -> Labels:
    """Approximate: sites in whole pixels, distances along a 5 x 5 mask, sites outside or still growing left out."""
    h, w = rect.height, rect.width
    x, y = (np.round(a / STEPS).astype(np.int64) - at for a, at in ((sites.x, rect.x0), (sites.y, rect.y0)))
    inside = np.flatnonzero((x >= 0) & (y >= 0) & (x < w) & (y < h) & (sites.weight > -STEPS * STEPS))
    if not len(inside):
        return unlabelled(h, w, max(len(sites), 1), borders)
    mask = np.ones((h, w), np.uint8)
    number = np.zeros((h, w), np.int32)
    mask[y[inside], x[inside]] = 0
    number[y[inside], x[inside]] = inside
    _, at = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(int(at.max()) + 1, np.int32)
    zeros = mask == 0
    of_label[at[zeros]] = number[zeros]
    first = of_label[at]
    if not borders:
        return Labels(first, np.zeros((0, 0), np.int32), np.zeros((0, 0), np.uint8), len(sites))
    return Labels(first, first, np.full((h, w), SOLID, np.uint8), len(sites))


def reference_labels(sites: Sites, rect: Rect, wobble: np.ndarray | None = None, blend_px: float = 0.0) -> Labels:
    """The same as labels.label, in float64 and by other means: every pair of site and pixel, or where those are too many
    a search tree (the weight as a third coordinate) whose nearest few are told apart exactly."""
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
        share = (d2 - d1) * (SOLID / (2 * blend_px * STEPS))
        near = (share < SOLID) & (second != first)
        solid = np.where(near, share, SOLID).astype(np.uint8)
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
