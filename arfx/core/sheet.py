"""Pixels of a rectangle that are made where they are asked for, and kept: bands of rows, each with an interval of columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from arfx.core.rect import EMPTY, Rect

NEARLY_ALL = 0.8  # of a rectangle: then all of it is made at once
BAND_PX = 64  # rows of a band; bands begin at multiples of it in the frame


class Sheet:
    """rect : the pixels that can be asked for;  read : makes any part of them, (h, w, 3) float32
    over : pixels that lie on what is read, None = none
    """

    def __init__(self, rect: Rect, read: Callable[[Rect], np.ndarray], over: tuple[Rect, np.ndarray] | None = None) -> None:
        self.rect, self._made_by, self._over = rect, read, over
        self._where, self._pixels = EMPTY, np.empty((0, 0, 3), np.float32)  # all that was made while `_made` is empty
        self._made: dict[int, tuple[int, int]] = {}  # number of a band -> its columns

    def __call__(self, rect: Rect) -> np.ndarray:
        """(h, w, 3) of a part, a view."""
        if self._over is not None and self._over[0].contains(rect):
            return self._over[1][rect.slices_in(self._over[0])]
        return self.within(rect, (rect,))

    def within(self, rect: Rect, parts: Iterable[Rect]) -> np.ndarray:
        """(h, w, 3) of `rect`, a view, in which only `parts` are set."""
        parts = [p.clip(rect) for p in parts]
        if sum(p.area for p in parts) >= NEARLY_ALL * rect.area:
            parts = [rect]
        if self._where.empty and parts == [rect]:
            self._where, self._pixels = rect, self._new(rect)  # most often nothing else is asked for
        if self._made or not self._where.contains(rect):
            if not self._made:
                self._spread_out()
            for part in parts:
                self._make(part)
        return self._pixels[rect.slices_in(self._where)]

    def _spread_out(self) -> None:
        """From one part to bands of the whole rectangle."""
        had, first = self._where, self._pixels
        self._where, self._pixels = self.rect, np.empty((self.rect.height, self.rect.width, 3), np.float32)
        if not had.empty:
            self._pixels[had.slices_in(self.rect)] = first
        for band in range(self.rect.y0 // BAND_PX, (self.rect.y1 - 1) // BAND_PX + 1):
            rows = Rect(had.x0, band * BAND_PX, had.x1, (band + 1) * BAND_PX).clip(self.rect)
            self._made[band] = (had.x0, had.x1) if not had.empty and had.contains(rows) and not rows.empty else (0, 0)

    def _make(self, part: Rect) -> None:
        """Fill in what is missing of a part, and between it and what its bands have."""
        if part.empty:
            return
        waiting = EMPTY  # missing rows that go on in the next band
        for band in range(part.y0 // BAND_PX, (part.y1 - 1) // BAND_PX + 1):
            a, b = self._made[band]
            low, high = (min(a, part.x0), max(b, part.x1)) if a < b else (part.x0, part.x1)
            if (low, high) == (a, b):
                continue
            top, bottom = max(band * BAND_PX, self.rect.y0), min((band + 1) * BAND_PX, self.rect.y1)
            for x0, x1 in ((low, a), (b, high)) if a < b else ((low, high),):
                missing = Rect(x0, top, x1, bottom)
                if missing.empty:
                    continue
                if (waiting.x0, waiting.x1, waiting.y1) == (x0, x1, top):
                    waiting = waiting.union(missing)
                    continue
                self._fill(waiting)
                waiting = missing
            self._made[band] = low, high
        self._fill(waiting)

    def _read(self, part: Rect) -> np.ndarray:
        return self._made_by(part)

    def _fill(self, part: Rect) -> None:
        if not part.empty:
            self._write(part, self._pixels[part.slices_in(self.rect)])

    def _new(self, part: Rect) -> np.ndarray:
        if self._over is None:
            return self._read(part)
        out = np.empty((part.height, part.width, 3), np.float32)
        self._write(part, out)
        return out

    def _write(self, part: Rect, to: np.ndarray) -> None:
        where, array = self._over or (EMPTY, self._pixels)
        both = where.clip(part)
        if both != part:
            to[:] = self._read(part)
        if not both.empty:
            to[both.slices_in(part)] = array[both.slices_in(where)]
