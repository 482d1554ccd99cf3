"""Pixels made where they are asked for are those that would be made all at once; parts of an image fall into place."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.layers import Layer, Layers, Spans
from arfx.core.rect import Rect
from arfx.core.sheet import BAND_PX, Sheet

WHOLE = Rect(10, 3 * BAND_PX - 9, 150, 6 * BAND_PX + 20)
PIXELS = np.random.default_rng(0).random((WHOLE.height, WHOLE.width, 3), dtype=np.float32)


def cut(rect: Rect) -> np.ndarray:
    return PIXELS[rect.slices_in(WHOLE)]


def random_rect(g: np.random.Generator, inside: Rect) -> Rect:
    x, y = np.sort(g.integers(inside.x0, inside.x1 + 1, 2)), np.sort(g.integers(inside.y0, inside.y1 + 1, 2))
    return Rect(int(x[0]), int(y[0]), max(int(x[1]), int(x[0]) + 1), max(int(y[1]), int(y[0]) + 1)).clip(inside)


@pytest.mark.parametrize("seed", range(12))
def test_whatever_is_asked_for_in_whatever_order(seed: int) -> None:
    g = np.random.default_rng(seed)
    asked = np.zeros((WHOLE.height, WHOLE.width), int)

    def read(rect: Rect) -> np.ndarray:
        asked[rect.slices_in(WHOLE)] += 1
        return cut(rect).copy()

    over = random_rect(g, WHOLE), g.random((1, 1, 3), dtype=np.float32)
    laid = np.broadcast_to(over[1], (over[0].height, over[0].width, 3))
    expected = PIXELS.copy()
    if seed % 2:
        expected[over[0].slices_in(WHOLE)] = laid
    sheet = Sheet(WHOLE, read, (over[0], laid) if seed % 2 else None)
    for _ in range(8):
        outer = random_rect(g, WHOLE)
        parts = [random_rect(g, outer) for _ in range(3)]
        if g.random() < 0.4:
            assert np.array_equal(sheet(outer), expected[outer.slices_in(WHOLE)])
            continue
        seen = sheet.within(outer, parts)
        assert seen.shape == (outer.height, outer.width, 3)
        for part in parts:
            assert np.array_equal(seen[part.slices_in(outer)], expected[part.slices_in(WHOLE)])
    assert asked.max() <= 3, "made, made again where the first part did not fill its bands, and not each time"


def test_spans_are_completed_by_what_was_there() -> None:
    rect = Rect(20, 3 * BAND_PX, 90, 4 * BAND_PX)
    columns = np.zeros((rect.height, 2), np.int32)
    columns[10:30], columns[30:33] = (5, 40), (0, 70)

    def spans() -> Spans:
        made = np.full((rect.height, rect.width, 3), np.nan, np.float32)
        for y, (a, b) in enumerate(columns):
            made[y, a:b] = 2
        return Spans(rect, made, columns, cut)

    expected = cut(rect).copy()
    expected[10:30, 5:40], expected[30:33] = 2, 2
    assert np.array_equal(spans().array, expected)
    assert [(r.width, r.height) for r in spans().parts()] == [(35, 20), (70, 3)]
    held = Rect(50, rect.y0 + 20, 80, rect.y0 + 50)
    grown = spans().holding(held)
    assert all(np.isfinite(grown.made[y, a:b]).all() for y, (a, b) in enumerate(grown.columns))
    assert all(grown.columns[y, 0] <= 30 and grown.columns[y, 1] >= 60 for y in range(20, 50))
    assert np.array_equal(grown.array, expected)
    only = spans().only(Rect(30, rect.y0 + 12, 45, rect.y1))
    expected = cut(rect).copy()
    expected[12:30, 10:25], expected[30:33, 10:25] = 2, 2
    assert np.array_equal(only.array, expected)


def test_within_makes_only_what_is_asked_for() -> None:
    asked: list[Rect] = []

    def read(rect: Rect) -> np.ndarray:
        asked.append(rect)
        return cut(rect).copy()

    layers = Layers(WHOLE, {Layer.IMAGE: (WHOLE, Sheet(WHOLE, read))})
    part = Rect(20, 3 * BAND_PX, 60, 4 * BAND_PX)
    seen = layers.within(Layer.IMAGE, [part, part.shift(10, 0)])
    assert np.array_equal(seen[part.slices_in(WHOLE)], cut(part)) and sum(r.area for r in asked) < WHOLE.area / 3
    assert not seen.flags.writeable
