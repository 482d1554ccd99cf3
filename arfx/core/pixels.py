"""Pixels of a layer of which a part is set, and the rest is made where it is asked for."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from arfx.core.rect import EMPTY, Rect

NEARLY_ALL = 0.8  # of a rectangle: then all of it is made at once
BAND_PX = 64  # rows that are made together; bands begin at multiples of it in the frame


class Region:
    """Pixels of a frame, in each row those of one interval.

    rects : one below the other, no two in the same row
    """

    def __init__(self, rects: Iterable[Rect]) -> None:
        self.rects = _joined(rects)

    @property
    def bounds(self) -> Rect:
        """Smallest rectangle that holds all."""
        return reduce(Rect.union, self.rects, EMPTY)

    def columns(self, rect: Rect) -> np.ndarray:
        """(h, 2) int32 of the rows of a rectangle that holds all: first and behind the
        last, from the rectangle's left.
        """
        out = np.zeros((rect.height, 2), np.int32)
        for r in self.rects:
            out[r.y0 - rect.y0 : r.y1 - rect.y0] = r.x0 - rect.x0, r.x1 - rect.x0
        return out

    def clip(self, rect: Rect) -> Region:
        return Region(r.clip(rect) for r in self.rects)

    def grow(self, part: Rect) -> list[Rect]:
        """Takes in a part, and what lies between it and the rest of its rows.

        Returns what was missing.
        """
        above, below = (
            [r for r in self.rects if r.y1 <= part.y0],
            [r for r in self.rects if r.y0 >= part.y1],
        )
        rows, missing, y = [], [], part.y0
        for r in self.rects[len(above) : len(self.rects) - len(below)]:
            top, bottom = max(r.y0, part.y0), min(r.y1, part.y1)
            new, all_ = (
                Rect(part.x0, y, part.x1, top),
                Rect(min(r.x0, part.x0), top, max(r.x1, part.x1), bottom),
            )
            rows += [Rect(r.x0, r.y0, r.x1, top), new, all_, Rect(r.x0, bottom, r.x1, r.y1)]
            missing += [
                new,
                Rect(all_.x0, top, r.x0, bottom),
                Rect(r.x1, top, all_.x1, bottom),
            ]
            y = bottom
        last = Rect(part.x0, y, part.x1, part.y1)
        self.rects = _joined([*above, *rows, last, *below])
        return _joined([*missing, last])


def _joined(rects: Iterable[Rect]) -> list[Rect]:
    """Without empty ones, and one for any that meet and have the same columns."""
    out: list[Rect] = []
    for r in rects:
        if out and (out[-1].x0, out[-1].x1, out[-1].y1) == (r.x0, r.x1, r.y0):
            out[-1] = Rect(r.x0, out[-1].y0, r.x1, r.y1)
        elif not r.empty:
            out.append(r)
    return out


class Pixels:
    """A layer over `rect`, set in `written`, elsewhere made by `rest` where it is asked
    for, and kept.
    array : (h, w, ...) over `part` of the rectangle, None = nothing is set;  written :
    rectangles of `part`, None = all of it
    rest : makes any other part; None = the layer's neutral value (`Layers` makes it), and
    `written` is all of `part`
    seconds : spent in `rest`"""

    def __init__(
        self,
        rect: Rect,
        array: np.ndarray | None = None,
        rest: Callable[[Rect], np.ndarray] | None = None,
        part: Rect | None = None,
        written: Sequence[Rect] | None = None,
    ) -> None:
        self.rect, self.rest, self.seconds = rect, rest, 0.0
        self.part = EMPTY if array is None else rect if part is None else part
        self.array = np.empty((0, 0, 3), np.float32) if array is None else array
        self.written = Region([self.part] if written is None else written)
        self._made: Region | None = None  # `written` and what `rest` made since

    @property
    def painted(self) -> Rect:
        """Holds all in which it is not as the plate."""
        below = self.rest.painted if isinstance(self.rest, Pixels | Attenuated) else EMPTY
        return self.written.bounds.union(below)

    def clip(self, rect: Rect) -> Pixels:
        """Nothing written outside of a rectangle."""
        if rect.contains(self.part):
            return self
        if self.written.rects == [
            self.part
        ]:  # whoever made the array may keep it: what is left of it is never filled in
            part = self.part.clip(rect)
            return Pixels(self.rect, self.array[part.slices_in(self.part)], self.rest, part)
        return Pixels(
            self.rect, self.array, self.rest, self.part, self.written.clip(rect).rects
        )

    def __call__(self, rect: Rect) -> np.ndarray:
        """(h, w, ...) of a part, a view."""
        return self.over(rect, (rect,))

    def over(self, rect: Rect, parts: Sequence[Rect]) -> np.ndarray:
        """(h, w, ...) of `rect`, a view, in which only `parts` need be set."""
        parts = [p.clip(rect) for p in parts]
        if sum(p.area for p in parts) >= NEARLY_ALL * rect.area:
            parts = [rect]
        made = self._made = self._made or Region(self.written.rects)
        if parts == [rect] and not made.rects:  # most often nothing else is asked for
            self.part, self.array, made.rects = rect, self._make(rect), [rect]
        if not self.part.contains(rect):
            array = np.empty(
                (self.rect.height, self.rect.width, *self.array.shape[2:]), self.array.dtype
            )
            for r in made.rects:
                array[r.slices_in(self.rect)] = self.array[r.slices_in(self.part)]
            self.part, self.array = self.rect, array
        for p in parts:
            for missing in made.grow(
                p.align(1, BAND_PX).clip(Rect(p.x0, self.part.y0, p.x1, self.part.y1))
            ):
                self._make(missing, self.array[missing.slices_in(self.part)])
        return self.array[rect.slices_in(self.part)]

    def _make(self, part: Rect, out: np.ndarray | None = None) -> np.ndarray:
        """out : to write it to, None = a new array"""
        assert self.rest is not None
        start = time.perf_counter()
        if isinstance(self.rest, Attenuated):  # needs no array of its own
            pixels = self.rest(part, out)
        else:
            pixels = self.rest(part)
            if out is not None:
                out[...] = pixels
        self.seconds += time.perf_counter() - start
        return pixels


@dataclass(frozen=True, eq=False)
class Attenuated:
    """The plate with less light, made where it is asked for: bias + (1 + opacity
    (transmittance - 1)) (plate - bias).
    transmittance : (h, w, 3) over `rect`; 1 elsewhere
    opacity : how much of that change is shown;  bias : (3,) what of the plate is no light and stays
    make : writes that into its last argument; arguments plate, transmittance, opacity, bias, out
    """

    plate: Pixels
    rect: Rect
    transmittance: np.ndarray
    opacity: np.float32
    bias: np.ndarray
    make: Callable[..., object]

    @property
    def painted(self) -> Rect:
        return self.rect

    def __call__(self, rect: Rect, out: np.ndarray | None = None) -> np.ndarray:
        plate, both = self.plate(rect), self.rect.clip(rect)
        out = np.empty_like(plate) if out is None else out
        rows, columns = at = (
            both.slices_in(rect) if not both.empty else (slice(0, 0), slice(0, 0))
        )
        for around in (slice(rows.start), slice(rows.stop, None)):
            out[around] = plate[around]
        for beside in (slice(columns.start), slice(columns.stop, None)):
            out[rows, beside] = plate[rows, beside]
        if not both.empty:
            self.make(
                plate[at],
                self.transmittance[both.slices_in(self.rect)],
                self.opacity,
                self.bias,
                out[at],
            )
        return out
