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
        box = now.crop(
            now.extent(Layer.VIRTUAL).union(now.extent(Layer.COVERAGE)).clip(facts.raster_box)
        )
        shaded, plate = now.crop(now.extent(Layer.SHADOW)), now.written[Layer.PLATE]
        opacity, bias = np.float32(facts.opacity), np.array(facts.bias_rgb, np.float32)
        mixed = np.empty((box.rect.height, box.rect.width, 3), np.float32)
        if not box.rect.empty:
            virtual, transmittance = box[Layer.VIRTUAL], box.one_channel(Layer.SHADOW)
            _over(
                box[Layer.PLATE], virtual, box[Layer.COVERAGE], transmittance, opacity, bias, mixed
            )
        rest = Attenuated(
            plate, shaded.rect, shaded.one_channel(Layer.SHADOW), opacity, bias, shade
        )
        return {Layer.IMAGE: Pixels(now.rect, mixed, rest, box.rect)}


# Both take differences, so that a pixel with nothing virtual keeps its exact value.


def shade(
    plate: np.ndarray, shadow: np.ndarray, opacity: np.float32, bias: np.ndarray, out: np.ndarray
) -> None:
    """The plane's pixels without an object before it: the same as `_over` with coverage 0. shadow : (h, w, 3 or 1)"""
    if plate.size:
        _shade(
            *_lines(plate),
            *_lines(shadow),
            shadow.shape[2] == 1,
            opacity,
            bias,
            *_lines(out),
            plate.shape[1],
        )


def _lines(a: np.ndarray) -> tuple[np.ndarray, int]:
    """(a view (n,) of all from the first pixel to the last, numbers from a row to the next): loops along it are vector code."""
    h, w, c = a.shape
    if a.strides[1] != 4 * c or (c > 1 and a.strides[2] != 4):
        a = np.ascontiguousarray(a)
    return np.lib.stride_tricks.as_strided(
        a, ((h - 1) * (a.strides[0] // 4) + w * c,), (4,)
    ), a.strides[0] // 4


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shade(
    plate, plate_step, shadow, shadow_step, single, opacity, bias, out, out_step, width
):  # pragma: no cover - compiled
    n, one = 3 * width, np.float32(1)
    below, thrice = np.empty(n, np.float32), np.empty(n, np.float32)
    for k in range(n):
        below[k] = bias[k % 3]
    for y in range((out.shape[0] - n) // out_step + 1):
        line, to = plate[y * plate_step : y * plate_step + n], out[y * out_step : y * out_step + n]
        if single:
            row = shadow[y * shadow_step : y * shadow_step + width]
            for x in range(width):
                i = np.uintp(3) * np.uintp(x)
                thrice[i], thrice[i + np.uintp(1)], thrice[i + np.uintp(2)] = row[x], row[x], row[x]
        else:
            thrice[:] = shadow[y * shadow_step : y * shadow_step + n]
        for k in range(n):
            to[k] = line[k] + opacity * (line[k] * (thrice[k] - one) + below[k] * (one - thrice[k]))


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
