"""Pixels of a layer of which a part is set, and the rest is made where it is asked for."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from arfx.core.rect import EMPTY, Rect

BAND_PX = 64  # rows that are made together; bands begin at multiples of it in the frame


class Pixels:
    """A layer over `rect`, set in `part`, elsewhere made by `rest` where it is asked for, and
    kept.
    array : (h, w, ...) over `part`, None = nothing is set
    rest : makes any part; None = the layer's neutral value, which `Layers` makes
    seconds : spent in `rest`"""

    def __init__(
        self,
        rect: Rect,
        array: np.ndarray | None = None,
        rest: Callable[[Rect], np.ndarray] | None = None,
        part: Rect | None = None,
    ) -> None:
        self.rect, self.rest, self.seconds = rect, rest, 0.0
        self.part = EMPTY if array is None else rect if part is None else part
        self.array = np.empty((0, 0, 3), np.float32) if array is None else array
        self._whole: np.ndarray | None = None  # over `rect`, set in the bands that begin at
        self._made: set[int] = set()

    @property
    def painted(self) -> Rect:
        """Holds all in which it is not as the plate."""
        below = self.rest.painted if isinstance(self.rest, Pixels) else EMPTY
        return self.part.union(below)

    def clip(self, rect: Rect) -> Pixels:
        """Nothing set outside of a rectangle."""
        part = self.part.clip(rect)
        return Pixels(self.rect, self.array[part.slices_in(self.part)], self.rest, part)

    def __call__(self, rect: Rect) -> np.ndarray:
        """(h, w, ...) of a part of `rect`, a view."""
        if self.part.contains(rect):
            return self.array[rect.slices_in(self.part)]
        if self._whole is None:
            shape = self.rect.height, self.rect.width, *self.array.shape[2:]
            self._whole = np.empty(shape, self.array.dtype)
        for y in range(rect.y0 // BAND_PX * BAND_PX, rect.y1, BAND_PX):
            if y not in self._made:
                band = Rect(self.rect.x0, y, self.rect.x1, y + BAND_PX).clip(self.rect)
                self._make(band, self._whole[band.slices_in(self.rect)])
                self._made.add(y)
        return self._whole[rect.slices_in(self.rect)]

    def _make(self, band: Rect, out: np.ndarray) -> None:
        assert self.rest is not None
        start = time.perf_counter()
        out[...] = self.rest(band)
        self.seconds += time.perf_counter() - start
        both = self.part.clip(band)
        if not both.empty:
            out[both.slices_in(band)] = self.array[both.slices_in(self.part)]
