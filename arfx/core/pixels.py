"""A layer's pixels: an array over a rectangle; and the plate, which is made in bands."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.rect import Rect

# rows that are converted together; bands begin at multiples of it in the frame
BAND_PX = 64


def bands(rect: Rect) -> Iterator[Rect]:
    """A rectangle in parts of at most BAND_PX rows."""
    for top in range(rect.y0 // BAND_PX * BAND_PX, rect.y1, BAND_PX):
        yield Rect(rect.x0, max(top, rect.y0), rect.x1, min(top + BAND_PX, rect.y1))


@dataclass(frozen=True, eq=False)
class Pixels:
    """A layer in the rectangle where it is set. array : (h, w, ...) over `rect`"""

    rect: Rect
    array: ndarray

    def part(self, rect: Rect) -> ndarray:
        """(h, w, ...) of a rectangle inside it, a view."""
        return self.array[rect.slices_in(self.rect)]

    def clip(self, rect: Rect) -> Pixels:
        """What lies inside another rectangle."""
        both = self.rect.clip(rect)
        return self if both == self.rect else Pixels(both, self.part(both))


class Plate:
    """The real frame in linear light over `rect`: bands are converted when they are first
    read, and kept.

    read : writes any part into its second argument, (h, w, 3) float32;  seconds : spent in it
    """

    def __init__(self, rect: Rect, read: Callable[[Rect, ndarray], object]) -> None:
        self.rect, self.seconds, self._read = rect, 0.0, read
        self._array = np.empty((rect.height, rect.width, 3), np.float32)
        self._made: set[int] = set()

    @staticmethod
    def of(array: ndarray, rect: Rect) -> Plate:
        """The one that is known already. array : (h, w, 3) float32 over `rect`"""
        return Plate(
            rect, lambda part, out: np.copyto(out, array[part.slices_in(rect)])
        )

    def part(self, rect: Rect) -> ndarray:
        """(h, w, 3) of a rectangle inside it, a view."""
        start = time.perf_counter()
        for top in range(rect.y0 // BAND_PX * BAND_PX, rect.y1, BAND_PX):
            if top not in self._made:
                whole = Rect(self.rect.x0, top, self.rect.x1, top + BAND_PX)
                band = whole.clip(self.rect)
                self._read(band, self._array[band.slices_in(self.rect)])
                self._made.add(top)
        self.seconds += time.perf_counter() - start
        return self._array[rect.slices_in(self.rect)]
