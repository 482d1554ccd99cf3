"""Brightness over time: a walk seen with noise, from all of the past and the future."""

from __future__ import annotations

import numpy as np

from arfx.analyse.light.light_map import UNKNOWN
from arfx.analyse.light.static_frame import smoothed


def walk(values: list[float], variance: list[float], steps: list[int]) -> np.ndarray:
    n = len(values)
    step = np.zeros(n, bool)
    step[steps] = True
    columns = np.tile(np.array(values)[:, None], 3), np.tile(np.array(variance)[:, None], 3)
    return smoothed(np.arange(n) / 30, *columns, step)[:, 0]


def test_one_value_stays() -> None:
    assert walk([0.7], [1e-4], []).tolist() == [0.7]


def test_a_value_that_is_not_seen_is_that_of_its_neighbours() -> None:
    found = walk([1.0, 5.0, 1.0], [1e-4, UNKNOWN, 1e-4], [])
    assert np.allclose(found, 1, atol=1e-3)


def test_noise_is_taken_out_and_steps_stay() -> None:
    noise = np.random.default_rng(1).normal(0, 0.02, 40)
    truth = np.repeat([1.0, 0.5], 20)
    found = walk((truth + noise).tolist(), [0.02**2] * 40, [20])
    assert np.abs(found - truth).max() < 0.5 * np.abs(noise).max()


def test_what_is_hardly_seen_stays_what_it_was() -> None:
    for n in (24, 31, 150, 221):
        found = walk([1.0] * n, [1e-4] * (n // 2) + [UNKNOWN] * (n - n // 2), [n // 2])
        assert np.allclose(found, 1, atol=1e-6)
        dark = walk([1.0] * (n // 2) + [0.0] * (n - n // 2), [1e-4] * n, [n // 2])
        assert np.allclose(dark[n // 2 :], 0, atol=1e-6)
