"""Rows that are the same, as numpy finds them, while other threads work."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.numerics import same_rows

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "rows",
    [
        RNG.integers(-2, 3, (1000, 3)) * 1.0,
        -0.0 * RNG.integers(0, 2, (50, 3)),
        RNG.integers(0, 9, (400, 2)),
        np.zeros((0, 3)),
    ],
)
def test_same_rows_are_those_of_unique(rows: np.ndarray) -> None:
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    mine = same_rows(rows)
    np.testing.assert_array_equal(mine[0], first)
    np.testing.assert_array_equal(mine[1], which.ravel())
