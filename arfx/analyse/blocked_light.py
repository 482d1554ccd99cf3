"""Real shadow on the anchor's print: told by the quarters of its paper, so that the object's shadow is not taken twice there.

Quarters are compared with the brightest one, which is taken for lit: a shadow over the whole print cannot be told from less
light, and counts as that. Cost: nothing beside the photometry. Source: SYSTEMS.md S1, shadow as a ratio.
"""

from __future__ import annotations

import numpy as np

from arfx.analyse.photometry import PATCHES, Patches
from arfx.core.numerics import divide

LEAST_LEFT = 0.7  # of the brightest quarter's light; above it vignetting, a near lamp or gloss may be the reason


def quarters(patches: Patches, bias: np.ndarray) -> np.ndarray:
    """(4,) light of the paper in the print's quarters (top left, top right, bottom left, bottom right), NaN = not seen."""
    white = slice(PATCHES // 2, PATCHES)
    light = (patches.mean[white] - bias).mean(-1)
    return np.where(patches.count[white] > 0, light, np.nan)


def already_blocked(light: np.ndarray, size_m: float) -> dict | None:
    """The anchor's `already_blocked` (stages/lightmap/blocked.py), or None where no quarter is clearly darker.

    light : (4,) of `quarters`;  size_m : side of the print. Anchor axes: x right, y up.
    """
    if not np.isfinite(light).all() or not (light > 0).any():
        return None
    ratio = divide(light, light.max())
    if ratio.min() > LEAST_LEFT:
        return None
    top_left, top_right, bottom_left, bottom_right = (float(r) for r in np.clip(ratio, 0, 1))
    half = size_m / 2
    return {"box_m": [-half, -half, half, half], "ratio": [[bottom_left, bottom_right], [top_left, top_right]]}
