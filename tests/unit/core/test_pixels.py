"""Pixels made where they are asked for are those that would be made all at once; parts of
an image fall into place.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.pixels import BAND_PX, Pixels
from arfx.core.rect import Rect

WHOLE = Rect(10, 3 * BAND_PX - 9, 150, 6 * BAND_PX + 20)
PIXELS = np.random.default_rng(0).random((WHOLE.height, WHOLE.width, 3), dtype=np.float32)


def cut(rect: Rect) -> np.ndarray:
    return PIXELS[rect.slices_in(WHOLE)]


def random_rect(g: np.random.Generator, inside: Rect) -> Rect:
    x, y = (
        np.sort(g.integers(inside.x0, inside.x1 + 1, 2)),
        np.sort(g.integers(inside.y0, inside.y1 + 1, 2)),
    )
    return Rect(
        int(x[0]), int(y[0]), max(int(x[1]), int(x[0]) + 1), max(int(y[1]), int(y[0]) + 1)
    ).clip(inside)


@pytest.mark.parametrize("seed", range(12))
def test_whatever_is_asked_for_in_whatever_order(seed: int) -> None:
    g = np.random.default_rng(seed)
    asked = np.zeros((WHOLE.height, WHOLE.width), int)

    def read(rect: Rect) -> np.ndarray:
        asked[rect.slices_in(WHOLE)] += 1
        return cut(rect).copy()

    part = random_rect(g, WHOLE) if seed % 2 else None
    laid = (
        None
        if part is None
        else np.full((part.height, part.width, 3), g.random(), np.float32)
    )
    expected = PIXELS.copy()
    if part is not None:
        expected[part.slices_in(WHOLE)] = laid
    pixels = Pixels(WHOLE, laid, read, part)
    assert pixels.painted == (part or Rect(0, 0, 0, 0))
    for _ in range(8):
        outer = random_rect(g, WHOLE)
        assert np.array_equal(pixels(outer), expected[outer.slices_in(WHOLE)])
    assert asked.max() == 1, "nothing twice"


def test_an_array_that_a_stage_made_is_never_filled_in() -> None:
    """It may be kept and returned again."""
    array = np.full((40, 60, 3), 2, np.float32)
    pixels = Pixels(Rect(20, 200, 80, 240), array, cut).clip(Rect(30, 200, 50, 240))
    seen = pixels(Rect(20, 200, 80, 240))
    assert seen[0, 0].max() < 1 and (seen[:, 10:30] == 2).all() and (array == 2).all()


def test_an_image_over_an_image_keeps_what_it_does_not_set() -> None:
    below = Pixels(WHOLE, np.full((9, 9, 3), 2, np.float32), cut, Rect(20, 200, 29, 209))
    above = Pixels(WHOLE, np.full((9, 9, 3), 3, np.float32), below, Rect(25, 205, 34, 214))
    expected = PIXELS.copy()
    expected[Rect(20, 200, 29, 209).slices_in(WHOLE)] = 2
    expected[Rect(25, 205, 34, 214).slices_in(WHOLE)] = 3
    assert above.painted == Rect(20, 200, 34, 214)
    assert np.array_equal(above(WHOLE), expected)
