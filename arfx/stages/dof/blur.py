"""The corrected formula: layers of light, each spread over its blur circles, laid over one
another."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.stages.dof.compositing import lay_over
from arfx.stages.dof.layers import LightLayer
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.scatter import BAND_PX, Accuracy, Scatter

LEVELS = {
    "draft": Accuracy(ratio=2.0, step_px=1.41, fine_px=0.0, cells=3.0),
    "standard": Accuracy(ratio=1.3, step_px=0.5, fine_px=2.2, cells=5.4),
}
_WHITE_FROM = (
    0.9  # linear light; a pixel is clipped to the degree that it lies between this and 1
)


def blurred(
    image: np.ndarray,
    layers: list[LightLayer],
    out: Rect,
    accuracy: Accuracy,
    params: DofParams,
) -> np.ndarray:
    """(h, w, 3) of the rows of `out`, as wide as the first layer.

    image : (h, w, 3) the composite over the first layer's rectangle, kept where no light is spread
        to
    layers : farthest first, the first without holes"""
    base, rect = layers[0], layers[0].rect
    boosted = replace(base, light=_boosted(base.light, params.highlight_boost))
    spread = [_scatter(layer, accuracy, params) for layer in (boosted, *layers[1:])]
    result = np.zeros((out.height, rect.width, 3), np.float32)

    def finish(top: int) -> None:
        band = Rect(rect.x0, top, rect.x1, min(top + BAND_PX, out.y1))
        to = result[top - out.y0 : band.y1 - out.y0]
        touched = np.zeros((band.height, rect.width), np.uint8)
        parts = [layer.rect.clip(band) for layer in layers]
        for layer, light, part in zip(layers, spread, parts, strict=True):
            if not part.empty:
                first, last = part.y0 - layer.rect.y0, part.y1 - layer.rect.y0
                at = part.slices_in(band)
                own = layer.light[first:last], layer.radius[first:last]
                around = light.rows(first, last)
                lay_over(to[at], touched[at], around, *own, accuracy.sharp_px2)
        cv2.copyTo(image[band.slices_in(rect)], 1 - touched, to)

    parallel_map(finish, list(range(out.y0, out.y1, BAND_PX)))
    return result


def _scatter(layer: LightLayer, accuracy: Accuracy, params: DofParams) -> Scatter:
    corner = layer.rect.x0, layer.rect.y0
    lens = params.blades, params.blade_turn_deg
    return Scatter(layer.light, layer.radius, corner, accuracy, *lens)


def _boosted(light: np.ndarray, boost: float) -> np.ndarray:
    """Clipped pixels brighter. light : (h, w, 4)"""
    if boost <= 0:
        return light
    clipped = np.clip((light[..., :3].max(-1) - _WHITE_FROM) / (1 - _WHITE_FROM), 0, 1)
    factor = 1 + np.float32(boost) * clipped
    return np.dstack([light[..., :3] * factor[..., None], light[..., 3]])
