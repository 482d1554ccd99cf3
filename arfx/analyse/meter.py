"""What each frame tells about its light: patches of the markers' cells, and now and then a small picture of the surroundings.

A fold: fed frame by frame, it keeps some hundred numbers per marker and frame, and no pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from arfx.analyse.fold import Fold
from arfx.analyse.photometry import Patches, cells, place, reduced
from arfx.analyse.records import Seen
from arfx.analyse.surroundings import Look, look
from arfx.core.rect import Rect

SURROUNDINGS_S = 0.5  # between two looks at the surroundings
SURROUNDINGS_PX = 96  # width of the picture that is looked at
MOST_LOOKS = 240  # beyond that every second one is dropped, and the interval doubled
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2


class Picture(Protocol):
    """One frame's pixels, as the meter reads them (media.frame.Frame is one)."""

    @property
    def rect(self) -> Rect: ...

    def linear_at(self, pixels: np.ndarray) -> np.ndarray: ...

    def reduced(self, width: int) -> np.ndarray: ...


class LightMeter(Fold):
    """readings : (frame, marker key, Patches) in order;  looks : of the surroundings

    formula : "corrected" or "paper", how the surroundings are folded
    """

    given = frozenset({"_formula"})

    def __init__(self, formula: str = "corrected") -> None:
        self._formula = formula
        self.readings: list[tuple[int, str, Patches]] = []
        self.looks: list[Look] = []
        self._next_s, self._interval_s = -np.inf, SURROUNDINGS_S

    def step(self, frame: int, time_s: float, seen: Sequence[Seen], picture: Picture) -> None:
        """frame : its number;  seen : configured markers in it;  picture : its pixels"""
        for s in seen:
            if Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect).empty:
                continue
            family, _, number = s.key.rpartition(":")
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            shape = (picture.rect.height, picture.rect.width)
            spots = place(s.corners_px, cells(family, int(number)), s.inverted, blur, shape)
            self.readings.append((frame, s.key, reduced(picture.linear_at(spots.pixels()), spots)))
        if seen and time_s >= self._next_s:
            self._next_s = time_s + self._interval_s
            small = picture.reduced(SURROUNDINGS_PX)
            if min(small.shape[:2]) >= 3:
                shrink = small.shape[1] / picture.rect.width
                largest = max(seen, key=lambda s: s.side_px)
                self.looks.append(look(frame, small, (largest.corners_px + 0.5) * shrink - 0.5, self._formula))
            if len(self.looks) > MOST_LOOKS:
                self.looks, self._interval_s = self.looks[::2], 2 * self._interval_s
