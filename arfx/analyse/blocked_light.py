"""Real shadow on the anchor's print: told by the quarters of its paper, so that the object's shadow is not taken twice there.

Quarters are compared with the brightest one, which is taken for lit: a shadow over the whole print cannot be told from less
light, and counts as that. Cost: nothing beside the photometry. Source: SYSTEMS.md S1, shadow as a ratio.
"""

from __future__ import annotations

import numpy as np

from arfx.analyse.photometry import PATCHES
from arfx.core.numerics import divide

LEAST_LEFT = 0.7  # of the brightest quarter's light; above it vignetting, a near lamp or gloss may be the reason


def quarters(mean: np.ndarray, count: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """(..., 4) light of the paper in the print's quarters (top left, top right, bottom left, bottom right), NaN = not seen.

    mean (..., 8, 3), count (..., 8) : of Patches
    """
    white = slice(PATCHES // 2, PATCHES)
    light = (mean[..., white, :] - bias).mean(-1)
    return np.where(count[..., white] > 0, light, np.nan)


def clearly_blocked(light: np.ndarray) -> np.ndarray:
    """(...) whether a quarter is clearly darker than the brightest one. light : (..., 4) of `quarters`"""
    known = np.where(np.isfinite(light), light, np.inf)
    low, high = known.min(-1), np.where(np.isfinite(light), light, -np.inf).max(-1)
    return np.isfinite(light).all(-1) & (high > 0) & (low <= LEAST_LEFT * high)


def already_blocked(light: np.ndarray, size_m: float) -> dict | None:
    """The anchor's `already_blocked` (stages/lightmap/blocked.py), or None where no quarter is clearly darker.

    light : (4,) of `quarters`;  size_m : side of the print. Anchor axes: x right, y up.
    """
    if not clearly_blocked(light):
        return None
    ratio = divide(light, light.max())
    top_left, top_right, bottom_left, bottom_right = (float(r) for r in np.clip(ratio, 0, 1))
    half = size_m / 2
    return {"box_m": [-half, -half, half, half], "ratio": [[bottom_left, bottom_right], [top_left, top_right]]}
