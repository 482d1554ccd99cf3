"""The corrected formula: layers of light, each spread over its blur circles, laid over one
another.

Two layers make the silhouette of the virtual object exact: behind it is the clean plate with the
shadow, as the composite has it, so what a blurred edge lets through is known."""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import replace

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.layers import LightLayer
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.scatter import Accuracy, scattered

LEVELS = {
    "draft": Accuracy(ratio=2.0, step_px=1.41, fine_px=0.0, cells=3.0),
    "standard": Accuracy(ratio=1.3, step_px=0.5, fine_px=2.2, cells=5.4),
}
_SHARP_PX2 = np.float32(SHARP_PX**2)
_WHITE_FROM = 0.9  # linear light; a pixel is clipped to the degree that it lies between this and 1


def blurred(
    image: ndarray,
    layers: list[LightLayer],
    out: Rect,
    accuracy: Accuracy,
    params: DofParams,
) -> ndarray:
    """(h, w, 3) of the rows of `out`, as wide as the first layer.

    image : (h, w, 3) the composite over the first layer's rectangle, kept where no light is spread
        to
    layers : farthest first, the first without holes"""
    base, rect = layers[0], layers[0].rect
    clipped = replace(base, light=boosted(base.light, params.highlight_boost))
    lens = accuracy, params.blades, params.blade_turn_deg
    spread = [
        scattered(layer.light, layer.radius, (layer.rect.x0, layer.rect.y0), *lens)
        for layer in (clipped, *layers[1:])
    ]
    result = np.zeros((out.height, rect.width, 3), np.float32)

    def finish(top: int, bottom: int) -> None:
        band = Rect(rect.x0, out.y0 + top, rect.x1, out.y0 + bottom)
        to = result[top:bottom]
        touched = np.zeros(to.shape[:2], np.uint8)
        for layer, light in zip(layers, spread, strict=True):
            part = layer.rect.clip(band)
            if not part.empty:
                at, rows = part.slices_in(band), part.slices_in(layer.rect)[0]
                own = light[rows], layer.light[rows], layer.radius[rows]
                lay_over(to[at], touched[at], *own, accuracy.sharp_px2)
        cv2.copyTo(image[band.slices_in(rect)], 1 - touched, to)

    parallel_rows(finish, out.height)
    return result


def boosted(light: ndarray, boost: float) -> ndarray:
    """Clipped pixels brighter. light : (h, w, 4)"""
    if boost <= 0:
        return light
    clipped = np.clip(
        (light[..., :3].max(-1) - _WHITE_FROM) / (1 - _WHITE_FROM), 0, 1
    )
    factor = 1 + np.float32(boost) * clipped
    return np.dstack([light[..., :3] * factor[..., None], light[..., 3]])


@line_kernel(fastmath=FAST)
def lay_over(
    out, touched, spread, light, radius, sharp_px2
):  # pragma: no cover - compiled
    """out (h, w, 3) under a layer before it; touched (h, w) = 1 where light of it was spread to.

    spread (h, w, c) : that light;  light (h, w, c) : before it was spread, from pixels of radius.
    Of 5 channels the last is the weight of what the layer lets through"""
    zero = np.float32(0)
    one = np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            # fraction of a pixel's light that is not spread
            share = (sharp_px2 - radius[y, x] * radius[y, x]) / (
                sharp_px2 - _SHARP_PX2
            )
            share = min(max(share, zero), one)
            weight = spread[y, x, 3] + share * light[y, x, 3]
            if weight > zero:
                total = weight
                for c in range(4, light.shape[2]):
                    total += spread[y, x, c] + share * light[y, x, c]
                inverse = one / total
                rest = max(one - weight * inverse, zero)
                if spread[y, x, 3] > zero:
                    touched[y, x] = 1
                for c in range(3):
                    own = (spread[y, x, c] + share * light[y, x, c]) * inverse
                    out[y, x, c] = out[y, x, c] * rest + own
