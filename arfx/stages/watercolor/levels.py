"""What the levels of the stage leave out.

Sites, noise, tone and style are the same at all of them: they differ in how exactly washes and
borders are painted. Time and error of each: docs/methods/watercolor.md#levels."""

from __future__ import annotations

from typing import NamedTuple


class Accuracy(NamedTuple):
    """rounds : fraction of the rounds of `smooth_washes` that is made, each as strong as those
        that it stands for
    borders : alike cells run into each other, unlike ones get a dark edge; else a pixel has its
        own cell's colour
    places : along a pixel's side at which it is labelled and painted; it shows their mean
    """

    rounds: float
    borders: bool
    places: int = 1


ACCURACY = {
    "standard": Accuracy(0.5, False),
    "high": Accuracy(1.0, True),
    "reference": Accuracy(1.0, True, places=4),
}
