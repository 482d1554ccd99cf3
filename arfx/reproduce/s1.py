"""Rows of Tan, Chen, Sun 2009: illumination from a dynamic light map."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from arfx.papers.s1_light import eq8_weight
from arfx.reproduce.rows import Item, shown
from arfx.reproduce.work import Work


def rows(work: Work) -> Iterator[Item]:
    s, angle = 0.2, np.radians(10.0)
    printed = float(eq8_weight(np.cos(angle), s))
    gauss = float(np.exp(-(angle**2) / (2 * s**2)))
    why = "the square of a Gaussian is missing in print: the weight has a cusp at 0"
    yield shown("s1", "equation (8), weight at 10 degrees, s = 0.2", "exp(-θ / (2 s²))", printed, gauss, False, why)
