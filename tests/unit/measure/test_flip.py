"""FLIP: known values, its range, and that a mask changes nothing but the price."""

import numpy as np
import pytest

from arfx.errors import InputError
from arfx.measure.flip import REACH_PX, flip_map, flip_where


def _pair(h, w, noise=0.05, seed=0):
    r = np.random.default_rng(seed)
    a = r.random((h, w, 3)).astype(np.float32)
    return a, np.clip(a + r.normal(0, noise, a.shape), 0, 1).astype(np.float32)


def test_equal_pictures_differ_by_nothing_and_black_from_white_by_the_published_most():
    a, _ = _pair(24, 31)
    assert flip_map(a, a).max() < 1e-5
    black, white = np.zeros((12, 14, 3), np.uint8), np.full((12, 14, 3), 255, np.uint8)
    assert flip_map(black, white) == pytest.approx(0.9674, abs=1e-3)


def test_grows_with_the_difference_and_is_the_same_for_bytes():
    means = [flip_map(*_pair(40, 40, noise)).mean() for noise in (0.01, 0.05, 0.2)]
    assert means == sorted(means) and means[0] > 0.01
    a, b = ((p * 255).round().astype(np.uint8) for p in _pair(40, 40))
    assert np.allclose(flip_map(a, b), flip_map(a / 255, b / 255), atol=1e-5)


def test_a_mask_gives_the_numbers_of_the_whole_picture():
    a, b = _pair(70, 80)
    where = np.zeros((70, 80), bool)
    where[25:40, 30:52] = True
    where[30, 35] = False
    assert np.abs(flip_where(a, b, where) - flip_map(a, b)[where]).max() < 2e-5
    narrower = flip_map(a[28:37, 33:49], b[28:37, 33:49])  # without the surroundings they are others: the reach is needed
    assert np.abs(narrower - flip_map(a, b)[28:37, 33:49]).max() > 1e-2
    assert REACH_PX >= 10 and flip_where(a, b, where & False).shape == (0,)


def test_refuses_what_cannot_be_compared():
    a, b = _pair(8, 9)
    with pytest.raises(InputError, match="one size"):
        flip_map(a, b[:, :-1])
    b[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        flip_map(a, b)
