"""The formula `paper` (Zhao et al. 2012), for reproduction and comparison; its defects: docs/methods/dof.md#errata.

The composite, coded as sRGB, is mean-filtered; every pixel that has brighter neighbours among its eight takes their mean,
weighted by how much brighter they are (8), unless they belong to something nearer; the result is blended with the sharp
picture by a = C / max(C_near, C_far) (9), by two thirds of it inside the depth of field.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import cv2
import numba
import numpy as np

from arfx.core.colour import LUMA_COEFFICIENTS, SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide
from arfx.stages.dof.corrected import depth_range
from arfx.stages.dof.depth_layers import dioptre_of
from arfx.stages.dof.optics import Circles
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.surfaces import Real, plane_radius

INSIDE_SHARE = 2 / 3  # of the blend within the depth of field
_NEARER = 1.01  # a neighbour whose dioptre is larger by more than this factor stands in front


def reach_px(params: DofParams) -> int:
    return params.mean_px // 2 + 1


def render(now: Layers, facts: FrameFacts, real: Real, grid: np.ndarray, at: Circles, params: DofParams) -> np.ndarray:
    """IMAGE (h, w, 3) of a frame with a pose."""
    image = now[Layer.IMAGE]
    dioptre = dioptres(now, facts, real, grid)
    factor = blend_factor(dioptre, extremes(facts, real, grid, params), at, params)
    if params.scope == "virtual":
        factor = factor * (now[Layer.COVERAGE] > 0)
    coded = SRGB.encode(image).astype(np.float32)
    mean = cv2.blur(coded, (params.mean_px, params.mean_px), borderType=cv2.BORDER_REPLICATE)
    bright = bleed(mean, dioptre.astype(np.float32))
    out = SRGB.decode(coded + (bright - coded) * factor[..., None].astype(np.float32))
    return np.where(factor[..., None] > 0, out, image).astype(np.float32)


def dioptres(now: Layers, facts: FrameFacts, real: Real, grid: np.ndarray) -> np.ndarray:
    """(h, w) 1/m of the composite: the object's where it covers half a pixel or more, else the real scene's."""
    rect = now.rect
    out = np.full((rect.height, rect.width), real.background, np.float32)
    if real.tiles is not None:
        out = dioptre_of(now[Layer.REAL_DEPTH])
    if real.base is not None:  # a radius of 1 px a dioptre from a focus at infinity is the dioptre itself
        one, zero, most = np.float32(1), np.float32(0), np.float32(np.inf)
        plane_radius(
            out, 0, rect.height, 0, rect.width, rect.x0, rect.y0, real.base.dioptres(grid), np.float32(real.background),
            one, zero, most,
        )  # fmt: skip
    near, far = depth_range(facts)
    depth = np.clip(np.nan_to_num(now[Layer.DEPTH], nan=far, posinf=far), near, far)
    return np.where(now[Layer.COVERAGE] >= 0.5, divide(1.0, depth), out)


def extremes(facts: FrameFacts, real: Real, grid: np.ndarray, params: DofParams) -> tuple[float, float]:
    """Dioptres of the far and of the near clip plane."""
    low, high = real.dioptre_range(grid)
    if not facts.model_box.empty:
        near, far = depth_range(facts)
        low, high = min(low, 1 / far), max(high, 1 / near)
    return 1 / params.far_m if params.far_m > 0 else low, 1 / params.near_m if params.near_m > 0 else high


def blend_factor(dioptre: np.ndarray, clip: tuple[float, float], at: Circles, params: DofParams) -> np.ndarray:
    """a of Zhao et al. 2012, 0..1: the blur circle over the larger of those at the clip planes."""
    circle_mm = at.px_per_dioptre * at.coc_mm_per_px * np.abs(at.focus - dioptre)
    largest = at.px_per_dioptre * at.coc_mm_per_px * max(abs(at.focus - d) for d in clip)
    a = np.minimum(divide(circle_mm, largest), 1.0)
    return a * np.where(circle_mm <= params.coc_mm, INSIDE_SHARE, 1.0)


def bleed(colour: np.ndarray, dioptre: np.ndarray) -> np.ndarray:
    """(h, w, 3): mean of the brighter ones among a pixel's eight neighbours, weighted by the luma that they have more (8);
    the pixel itself where none is brighter. Neighbours that stand in front of the pixel do not count."""
    kr, kb = LUMA_COEFFICIENTS["bt601"]
    luma = colour @ np.array([kr, 1 - kr - kb, kb], np.float32)
    return _bleed(np.ascontiguousarray(colour, np.float32), luma.astype(np.float32), dioptre)


@numba.njit(cache=True, nogil=True)
def _bleed(colour, luma, dioptre):  # pragma: no cover - compiled
    h, w = luma.shape
    out = colour.copy()
    for y in range(h):
        for x in range(w):
            total, red, green, blue = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for j in range(max(y - 1, 0), min(y + 2, h)):
                for i in range(max(x - 1, 0), min(x + 2, w)):
                    more = luma[j, i] - luma[y, x]
                    if more <= 0 or dioptre[j, i] > dioptre[y, x] * _NEARER:
                        continue
                    total += more
                    red += more * colour[j, i, 0]
                    green += more * colour[j, i, 1]
                    blue += more * colour[j, i, 2]
            if total > 0:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = red / total, green / total, blue / total
    return out
