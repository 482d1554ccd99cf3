"""Composite: virtual over real, in linear light.

IMAGE = (b + (PLATE - b) x SHADOW) x (1 - COVERAGE) + VIRTUAL, faded by the facts' opacity. b is what the camera adds
where no light falls (the facts' bias): a shadow takes light, not that.

Source: Porter and Duff 1984 ("over", premultiplied); shadow as a ratio, docs/methods/light.md#shadow. Cost: O(pixels), memory
bound. Leaves out: depth order against real objects (stage `hide`).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Dimmed, Layer, Layers, Patch
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

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray | Dimmed]:
        now, facts = view.layers, view.facts
        if view.last:  # beside the object nothing is mixed: the light alone is less
            part = now.crop(now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE)).clip(facts.drawn_box))
            dark = now.crop(now.extent(Layer.SHADOW))
            over = Patch(part.rect, _composed(part, facts) if not part.rect.empty else np.empty((0, 0, 3), np.float32))
            return {Layer.IMAGE: Dimmed(over, dark.rect, dark.one_channel(Layer.SHADOW), facts.opacity, np.array(facts.bias_rgb))}
        return {Layer.IMAGE: _composed(now, facts)}


def _composed(now: Layers, facts: FrameFacts) -> np.ndarray:
    virtual = now.crop(now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE)))
    opacity, bias = np.float32(facts.opacity), np.array(facts.bias_rgb, np.float32)
    plate = now[Layer.PLATE]
    out = np.empty_like(plate)
    if virtual.rect != now.rect:
        shadow = now[Layer.SHADOW]
        _shade(plate.reshape(len(plate), -1), shadow.reshape(len(plate), -1), opacity, bias, out.reshape(len(plate), -1))
    if not virtual.rect.empty:
        inside = virtual.rect.slices_in(now.rect)
        left = virtual.one_channel(Layer.SHADOW)
        _over(plate[inside], virtual[Layer.VIRTUAL], virtual[Layer.COVERAGE], left, opacity, bias, out[inside])
    return out


# Both take differences, so that a pixel with nothing virtual keeps its exact value.


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shade(plate, shadow, opacity, bias, out):  # pragma: no cover - compiled
    """The plane's pixels without an object before it: the same as `_over` with coverage 0. Lines of 3 x width values."""
    below = np.empty(plate.shape[1], np.float32)
    for k in range(plate.shape[1]):
        below[k] = bias[k % 3]
    one = np.float32(1)
    for y in range(plate.shape[0]):
        for k in range(plate.shape[1]):
            p, left = plate[y, k], shadow[y, k]
            out[y, k] = p + opacity * (p * (left - one) + below[k] * (one - left))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _over(plate, virtual, coverage, shadow, opacity, bias, out):  # pragma: no cover - compiled
    """shadow : (h, w, 3 or 1)"""
    step = 1 if shadow.shape[2] == 3 else 0
    for y in range(plate.shape[0]):
        for x in range(plate.shape[1]):
            left = np.float32(1) - coverage[y, x]
            for c in range(3):
                p = plate[y, x, c]
                kept = bias[c] * (left - shadow[y, x, c * step] * left)
                out[y, x, c] = p + opacity * (virtual[y, x, c] + p * (shadow[y, x, c * step] * left - np.float32(1)) + kept)
