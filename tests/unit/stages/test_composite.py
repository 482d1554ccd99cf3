"""The plane's pixels under a shadow, of parts of larger arrays into parts of larger ones."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.stages.composite import shade

g = np.random.default_rng(0)
PLATE = g.random((40, 50, 3), dtype=np.float32)
SHADOW = g.random((40, 50, 3), dtype=np.float32)


@pytest.mark.parametrize(
    "part", [np.s_[:, :], np.s_[7:31, 5:44], np.s_[9:10, 3:4], np.s_[2:20, 8:9]]
)
def test_light_is_taken_from_the_part_alone_and_the_bias_stays(
    part: tuple[slice, slice],
) -> None:
    out, bias, opacity = (
        np.full((40, 50, 3), -1, np.float32),
        np.array([0.1, 0.05, 0.02], np.float32),
        np.float32(0.7),
    )
    shade(PLATE[part], SHADOW[part], opacity, bias, out[part])
    want = np.full(out.shape, -1.0)
    want[part] = bias + (1 + opacity * (SHADOW[part].astype(float) - 1)) * (
        PLATE[part] - bias
    )
    np.testing.assert_allclose(out, want, atol=1e-6)


def test_a_part_without_pixels() -> None:
    shade(
        PLATE[3:3],
        SHADOW[3:3],
        np.float32(1),
        np.zeros(3, np.float32),
        np.empty((0, 50, 3), np.float32),
    )
