"""What the levels of the stage leave out. Sites, noise, tone and style are the same at all of them: they differ in how exactly
washes, borders and lines are computed. Time and error of each: docs/methods/watercolor.md#levels."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple


class Accuracy(NamedTuple):
    """half : all but the paper is painted at half the size
    rounds : fraction of the rounds of `smooth_washes` that is made, each as strong as those that it stands for
    borders : alike cells run into each other, unlike ones get a dark edge; else a pixel has its own cell's colour
    places : along a pixel's side at which it is labelled and painted; it shows their mean. Labels are float64's where there are
        several"""

    half: bool
    rounds: float
    borders: bool
    places: int = 1

    def rounds_of(self, every: int) -> int:
        return ceil(self.rounds * every)


ACCURACY = {
    "draft": Accuracy(True, 0.0, False),
    "standard": Accuracy(False, 0.5, False),
    "high": Accuracy(False, 1.0, True),
    "reference": Accuracy(False, 1.0, True, places=3),
}
