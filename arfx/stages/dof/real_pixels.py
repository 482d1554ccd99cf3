"""The sharp real scene of a frame without the object, under its shadow: the composite's own pixels but for a part of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.stages.composite import shade
from arfx.stages.dof.layer import strips
from arfx.stages.dof.spread import TILE_PX


class RealPixels(NamedTuple):
    """image : (h, w, 3) of the composite;  patch : (bh, bw, 3), the real scene within `box` = x0, y0, x1, y1, px from the
    picture's corner, whose borders are those of tiles (TILE_PX). All read-only, so that one kernel fits every frame."""

    image: np.ndarray
    patch: np.ndarray
    box: tuple[int, int, int, int]

    @staticmethod
    def of(now: Layers, facts: FrameFacts, parts: Sequence[Rect]) -> RealPixels:
        """Of a frame with a pose, where only `parts` of it are looked at. Within the object's box what is behind is made anew."""
        box = facts.raster_box.align(TILE_PX, TILE_PX).clip(now.rect)
        part, bias = now.crop(box), np.array(facts.bias_rgb, np.float32)
        patch = np.empty((0, 0, 3), np.float32)
        if not box.empty:
            plate, shadow, opacity = part[Layer.PLATE], part.one_channel(Layer.SHADOW), np.float32(facts.opacity)
            patch = np.empty(plate.shape, np.float32)

            def fill(strip: tuple[int, int]) -> None:
                shade(plate[slice(*strip)], shadow[slice(*strip)], opacity, bias, patch[slice(*strip)])

            parallel_map(fill, strips(box))
            if opacity < 1:  # what shows through an object that fades has no shadow where it is covered, as in the composite
                covered = part[Layer.COVERAGE][..., None]
                patch = plate + (patch - plate) * ((1 - covered) / (1 - opacity * covered))
            box = box.shift(-now.rect.x0, -now.rect.y0)
        image = now.written[Layer.IMAGE].over(now.rect, parts)
        return RealPixels(packed(image), packed(patch), (box.x0, box.y0, box.x1, box.y1))

    def with_all(self, real: np.ndarray) -> RealPixels:
        """Another real scene (h, w, 3) in every pixel."""
        return RealPixels(self.image, packed(real), (0, 0, real.shape[1], real.shape[0]))

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
