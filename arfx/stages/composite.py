"""Composite: virtual over real, in linear light.

IMAGE = (b + (PLATE - b) x SHADOW) x (1 - COVERAGE) + VIRTUAL, faded by the facts' opacity.
b is what the camera adds where no light falls (the facts' bias): a shadow takes light, not
that.

Source: Porter and Duff 1984 ("over", premultiplied); shadow as a ratio,
docs/methods/light.md#shadow. Cost: O(pixels), memory
bound. One level: arithmetic, exact to rounding, so that its error is 0. Leaves out: depth
order against real objects (`hide`)."""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, packed
from arfx.core.pixels import Pixels, bands
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View


class Composite(Stage):
    name = "composite"

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(None, "something virtual is in view")

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        """The object's box and the shadow, together."""
        now, facts = view.layers, view.facts
        drawn = now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE))
        box = drawn.clip(facts.raster_box)
        shaded = now.crop(now.extent(Layer.SHADOW).union(box))
        opacity, bias = (
            np.float32(facts.opacity),
            np.array(facts.bias_rgb, np.float32),
        )
        image = np.empty((shaded.rect.height, shaded.rect.width, 3), np.float32)
        shadow = shaded[Layer.SHADOW]
        # by bands, so that the plate's pixels are used while they are in the cache
        for band in bands(shaded.rect):
            part = band.slices_in(shaded.rect)
            shade(
                now.crop(band)[Layer.PLATE], shadow[part], opacity, bias, image[part]
            )
        if not box.empty:
            over = now.crop(box)
            _over(
                over[Layer.PLATE],
                over[Layer.VIRTUAL],
                over[Layer.COVERAGE],
                over[Layer.SHADOW],
                opacity,
                bias,
                image[box.slices_in(shaded.rect)],
            )
        return {Layer.IMAGE: Pixels(shaded.rect, image)}


# Both take differences, so that a pixel with nothing virtual keeps its exact value.


def shade(
    plate: ndarray,
    shadow: ndarray,
    opacity: np.float32,
    bias: ndarray,
    out: ndarray,
) -> None:
    """The plane's pixels without an object before it: the same as `_over` with coverage 0.

    plate, out : (h, w, 3), the last with its rows end to end;  shadow : (h, w, 3), or (h, w, 1)"""
    lines = len(plate), 3 * plate.shape[1]
    shadow = np.broadcast_to(shadow, plate.shape)
    old, left = (packed(a).reshape(lines) for a in (plate, shadow))
    _shade(old, left, opacity, np.tile(bias, plate.shape[1]), out.reshape(lines))


@kernel(error_model="numpy")
def _shade(plate, shadow, opacity, bias, out):  # pragma: no cover - compiled
    """out, plate, shadow : (h, 3 w) lines of pixels;  bias : (3 w,)"""
    one = np.float32(1)
    for y in range(plate.shape[0]):
        for k in range(plate.shape[1]):
            dim = shadow[y, k] - one
            out[y, k] = plate[y, k] + opacity * (plate[y, k] * dim - bias[k] * dim)


@kernel(error_model="numpy")
def _over(
    plate, virtual, coverage, shadow, opacity, bias, out
):  # pragma: no cover - compiled
    for y in range(plate.shape[0]):
        for x in range(plate.shape[1]):
            transmittance = np.float32(1) - coverage[y, x]
            for c in range(3):
                p, left = plate[y, x, c], shadow[y, x, c] * transmittance
                kept = bias[c] * (transmittance - left)
                out[y, x, c] = p + opacity * (
                    virtual[y, x, c] + p * (left - np.float32(1)) + kept
                )
