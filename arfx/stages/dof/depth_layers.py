"""A measured real scene in three layers: behind the focus, in it, before it. What a nearer one hides is filled in.

The layer in the focus is sharp, so neither of the others may spread into it; the one before the focus is spread over
both. What lies behind an edge is not in the picture; it is taken from beside the edge, nearest first (push-pull).
Leaves out: edges between things of one layer."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.numerics import divide
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.pyramid import SHARP_PX


@dataclass(frozen=True, eq=False)
class FrontLayer:
    """Something before the base. radius (h, w) px, -1 = not there;  colour (h, w, 3) premultiplied by coverage (h, w)"""

    radius: np.ndarray
    colour: np.ndarray
    coverage: np.ndarray


@dataclass(frozen=True, eq=False)
class DepthLayers:
    """base : (h, w, 3) colour of what is farthest, all over;  radius : (h, w) px of it;  fronts : farthest first"""

    base: np.ndarray
    radius: np.ndarray
    fronts: tuple[FrontLayer, ...]


def dioptre_of(depth_m: np.ndarray) -> np.ndarray:
    """(h, w) float32, 1/m; 0 where the depth is no distance."""
    with np.errstate(all="ignore"):
        known = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(known, divide(1.0, depth_m), 0.0).astype(np.float32)


def depth_layers(colour: np.ndarray, dioptre: np.ndarray, coc: CircleOfConfusion) -> DepthLayers:
    """colour : (h, w, 3) of the real scene, sharp;  dioptre : (h, w) float32, 1/m"""
    radius = coc.radius_px(dioptre).astype(np.float32)
    near = (radius > SHARP_PX) & (dioptre > coc.focus)
    far = (radius > SHARP_PX) & ~near
    sharp = ~(near | far)
    if far.all() or not far.any():
        base, base_radius = colour, (radius if far.any() else np.zeros_like(radius))
    else:
        filled = fill(np.dstack([colour, radius]), far)
        base, base_radius = np.ascontiguousarray(filled[..., :3]), np.ascontiguousarray(filled[..., 3])
    fronts = []
    if sharp.any():
        part = np.dstack([colour * sharp[..., None], sharp.astype(np.float32)])
        if near.any():
            part = fill(part, ~near)
        sharp_colour, coverage = np.ascontiguousarray(part[..., :3]), np.ascontiguousarray(part[..., 3])
        fronts.append(FrontLayer(np.where(coverage > 0, np.float32(0), np.float32(-1)), sharp_colour, coverage))
    if near.any():
        if not (far.any() or sharp.any()):
            return DepthLayers(colour, radius, ())
        coverage = near.astype(np.float32)
        fronts.append(FrontLayer(np.where(near, radius, np.float32(-1)), colour * coverage[..., None], coverage))
    return DepthLayers(base, base_radius, tuple(fronts))


def fill(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(h, w, 2 to 4) float32: where not `known`, the mean of known values around, as near ones as there are.

    Source: push-pull interpolation (Gortler et al. 1996) on halved pictures."""
    sums: list[tuple[np.ndarray, np.ndarray]]  # apart, as OpenCV resizes four channels at most
    sums = [(values * known[..., None], known.astype(np.float32))]
    while min(sums[-1][1].shape) > 1 and not (sums[-1][1] > 0).all():
        h, w = sums[-1][1].shape
        value, weight = (cv2.resize(a, (-(-w // 2), -(-h // 2)), interpolation=cv2.INTER_AREA) for a in sums[-1])
        sums.append((value, weight))
    out = _mean(*sums[-1])
    for value, weight in reversed(sums[1:-1]):
        up = _enlarged(out, weight)
        share = np.minimum(weight * 4, 1)[..., None]  # a quarter of a cell known is enough to go by it
        out = up + (_mean(value, weight) - up) * share
    return np.where(known[..., None], values, _enlarged(out, known))


def _enlarged(value: np.ndarray, to: np.ndarray) -> np.ndarray:
    return cv2.resize(value, to.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _mean(value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return divide(value, weight[..., None]).astype(np.float32)
