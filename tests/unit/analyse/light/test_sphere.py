"""Even directions: unit, evenly spaced, and the nearest against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.light.sphere import (
    DEG_4,
    DEG_8,
    DEG_16,
    DEG_32,
    nearest_cell,
)
from arfx.core.numerics import normalise
from arfx.core.sampling import sphere


@pytest.mark.parametrize(
    ("count", "apart_deg"), [(DEG_32, 32), (DEG_16, 16), (DEG_8, 8), (DEG_4, 4)]
)
def test_directions_are_as_far_apart_as_their_name_says(
    count: int, apart_deg: int
) -> None:
    d = sphere(count)
    assert (
        d.shape == (count, 3) and np.abs(np.linalg.norm(d, axis=1) - 1).max() < 1e-14
    )
    next_deg = np.degrees(np.arccos(np.sort(d @ d.T, 1)[:, -2]))
    assert 0.6 * apart_deg < next_deg.min() and next_deg.max() < 1.2 * apart_deg


def test_nearest_is_the_nearest_of_all_at_any_length() -> None:
    d = normalise(np.random.default_rng(0).normal(size=(2000, 3)))
    brute = (d @ sphere(DEG_16).T).argmax(1)
    assert np.array_equal(nearest_cell(d, DEG_16), brute)
    assert np.array_equal(
        nearest_cell(7 * d.reshape(40, 50, 3), DEG_16).ravel(), brute
    )
