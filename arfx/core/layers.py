"""Named image layers of one frame, all over the same rectangle: the G-buffer and the composite."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from itertools import pairwise

import numpy as np

from arfx.core.rect import EMPTY, Rect
from arfx.core.sheet import Sheet


class Layer(StrEnum):
    """Layer names. Arrays are float32 unless stated; colours are linear RGB, scene referred, 1 = paper white."""

    PLATE = "plate"  # (h, w, 3) the real frame; never changed
    IMAGE = "image"  # (h, w, 3) the composite so far
    VIRTUAL = "virtual"  # (h, w, 3) shaded virtual object, premultiplied by COVERAGE
    COVERAGE = "coverage"  # (h, w) fraction of the pixel that the virtual object covers, 0..1
    DEPTH = "depth"  # (h, w) metres along the optical axis of the nearest virtual surface; inf = none
    NORMAL = "normal"  # (h, w, 3) unit, WORLD frame, towards the camera; zero = none
    POSITION = "position"  # (h, w, 3) metres, WORLD frame, of the nearest virtual surface; zero = none
    ALBEDO = "albedo"  # (h, w, 3) base colour, not premultiplied
    MATERIAL = "material"  # (h, w, 4) metallic, roughness, specular (dielectric F0 / 0.08), alpha
    EMISSIVE = "emissive"  # (h, w, 3) emitted radiance
    OBJECT_ID = "object_id"  # (h, w) int32, 0 = none, else 1 + part index
    MOTION = "motion"  # (h, w, 2) px, from the previous frame
    SHADOW = "shadow"  # (h, w, 3) ratio of light left on the real surface, 1 = none taken
    IRRADIANCE = "irradiance"  # (h, w, 3) on the virtual surface
    REAL_DEPTH = "real_depth"  # (h, w) metres along the axis of the real surface, measured; inf = the job has no depth


# (channels, 0 = none; dtype; value) that a layer has where no stage has written it: nothing virtual, no shadow.
_NEUTRAL: dict[Layer, tuple[int, type, float]] = {
    Layer.VIRTUAL: (3, np.float32, 0.0),
    Layer.COVERAGE: (0, np.float32, 0.0),
    Layer.DEPTH: (0, np.float32, np.inf),
    Layer.NORMAL: (3, np.float32, 0.0),
    Layer.POSITION: (3, np.float32, 0.0),
    Layer.ALBEDO: (3, np.float32, 0.0),
    Layer.MATERIAL: (4, np.float32, 0.0),
    Layer.EMISSIVE: (3, np.float32, 0.0),
    Layer.OBJECT_ID: (0, np.int32, 0),
    Layer.MOTION: (2, np.float32, 0.0),
    Layer.SHADOW: (3, np.float32, 1.0),
    Layer.IRRADIANCE: (3, np.float32, 0.0),
    Layer.REAL_DEPTH: (0, np.float32, np.inf),
}


def neutral(name: Layer, rect: Rect) -> np.ndarray:
    """A new array over `rect` as if nothing virtual were there. PLATE and IMAGE have no neutral value: KeyError."""
    channels, dtype, value = _NEUTRAL[name]
    if value == 0:  # several times as fast as filling
        return np.zeros((rect.height, rect.width, channels) if channels else (rect.height, rect.width), dtype)
    out = unset(name, rect)
    out.fill(value)
    return out


def unset(name: Layer, rect: Rect) -> np.ndarray:
    """A new array of the layer's shape and type whose values are not set yet."""
    channels, dtype, _ = _NEUTRAL[name]
    return np.empty((rect.height, rect.width, channels) if channels else (rect.height, rect.width), dtype)


UNWRITTEN = (EMPTY, np.empty(0))

# The pixels of a rectangle, made when they are asked for.
Deferred = Callable[[Rect], np.ndarray]


@dataclass(frozen=True)
class Patch:
    """What a stage writes of a layer that stays neutral in the rest of the stage's rectangle."""

    rect: Rect
    array: np.ndarray

    def over(self, name: Layer, rect: Rect) -> np.ndarray:
        """The layer over `rect`, neutral outside the part."""
        return Layers(rect, {name: (self.rect, self.array)})[name]


