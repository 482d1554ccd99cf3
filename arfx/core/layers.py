"""Named image layers of one frame, all over the same rectangle: the G-buffer and the composite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy import ndarray

from arfx.core.pixels import Pixels, Plate
from arfx.core.rect import EMPTY, Rect


class Layer(StrEnum):
    """Layer names. Arrays are float32 unless stated; colours are linear RGB, scene
    referred, 1 = paper white.
    """

    PLATE = "plate"  # (h, w, 3) the real frame; never changed
    IMAGE = "image"  # (h, w, 3) the composite so far
    VIRTUAL = "virtual"  # (h, w, 3) shaded virtual object, premultiplied by COVERAGE
    # (h, w) fraction of the pixel that the virtual object covers, 0..1
    COVERAGE = "coverage"
    # (h, w) metres along the optical axis of the nearest virtual surface; inf = none
    DEPTH = "depth"
    NORMAL = "normal"  # (h, w, 3) unit, WORLD frame, towards the camera; zero = none
    # (h, w, 3) metres, WORLD frame, of the nearest virtual surface; zero = none
    POSITION = "position"
    ALBEDO = "albedo"  # (h, w, 3) base colour, not premultiplied
    # (h, w, 4) metallic, roughness, specular (dielectric F0 / 0.08), alpha
    MATERIAL = "material"
    EMISSIVE = "emissive"  # (h, w, 3) emitted radiance
    # (h, w) share of the soft light that the material's own picture leaves, 1 = all
    OCCLUSION = "occlusion"
    COAT = "coat"  # (h, w, 2) clear coat: how much, 0..1; roughness
    SHEEN = "sheen"  # (h, w, 4) colour of fibres, 0 = none; roughness
    # (h, w, 3) unit, WORLD frame, of the surface without its normal map; zero = none
    SMOOTH_NORMAL = "smooth_normal"
    OBJECT_ID = "object_id"  # (h, w) int32, 0 = none, else 1 + part index
    # (h, w, 3) transmittance: ratio of light that still reaches the real surface, 1 = all
    SHADOW = "shadow"
    # (h, w) metres along the axis of the real surface, measured; inf = the job has no depth
    REAL_DEPTH = "real_depth"


# Layers of one number a pixel, and those of another number of channels than three.
_SINGLE = {
    Layer.COVERAGE,
    Layer.DEPTH,
    Layer.OBJECT_ID,
    Layer.OCCLUSION,
    Layer.REAL_DEPTH,
}
_CHANNELS = {Layer.MATERIAL: 4, Layer.COAT: 2, Layer.SHEEN: 4}
# Values other than 0 where no stage has written: nothing virtual, no shadow.
_FAR, _ALL = (Layer.DEPTH, Layer.REAL_DEPTH), (Layer.OCCLUSION, Layer.SHADOW)
_VALUES = dict.fromkeys(_FAR, np.inf) | dict.fromkeys(_ALL, 1.0)


def neutral(name: Layer, rect: Rect) -> ndarray:
    """A new array over `rect` as if nothing virtual were there.

    PLATE and IMAGE have no neutral value: KeyError.
    """
    if name in (Layer.PLATE, Layer.IMAGE):
        raise KeyError(name)
    channels = () if name in _SINGLE else (_CHANNELS.get(name, 3),)
    kind = np.int32 if name is Layer.OBJECT_ID else np.float32
    out = np.zeros((rect.height, rect.width, *channels), kind)
    if value := _VALUES.get(name):  # zeros are several times as fast
        out.fill(value)
    return out


def packed(array: ndarray) -> ndarray:
    """The array read-only and with its rows end to end, a copy where they are not: the form
    that kernels are compiled for.
    """
    out = np.ascontiguousarray(array).view()
    out.setflags(write=False)
    return out


@dataclass(frozen=True)
class Layers:
    """Layers seen over one rectangle, read-only: each as it was written, neutral where
    nothing has written it, IMAGE as the plate.
    written : what stages wrote so far, and the plate
    A layer's neutral pixels are made when it is asked for, so cropping first costs nothing
    for what is cut off."""

    rect: Rect
    written: Mapping[Layer, Pixels | Plate] = field(default_factory=dict)

    def __getitem__(self, name: Layer) -> ndarray:
        """(h, w, ...) over `rect`. Raises KeyError for PLATE where it does not cover
        `rect`, and for IMAGE where neither does, as they have no neutral value."""
        held = self.written.get(name)
        if held is not None and held.rect.contains(self.rect):
            seen = held.part(self.rect).view()
        elif name is Layer.IMAGE and held is None:
            return self[Layer.PLATE]
        else:
            seen = (
                self[Layer.PLATE].copy()
                if name is Layer.IMAGE
                else neutral(name, self.rect)
            )
            if held is not None and not (both := held.rect.clip(self.rect)).empty:
                seen[both.slices_in(self.rect)] = held.part(both)
        seen.setflags(write=False)
        return seen

    def extent(self, name: Layer) -> Rect:
        """Pixels of `rect` outside which the layer is neutral."""
        held = self.written.get(name)
        return EMPTY if held is None else held.rect.clip(self.rect)

    def crop(self, rect: Rect) -> Layers:
        """The part inside `rect`, which must lie in this rectangle."""
        if not self.rect.contains(rect):
            raise ValueError(f"crop {rect} is not inside {self.rect}")
        return Layers(rect, self.written)
