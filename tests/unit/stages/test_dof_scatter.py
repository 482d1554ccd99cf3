"""Spreading of light over blur circles."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.stages.dof.blur import LEVELS
from arfx.stages.dof.scatter import scattered

STANDARD = LEVELS["standard"]


def spread(
    light: np.ndarray,
    radius: np.ndarray,
    level: str = "standard",
    corner: tuple[int, int] = (0, 0),
) -> np.ndarray:
    return scattered(light, radius.astype(np.float32), corner, LEVELS[level], 0, 0.0)


def point(size: int = 129) -> np.ndarray:
    light = np.zeros((size, size, 4), np.float32)
    light[size // 2, size // 2] = 1
    return light


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("radius", [2.0, 3.1, 4.7, 7.3, 11.0, 17.0])
def test_its_variance_is_that_of_the_disc(level: str, radius: float) -> None:
    """Averaging over cells and doubling the resolution included: the mean over places of a
    point in a cell.
    """
    x = np.indices((129, 129))[1] - 64
    spreads = [
        spread(point(), np.full((129, 129), radius), level, (k, 3 * k))[..., 0]
        for k in range(8)
    ]
    for out in spreads:
        assert out.sum() == pytest.approx(1.0, abs=1e-4)
    variance = np.mean([float((out * x**2).sum()) for out in spreads])
    # a point is spread as a pixel, whose own variance is 1/12
    assert variance == pytest.approx(radius**2 / 4 + 1 / 12, rel=0.12)


def test_a_sharp_pixel_sends_nothing_and_a_small_disc_ends() -> None:
    assert not spread(point(), np.full((129, 129), 0.5)).any()
    out = spread(point(), np.full((129, 129), 2.0))[..., 3]
    y, x = np.indices((129, 129)) - 64
    assert (out[np.hypot(x, y) > 5] == 0).all() and out[
        np.hypot(x, y) < 1.5
    ].min() > 0.05


@pytest.mark.parametrize("level", LEVELS)
def test_nothing_jumps_when_the_radius_grows(level: str) -> None:
    """A thousandth of the radius more changes next to nothing, through all bins and cells."""
    g = np.random.default_rng(2)
    light = g.random((96, 96, 4), np.float32)
    for radius in np.geomspace(0.55, 30, 40):
        a, b = (
            spread(light, np.full((96, 96), r), level)
            for r in (radius, radius * 1.001)
        )
        assert np.abs(a - b).mean() < 2e-3, radius


def test_a_crop_gives_the_same() -> None:
    g = np.random.default_rng(3)
    light, radius = g.random((160, 160, 4), np.float32), g.uniform(0, 6, (160, 160))
    whole = spread(light, radius)
    part = spread(light[33:130, 21:140], radius[33:130, 21:140], corner=(21, 33))
    np.testing.assert_allclose(
        part[30:-30, 30:-30], whole[63:100, 51:110], rtol=0, atol=1e-6
    )