class Spans(Patch):
    """IMAGE of which only some columns of each row were made; the rest stays as it was.

    rect : where;  made : (h, w, 3), set in `columns` only;  columns : (h, 2) int32, first and behind the last, from rect's left
    before : what IMAGE was, of any part of rect
    """

    def __init__(self, rect: Rect, made: np.ndarray, columns: np.ndarray, before: Deferred) -> None:
        for name, value in (("rect", rect), ("made", made), ("columns", columns), ("before", before)):
            object.__setattr__(self, name, value)

    made: np.ndarray
    columns: np.ndarray
    before: Deferred

    def parts(self) -> list[Rect]:
        """Rectangles of the frame that hold all that was made."""
        x = self.rect.x0
        return [Rect(x + a, rows.y0, x + b, rows.y1) for rows, (a, b) in self._bands() if a < b]

    def only(self, rect: Rect) -> Spans:
        """Nothing made outside of a rectangle."""
        columns = self.columns.clip(rect.x0 - self.rect.x0, rect.x1 - self.rect.x0).astype(np.int32)
        columns[: max(rect.y0 - self.rect.y0, 0)] = 0
        columns[max(rect.y1 - self.rect.y0, 0) :] = 0
        return Spans(self.rect, self.made, columns, self.before)

    def holding(self, rect: Rect) -> Spans:
        """With a rectangle inside this one, as it was where it was not made."""
        columns = self.columns.copy()
        for rows, (a, b) in self._bands():
            both = rows.clip(rect)
            if both.empty:
                continue
            x0, x1 = self.rect.x0 + a, self.rect.x0 + b
            low, high = (min(both.x0, x0), max(both.x1, x1)) if a < b else (both.x0, both.x1)
            for left, right in ((low, x0), (x1, high)) if a < b else ((low, high),):
                self._keep(Rect(left, both.y0, right, both.y1))
            columns[both.y0 - self.rect.y0 : both.y1 - self.rect.y0] = low - self.rect.x0, high - self.rect.x0
        return Spans(self.rect, self.made, columns, self.before)

    @cached_property
    def array(self) -> np.ndarray:
        """(h, w, 3), complete."""
        for rows, (a, b) in self._bands():
            x = self.rect.x0
            for x0, x1 in ((x, x + a), (x + b, self.rect.x1)) if a < b else ((x, self.rect.x1),):
                self._keep(Rect(x0, rows.y0, x1, rows.y1))
        return self.made

    def _keep(self, part: Rect) -> None:
        if not part.empty:
            self.made[part.slices_in(self.rect)] = self.before(part)

    def _bands(self) -> list[tuple[Rect, tuple[int, int]]]:
        """Rows with the same columns."""
        cuts = np.flatnonzero((np.diff(self.columns, axis=0) != 0).any(1)) + 1
        ends = [0, *(int(y) for y in cuts), len(self.columns)]
        r = self.rect
        return [
            (Rect(r.x0, r.y0 + top, r.x1, r.y0 + bottom), (int(self.columns[top, 0]), int(self.columns[top, 1])))
            for top, bottom in pairwise(ends)
            if top < bottom
        ]


@dataclass(frozen=True, eq=False)
class Dimmed:
    """IMAGE of a frame after whose stage none reads it: as written in `part`, else PLATE with less light, not worked out yet.

    left : (h, w, 3) or (h, w, 1) over `rect`, share of PLATE's light that is left;  opacity : how much of that change is shown
    bias : (3,) what of PLATE is no light and stays
    """

    part: Patch
    rect: Rect
    left: np.ndarray
    opacity: float
    bias: np.ndarray


@dataclass(frozen=True)
class Layers:
    """Layers seen over one rectangle, read-only: each as it was written, neutral where nothing has written it.

    written : every name that may be read -> the rectangle that its array covers (EMPTY: none), and the array or what makes it
    A layer's neutral pixels are made when it is asked for, so cropping first costs nothing for what is cut off.
    """

    rect: Rect
    written: Mapping[Layer, tuple[Rect, np.ndarray | Deferred]] = field(default_factory=dict)

    def __getitem__(self, name: Layer) -> np.ndarray:
        """(h, w, ...) over `rect`. Raises KeyError for a layer that is not among `written`, and for PLATE and IMAGE where
        they do not cover `rect`, as they have no neutral value."""
        where, array = self.written[name]
        if not isinstance(array, np.ndarray):
            where = self.rect.clip(where)
            array = array(where)
        if where.contains(self.rect) and not where.empty:
            seen = array[self.rect.slices_in(where)].view()
        else:
            seen = neutral(name, self.rect)
            both = where.clip(self.rect)
            if not both.empty:
                seen[both.slices_in(self.rect)] = array[both.slices_in(where)]
        if seen.ndim == 3 and seen.strides[-1] == 0:  # one value for all channels
            seen = np.ascontiguousarray(seen)
        seen.setflags(write=False)
        return seen

    def within(self, name: Layer, parts: Sequence[Rect]) -> np.ndarray:
        """PLATE or IMAGE as `layers[name]`, of which only `parts` need be set: others may not be made at all."""
        where, array = self.written[name]
        if not isinstance(array, Sheet) or not where.contains(self.rect):
            return self[name]
        seen = array.within(self.rect, parts).view()
        seen.setflags(write=False)
        return seen

    def one_channel(self, name: Layer) -> np.ndarray:
        """Like `layers[name]`, but (h, w, 1) where it was written with one value for all channels over all of `rect`."""
        where, array = self.written[name]
        if isinstance(array, np.ndarray) and array.ndim == 3 and array.strides[-1] == 0 and where.contains(self.rect):
            return array[self.rect.slices_in(where)][..., :1]
        return self[name]

    def extent(self, name: Layer) -> Rect:
        """Pixels of `rect` outside which the layer is neutral."""
        return self.written[name][0].clip(self.rect)

    def adding(self, new: Mapping[Layer, np.ndarray]) -> Layers:
        """These layers plus `new` (which replaces same-named ones).

        Raises ValueError where an array does not cover the rectangle.
        """
        shape = (self.rect.height, self.rect.width)
        for name, array in new.items():
            if array.shape[:2] != shape:
                raise ValueError(f"layer {name}: shape {array.shape[:2]}, expected {shape}")
        return Layers(self.rect, {**self.written, **{name: (self.rect, array) for name, array in new.items()}})

    def crop(self, rect: Rect) -> Layers:
        """The part inside `rect`, which must lie in this rectangle."""
        if not self.rect.contains(rect):
            raise ValueError(f"crop {rect} is not inside {self.rect}")
        return Layers(rect, self.written)
