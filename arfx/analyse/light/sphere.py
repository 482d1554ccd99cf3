"""Cells of directions in even steps over the whole sphere."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.numerics import normalise
from arfx.core.sampling import sphere

# how many stand about so far apart
DEG_32, DEG_16, DEG_8, DEG_4 = 42, 162, 642, 2562


@lru_cache(maxsize=8)
def _tree(count: int) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(sphere(count))


def nearest_cell(directions: ndarray, count: int) -> ndarray:
    """(...) which of `sphere(count)` is nearest to (..., 3), of any finite length
    above 0."""
    return np.asarray(_tree(count).query(normalise(np.asarray(directions, float)))[1])
