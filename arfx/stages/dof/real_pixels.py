"""The sharp real scene of a frame without the object, under its shadow: the plate but for a part of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.parallel import parallel_map
from arfx.core.pixels import Attenuated
from arfx.core.rect import Rect
from arfx.stages.composite import shade
from arfx.stages.dof.layer import strips
from arfx.stages.dof.spread import TILE_PX


class RealPixels(NamedTuple):
    """image : (h, w, 3);  patch : (bh, bw, 3) in its place within `box` = x0, y0, x1, y1, px from the picture's corner, whose
    borders are those of tiles (TILE_PX). All read-only, so that one kernel fits every frame."""

    image: np.ndarray
    patch: np.ndarray
    box: tuple[int, int, int, int]

    @staticmethod
    def of(now: Layers, facts: FrameFacts, parts: Sequence[Rect]) -> RealPixels:
        """Of a frame with a pose, where only `parts` of it are looked at. What is behind the object is made anew, and the
        shadow beside it, so that no picture with it is made: the rest is the plate's."""
        composite, plate = now.written[Layer.IMAGE], now.written[Layer.PLATE]
        light, model = composite.rest, facts.raster_box.clip(now.rect)
        if isinstance(light, Attenuated) and light.plate is plate:
            image, seen_through = plate.over(now.rect, parts), model.union(light.rect)
        else:
            image, seen_through = composite.over(now.rect, parts), model
            shaded = now.crop(now.extent(Layer.SHADOW))
            opacity, bias = np.float32(facts.opacity), np.array(facts.bias_rgb, np.float32)
            light = Attenuated(plate, shaded.rect, shaded[Layer.SHADOW], opacity, bias, shade)
        box = seen_through.align(TILE_PX, TILE_PX).clip(now.rect)
        patch = np.empty((box.height, box.width, 3), np.float32)
        parallel_map(
            lambda r: light(Rect(box.x0, box.y0 + r[0], box.x1, box.y0 + r[1]), patch[slice(*r)]),
            strips(box),
        )
        if facts.opacity < 1 and not model.empty:
            # what shows through an object that fades has no shadow where it is covered, as in the composite
            part, at, opacity = now.crop(model), model.slices_in(box), np.float32(facts.opacity)
            bare, covered = part[Layer.PLATE], part[Layer.COVERAGE][..., None]
            patch[at] = bare + (patch[at] - bare) * ((1 - covered) / (1 - opacity * covered))
        place = box.shift(-now.rect.x0, -now.rect.y0)
        return RealPixels(packed(image), packed(patch), (place.x0, place.y0, place.x1, place.y1))

    def with_all(self, real: np.ndarray) -> RealPixels:
        """Another real scene (h, w, 3) in every pixel."""
        return RealPixels(packed(real), packed(np.empty((0, 0, 3), np.float32)), (0, 0, 0, 0))

    @property
    def flat(self) -> RealPixels:
        """With colours along the rows, (h, 3 w)."""
        image, patch = (a.reshape(len(a), 3 * a.shape[1]) for a in (self.image, self.patch))
        return RealPixels(image, patch, self.box)

    def crop(self, part: Rect) -> np.ndarray:
        """A copy of the real scene in a part, px from the picture's corner."""
        out, box = self.image[part.slices].copy(), Rect(*self.box)
        both = box.clip(part)
        if not both.empty:
            out[both.slices_in(part)] = self.patch[both.slices_in(box)]
        return out
