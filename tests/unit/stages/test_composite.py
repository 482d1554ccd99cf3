"""The plane's pixels under a shadow: light is taken, what the camera adds stays."""

from __future__ import annotations

import numpy as np

from arfx.stages.composite import over

g = np.random.default_rng(0)
PLATE = g.random((40, 50, 3), dtype=np.float32)
SHADOW = g.random((40, 50, 3), dtype=np.float32)
NOTHING = np.zeros((40, 50, 3), np.float32), np.zeros((40, 50), np.float32)


def test_light_is_taken_and_the_bias_stays() -> None:
    out, bias = np.empty_like(PLATE), np.array([0.1, 0.05, 0.02], np.float32)
    opacity = np.float32(0.7)
    over(PLATE, *NOTHING, SHADOW, opacity, bias, out)
    want = bias + (1 + opacity * (SHADOW.astype(float) - 1)) * (PLATE - bias)
    np.testing.assert_allclose(out, want, atol=1e-6)


def test_where_nothing_is_virtual_every_bit_stays() -> None:
    out, bias = np.empty_like(PLATE), np.array([0.1, 0.05, 0.02], np.float32)
    over(PLATE, *NOTHING, np.ones_like(PLATE), np.float32(0.7), bias, out)
    np.testing.assert_array_equal(out, PLATE)
