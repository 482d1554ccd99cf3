"""Dof's draft: the image pyramid blurs as much as a disc does, wherever its cells lie, and keeps weights apart."""

import numpy as np
import pytest

from arfx.core.layers import packed
from arfx.stages.dof.compositing import BLURRED
from arfx.stages.dof.mipmap import Mipmap, composite_real, levels_for, reach_px, shares, squared_radius
from arfx.stages.dof.real_pixels import RealPixels

ALL = np.empty((0, 0), np.float32)


def blurred(
    plate: np.ndarray, radius: np.ndarray | float, corner: tuple[int, int] = (0, 0), visibility: np.ndarray = ALL
) -> tuple[np.ndarray, np.ndarray]:
    """(out (h, w, 3), state (h, w)). plate : (h, w, 3);  radius : px, of each pixel or of all;  corner : x, y in the frame"""
    h, w = plate.shape[:2]
    radii = np.broadcast_to(np.float32(radius), (h, w)).copy()
    real = RealPixels(packed(plate.astype(np.float32)), packed(np.empty((0, 0, 3), np.float32)), (0, 0, 0, 0))
    made = Mipmap(corner, (0, 0, w, h), float(radii.max()))
    made.fill_real(real, radii, visibility, np.float32(0))
    coarse = made.mix()
    out, state = np.empty((h, w, 3), np.float32), np.zeros((h, w), np.uint8)
    composite_real(out, state, (0, w, 0, w), (0, 0, 0), made.odd[0], shares(0), coarse, radii, real, visibility)
    return out, state


@pytest.mark.parametrize("radius", [0.9, 1.5, 2.0, 3.1, squared_radius(2) ** 0.5, 7.0, squared_radius(3) ** 0.5])
def test_its_variance_is_that_of_the_disc(radius: float) -> None:
    """r^2 / 4 on each axis, over all places of a point in a cell; less where a part of the radius counts as sharp."""
    side, n = 8, 96
    y, x = np.indices((n, n))
    variance = []
    for v in range(side):
        plate = np.zeros((n, n, 3))
        plate[n // 2 + v, n // 2 + 3] = 1
        out, _ = blurred(plate, radius)
        assert out.sum() == pytest.approx(3, rel=1e-4)
        away = np.hypot(y - n // 2 - v, x - n // 2 - 3)
        assert out[away > reach_px(float(np.float32(radius)))].max() == 0
        variance.append((out[..., 0] * (y - n // 2 - v) ** 2).sum())
    expected = radius**2 / 4
    if radius < squared_radius(1) ** 0.5:
        low, high = squared_radius(0), squared_radius(1)
        expected = (radius**2 - low) / (high - low)
    assert np.mean(variance) == pytest.approx(expected, rel=1e-3)


def test_what_is_sharp_stays_and_an_even_picture_too() -> None:
    plate = np.random.default_rng(1).random((37, 51, 3)).astype(np.float32)
    radius = np.where(np.arange(51) < 20, 0.5, 5.0) * np.ones((37, 1))
    out, state = blurred(plate, radius)
    np.testing.assert_array_equal(out[:, :20], plate[:, :20])
    assert (state == np.where(radius > 0.5, BLURRED, 0)).all() and (out[:, 20:] != plate[:, 20:]).mean() > 0.99
    np.testing.assert_allclose(blurred(np.full((37, 51, 3), 0.3), 9.0)[0], 0.3, rtol=1e-6)


@pytest.mark.parametrize("corner", [(1, 0), (0, 3), (5, 7), (64, 63)])
def test_cells_lie_in_the_frame_whatever_the_rectangle(corner: tuple[int, int]) -> None:
    """Away from the borders of a rectangle its pixels are those of the whole picture."""
    plate, radius = np.random.default_rng(2).random((160, 180, 3)), 6.0
    whole, _ = blurred(plate, radius)
    x, y = corner
    part, _ = blurred(plate[y:, x:], radius, corner)
    n = reach_px(radius)
    np.testing.assert_allclose(part[n:, n:], whole[y + n :, x + n :], atol=1e-6)


def test_what_is_hidden_spreads_nothing() -> None:
    plate, visibility = np.full((64, 64, 3), 0.2), np.ones((64, 64), np.float32)
    plate[20:40, 20:40], visibility[20:40, 20:40] = 50, 0
    out, _ = blurred(plate, 6.0, visibility=visibility)
    np.testing.assert_allclose(out[visibility > 0], 0.2, rtol=1e-4)


def test_levels_are_as_many_as_the_radius_takes() -> None:
    for largest in (0.6, 2.0, 2.1, 30.0, 1500.0):
        n = levels_for(largest)
        assert squared_radius(n) >= largest**2 and (n == 1 or squared_radius(n - 1) < largest**2)
