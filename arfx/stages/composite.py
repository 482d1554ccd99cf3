"""Composite: virtual over real, in linear light.

IMAGE = (b + (PLATE - b) x SHADOW) x (1 - COVERAGE) + VIRTUAL, faded by the facts' opacity. b is what the camera adds
where no light falls (the facts' bias): a shadow takes light, not that.

Source: Porter and Duff 1984 ("over", premultiplied); shadow as a ratio, docs/methods/light.md#shadow. Cost: O(pixels), memory
bound. One level: arithmetic, exact to rounding, so that its error is 0. Leaves out: depth order against real objects (`hide`)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.pixels import Attenuated, Pixels
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View


class Composite(Stage):
    name = "composite"
    reads = frozenset({Layer.PLATE, Layer.IMAGE, Layer.VIRTUAL, Layer.COVERAGE, Layer.SHADOW})
    writes = frozenset({Layer.IMAGE})
    always = True

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(frame, "something virtual is in view", within_earlier=True)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        """The object's box; the shadow beside it is worked out only where a later stage asks for it."""
        now, facts = view.layers, view.facts
        box = now.crop(now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE)).clip(facts.raster_box))
        shaded, plate = now.crop(now.extent(Layer.SHADOW)), now.written[Layer.PLATE]
        opacity, bias = np.float32(facts.opacity), np.array(facts.bias_rgb, np.float32)
        mixed = np.empty((box.rect.height, box.rect.width, 3), np.float32)
        if not box.rect.empty:
            virtual, transmittance = box[Layer.VIRTUAL], box.one_channel(Layer.SHADOW)
            _over(box[Layer.PLATE], virtual, box[Layer.COVERAGE], transmittance, opacity, bias, mixed)
        rest = Attenuated(plate, shaded.rect, shaded.one_channel(Layer.SHADOW), opacity, bias, shade)
        return {Layer.IMAGE: Pixels(now.rect, mixed, rest, box.rect)}


# Both take differences, so that a pixel with nothing virtual keeps its exact value.


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shade(plate, shadow, opacity, bias, out):  # pragma: no cover - compiled
    """The plane's pixels without an object before it: the same as `_over` with coverage 0. shadow : (h, w, 3 or 1)"""
    width, one, single = 3 * plate.shape[1], np.float32(1), shadow.shape[2] == 1
    line, transmittance, below = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for k in range(width):
        below[k] = bias[k % 3]
    for y in range(plate.shape[0]):
        for x in range(plate.shape[1]):
            for c in range(3):
                line[3 * x + c], transmittance[3 * x + c] = plate[y, x, c], shadow[y, x, 0 if single else c]
        for k in range(width):
            line[k] += opacity * (line[k] * (transmittance[k] - one) + below[k] * (one - transmittance[k]))
        for x in range(plate.shape[1]):
            for c in range(3):
                out[y, x, c] = line[3 * x + c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _over(plate, virtual, coverage, shadow, opacity, bias, out):  # pragma: no cover - compiled
    """shadow : (h, w, 3 or 1)"""
    step = 1 if shadow.shape[2] == 3 else 0
    for y in range(plate.shape[0]):
        for x in range(plate.shape[1]):
            transmittance = np.float32(1) - coverage[y, x]
            for c in range(3):
                p = plate[y, x, c]
                kept = bias[c] * (transmittance - shadow[y, x, c * step] * transmittance)
                dim = shadow[y, x, c * step] * transmittance - np.float32(1)
                out[y, x, c] = p + opacity * (virtual[y, x, c] + p * dim + kept)
