"""Filling what is not known of a picture."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.stages.push_pull import fill_unknown


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_it_keeps_what_is_known_and_goes_on_with_what_is_near(channels: int) -> None:
    values = np.zeros((50, 70, channels), np.float32)
    values[:, 35:] = 1.0
    known = np.ones((50, 70), bool)
    known[10:40, 5:25] = known[10:40, 45:65] = False
    given = np.where(known[..., None], values, np.float32(9.0))
    out = fill_unknown(given, known)
    np.testing.assert_array_equal(out[known], values[known])
    assert out[15:35, 7:23].max() < 0.25 and out[15:35, 47:63].min() > 0.75


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (2, 3)])
def test_small_pictures_with_one_pixel_and_with_none(shape: tuple[int, int]) -> None:
    values = np.full((*shape, 3), 0.4, np.float32)
    known = np.zeros(shape, bool)
    np.testing.assert_array_equal(fill_unknown(values, known), 0)
    known[0, 0] = True
    np.testing.assert_allclose(fill_unknown(values, known), 0.4, rtol=1e-6)
