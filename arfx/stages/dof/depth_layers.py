"""A measured real scene in three layers: behind the focus, in it, before it. What a nearer one
hides is filled in.

The layer in the focus is sharp, so neither of the others may spread into it; the one before the
focus is spread over both. What lies behind an edge is not in the picture; it is taken from beside
the edge, nearest first. Leaves out: edges between things of one layer."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.push_pull import fill_unknown


def dioptre_of(depth_m: ndarray) -> ndarray:
    """(h, w) float32, 1/m; 0 where the depth is no distance."""
    with np.errstate(all="ignore"):
        known = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(known, divide(1.0, depth_m), 0.0).astype(np.float32)


def depth_layers(
    light: ndarray, dioptre: ndarray, coc: CircleOfConfusion
) -> list[tuple[ndarray, ndarray]]:
    """Layers of the real scene, farthest first, the first without holes.

    light : (h, w, 4) of the scene, sharp, coverage 1;  dioptre : (h, w) float32, 1/m

    Returns of each light (h, w, 4), premultiplied by its coverage, and radius (h, w) px, of which
    only what is covered counts."""
    radius = coc.radius_px(dioptre)
    blurred = radius > SHARP_PX
    near = blurred & (dioptre > coc.focus)
    far = blurred & ~near
    out = [_without_holes(light, radius, far)] if far.any() else []
    if not blurred.all():
        sharp = _part(light, ~blurred)
        if near.any():
            sharp = fill_unknown(sharp, ~near)
        out.append((sharp, np.zeros_like(radius)))
    if near.any():
        out.append((_part(light, near), radius))
    return out


def _part(light: ndarray, where: ndarray) -> ndarray:
    return cv2.copyTo(light, where.view(np.uint8), np.zeros_like(light))


def _without_holes(
    light: ndarray, radius: ndarray, known: ndarray
) -> tuple[ndarray, ndarray]:
    if known.all():
        return light, radius
    values = light.copy()
    cv2.insertChannel(radius, values, 3)
    filled = fill_unknown(values, known)
    radius = cv2.extractChannel(filled, 3)
    cv2.insertChannel(np.ones_like(radius), filled, 3)
    return filled, radius
