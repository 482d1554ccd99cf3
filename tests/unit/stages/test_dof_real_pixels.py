"""The sharp real scene behind dof: whatever it is made of, one compiled kernel takes it."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from arfx.core.layers import packed
from arfx.stages.dof.real_pixels import RealPixels


def zeros(h: int, w: int) -> np.ndarray:
    return np.zeros((h, w, 3), np.float32)


@pytest.mark.parametrize("flat", [False, True])
def test_another_scene_in_every_pixel_compiles_nothing_anew(flat: bool) -> None:
    """A job with a measured depth gives dof both kinds: a second type would compile its largest kernels in its midst."""
    behind = RealPixels(packed(zeros(32, 48)), packed(zeros(16, 16)), (16, 0, 32, 16))
    whole = behind.with_all(zeros(32, 48))
    assert numba.typeof(whole.flat if flat else whole) == numba.typeof(behind.flat if flat else behind)
