"""Pixel rectangles: the unit in which regions of interest are passed around."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray


class Rect(NamedTuple):
    """Half-open pixel rectangle, origin top left: x in [x0, x1), y in [y0, y1)."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def empty(self) -> bool:
        return self.x1 <= self.x0 or self.y1 <= self.y0

    @property
    def width(self) -> int:
        return max(self.x1 - self.x0, 0)

    @property
    def height(self) -> int:
        return max(self.y1 - self.y0, 0)

    @property
    def area(self) -> int:
        return self.width * self.height

    @property
    def slices(self) -> tuple[slice, slice]:
        """(rows, columns) that cut this rectangle out of a whole-frame array."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def slices_in(self, outer: Rect) -> tuple[slice, slice]:
        """(rows, columns) that cut this rectangle out of an array covering `outer`."""
        return self.shift(-outer.x0, -outer.y0).slices

    def pad(self, n: int) -> Rect:
        return (
            self
            if self.empty
            else Rect(self.x0 - n, self.y0 - n, self.x1 + n, self.y1 + n)
        )

    def clip(self, other: Rect) -> Rect:
        """Intersection; EMPTY where the two do not meet."""
        r = Rect(*map(max, self[:2], other[:2]), *map(min, self[2:], other[2:]))
        return EMPTY if r.empty else r

    def union(self, other: Rect) -> Rect:
        """Smallest rectangle holding both; empty ones count for nothing."""
        if self.empty:
            return other
        if other.empty:
            return self
        return Rect(*map(min, self[:2], other[:2]), *map(max, self[2:], other[2:]))

    def shift(self, dx: int, dy: int) -> Rect:
        return Rect(self.x0 + dx, self.y0 + dy, self.x1 + dx, self.y1 + dy)

    def contains(self, other: Rect) -> bool:
        return other.empty or self.clip(other) == other

    def align(self, step_x: int, step_y: int) -> Rect:
        """Grown outwards to multiples of a grid (chroma subsampling, tiles)."""
        if self.empty:
            return EMPTY
        x1, y1 = -(-self.x1 // step_x) * step_x, -(-self.y1 // step_y) * step_y
        return Rect(self.x0 // step_x * step_x, self.y0 // step_y * step_y, x1, y1)

    @staticmethod
    def around(points_px: ndarray, pad_px: float = 0.0) -> Rect:
        """Smallest rectangle of whole pixels that holds the points, grown by `pad_px`.
        points_px : (n, 2) float, pixel centres at integers. No finite point gives EMPTY."""
        p = np.asarray(points_px, float).reshape(-1, 2)
        p = p[np.isfinite(p).all(1)]
        if not len(p):
            return EMPTY
        limit = 1 << 24  # beyond any picture; keeps the integers small
        # column by column: many times as fast as over the first axis of two columns
        ends = [c.min() - pad_px for c in p.T] + [c.max() + pad_px for c in p.T]
        whole = np.clip(np.floor(np.add(ends, 0.5)), -limit, limit).astype(int)
        x0, y0, x1, y1 = whole.tolist()
        return Rect(x0, y0, x1 + 1, y1 + 1)

    @staticmethod
    def holding(mask: ndarray) -> Rect:
        """Smallest rectangle that holds what is not 0 of (h, w)."""
        x, y, width, height = cv2.boundingRect((mask != 0).view(np.uint8))
        return Rect(x, y, x + width, y + height)

    @staticmethod
    def of(width: int, height: int) -> Rect:
        return Rect(0, 0, width, height)


EMPTY = Rect(0, 0, 0, 0)
