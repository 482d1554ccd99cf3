"""Composite: virtual over real, in linear light.

IMAGE = (b + (PLATE - b) x SHADOW) x (1 - COVERAGE) + VIRTUAL, faded by the facts' opacity.
b is what the camera adds where no light falls (the facts' bias): a shadow takes light, not
that.

Source: Porter and Duff 1984 ("over", premultiplied); shadow as a ratio,
docs/methods/light.md#shadow. Cost: O(pixels), memory
bound. One level: arithmetic, exact to rounding, so that its error is 0. Leaves out: depth
order against real objects (`hide`)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View


class Composite(Stage):
    name = "composite"

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(None, "something virtual is in view")

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        """The object's box and the shadow's."""
        now, facts = view.layers, view.facts
        drawn = now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE))
        rect = drawn.clip(facts.raster_box).union(now.extent(Layer.SHADOW))
        mixed = np.empty((rect.height, rect.width, 3), np.float32)
        if not rect.empty:
            here = now.crop(rect)
            layers = here[Layer.VIRTUAL], here[Layer.COVERAGE], here[Layer.SHADOW]
            opacity, bias = np.float32(facts.opacity), np.array(facts.bias_rgb, np.float32)
            over(here[Layer.PLATE], *layers, opacity, bias, mixed)
        return {Layer.IMAGE: Pixels(rect, mixed)}


# It takes differences, so that a pixel with nothing virtual keeps its exact value.


@numba.njit(cache=True, nogil=True, error_model="numpy")
def over(
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
