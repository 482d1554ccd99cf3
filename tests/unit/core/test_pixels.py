"""Pixels made where they are asked for are those that would be made all at once; parts of
an image fall into place.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from arfx.core.pixels import BAND_PX, Attenuated, Pixels, Region
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
    for _ in range(8):
        outer = random_rect(g, WHOLE)
        parts = [random_rect(g, outer) for _ in range(3)]
        if g.random() < 0.4:
            assert np.array_equal(pixels(outer), expected[outer.slices_in(WHOLE)])
            continue
        seen = pixels.over(outer, parts)
        assert seen.shape == (outer.height, outer.width, 3)
        for p in parts:
            assert np.array_equal(seen[p.slices_in(outer)], expected[p.slices_in(WHOLE)])
    assert asked.max() == 1 and (part is None or not asked[part.slices_in(WHOLE)].any()), (
        "nothing twice, nothing for naught"
    )


def test_a_region_grows_to_the_hull_of_its_rows_and_says_what_was_missing() -> None:
    g = np.random.default_rng(1)
    for _ in range(30):
        region, held = Region([]), np.zeros((WHOLE.height, WHOLE.width), bool)
        for _ in range(6):
            part = random_rect(g, WHOLE)
            missing = np.zeros_like(held)
            for r in region.grow(part):
                assert not (missing | held)[r.slices_in(WHOLE)].any()
                missing[r.slices_in(WHOLE)] = True
            held |= missing
            columns = region.columns(WHOLE)
            assert (
                held[part.slices_in(WHOLE)].all()
                and (held.sum(1) == columns[:, 1] - columns[:, 0]).all()
            )
        assert region.bounds == Region(region.rects).bounds and all(
            a.y1 <= b.y0 for a, b in pairwise(region.rects)
        )


def test_a_picture_made_in_some_columns_is_completed_by_what_was_there() -> None:
    rect = Rect(20, 3 * BAND_PX, 90, 4 * BAND_PX)
    rows = [
        Rect(25, rect.y0 + 10, 60, rect.y0 + 30),
        Rect(20, rect.y0 + 30, 90, rect.y0 + 33),
    ]
    made, expected = (
        np.full((rect.height, rect.width, 3), np.nan, np.float32),
        cut(rect).copy(),
    )
    made[10:30, 5:40] = made[30:33] = expected[10:30, 5:40] = expected[30:33] = 2
    before = Pixels(WHOLE, rest=lambda r: cut(r))
    some = Pixels(rect, made.copy(), before, written=rows)
    assert some.painted == Rect(20, rect.y0 + 10, 90, rect.y0 + 33) and before.painted.empty
    assert np.array_equal(some(rect), expected)
    only = Pixels(rect, made.copy(), before, written=rows).clip(
        Rect(30, rect.y0 + 12, 45, rect.y1)
    )
    expected = cut(rect).copy()
    expected[12:33, 10:25] = 2
    assert np.array_equal(only(rect), expected)


def test_an_array_that_a_stage_made_whole_is_never_filled_in() -> None:
    """It may be kept and returned again."""
    array = np.full((40, 60, 3), 2, np.float32)
    pixels = Pixels(Rect(20, 200, 80, 240), array, cut).clip(Rect(30, 200, 50, 240))
    assert pixels(Rect(20, 200, 80, 240))[0, 0].max() < 1 and (array == 2).all()


def test_less_light_is_worked_out_where_it_is_asked_for() -> None:
    def make(
        plate: np.ndarray,
        left: np.ndarray,
        opacity: float,
        bias: np.ndarray,
        out: np.ndarray,
    ) -> None:
        out[:] = bias + (1 + opacity * (left - 1)) * (plate - bias)

    plate, dark = Pixels(WHOLE, rest=lambda r: cut(r)), Rect(30, 200, 60, 260)
    left = np.full((60, 30, 1), 0.5, np.float32)
    light = Attenuated(plate, dark, left, np.float32(0.8), np.zeros(3, np.float32), make)
    part = Rect(20, 190, 50, 230)
    expected = cut(part).copy()
    expected[10:, 10:] *= np.float32(0.6)
    np.testing.assert_allclose(light(part), expected, rtol=1e-6)
    assert light.painted == dark and np.array_equal(plate(part), cut(part))
