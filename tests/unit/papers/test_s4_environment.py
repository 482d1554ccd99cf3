"""Yao, Tao, Wu 2018 as printed: the environment cube of one picture, its mip levels, and
what cones let through of it.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.cube import face_directions, look_up
from arfx.papers.s4_environment import (
    FULL,
    mip_level,
    step3_environment,
    step3_mipmap,
    step4_environment,
)


@pytest.mark.parametrize(
    ("half_deg", "level"), [(1, 1.45), (5, 3.77), (15, 5.36), (30, 6.34)]
)
def test_the_level_of_a_cone(half_deg: float, level: float) -> None:
    assert mip_level(half_deg, 128) == pytest.approx(level, abs=0.006)


def test_the_cube_is_rgba16_with_all_its_levels() -> None:
    cube = np.random.default_rng(0).random((6, 128, 128, 3)) * 1.5
    levels = step3_mipmap(cube)
    assert [a.shape for a in levels] == [
        (6, n + 2, n + 2, 4) for n in (128, 64, 32, 16, 8, 4, 2, 1)
    ]
    assert {a.dtype for a in levels} == {np.dtype(np.uint16)}
    assert levels[0].max() == FULL and (levels[0][..., 3] == FULL).all(), "cut at 1"
    np.testing.assert_allclose(
        levels[-1][:, 1, 1, :3] / FULL, np.clip(cube, 0, 1).mean((1, 2)), atol=1e-4
    )


def test_a_constant_picture_is_the_same_from_everywhere_and_at_every_level() -> None:
    levels = step3_mipmap(step3_environment(np.full((9, 12, 3), 0.25), 16))
    d = face_directions(4).reshape(-1, 3)
    for half_deg in (0.1, 7.0, 30.0, 80.0):
        np.testing.assert_allclose(
            step4_environment(levels, d, half_deg), 0.25, atol=2e-5
        )


def test_thirds_of_the_picture_lie_where_the_paper_puts_them() -> None:
    picture = np.zeros((90, 90, 3))
    picture[30:60, 60:, 0] = 1.0  # right
    picture[60:, 30:60, 1] = 1.0  # below
    picture[30:60, 30:60, 2] = np.linspace(
        0, 1, 30
    )  # the middle, brighter to the right
    levels = step3_mipmap(step3_environment(picture, 32))
    right, left, down, up, front, back = step4_environment(
        levels, np.vstack([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]], 0.5
    )
    assert (
        right.tolist() == [1, 0, 0]
        and down.tolist() == [0, 1, 0]
        and left.max() == 0 == up.max()
    )
    np.testing.assert_allclose([front[2], back[2]], 0.5, atol=0.02)
    aside = step4_environment(
        levels, np.array([[0.5, 0, 1.0], [0.5, 0, -1.0], [-0.5, 0, -1.0]]), 0.5
    )
    assert (
        aside[0, 2] == pytest.approx(aside[1, 2])
        and aside[1, 2] > 0.7 > 0.3 > aside[2, 2]
    ), "mirrored behind"


def test_a_wide_cone_sees_the_mean_of_what_is_around() -> None:
    picture = np.zeros((96, 96, 3))
    picture[32:64, 32:64] = (np.indices((32, 32)).sum(0) % 2)[
        ..., None
    ]  # a chessboard in front
    levels = step3_mipmap(step3_environment(picture, 32))
    ahead = np.array([[0.03, 0.03, 1.0]])
    assert step4_environment(levels, ahead, 15.0)[0, 0] == pytest.approx(
        0.5, abs=0.01
    )
    assert abs(step4_environment(levels, ahead, 0.3)[0, 0] - 0.5) > 0.3


def test_no_line_shows_at_the_cubes_edges_that_is_not_in_the_cube() -> None:
    """Coarse levels have few texels, and are linear over the edges too."""
    smooth = (
        0.5
        + 0.3
        * face_directions(16)
        @ np.array([[1.0, 0, 0], [0, 1, 0], [0.6, 0, 0.8]]).T
    )
    levels = step3_mipmap(smooth)
    a = np.radians(np.linspace(0, 360, 721))
    around = np.stack([np.cos(a), 0.3 * np.ones_like(a), np.sin(a)], -1)
    for half_deg in (1.0, 15.0, 30.0, 50.0):
        seen = step4_environment(levels, around, half_deg)
        assert np.abs(np.diff(seen, axis=0)).max() < 0.01, "of half a degree"


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1, 1])
def test_what_is_continuous_in_the_picture_is_so_from_the_front_to_its_sides(
    axis: int, side: int
) -> None:
    ramp = np.broadcast_to(np.linspace(0, 1, 96), (96, 96))
    picture = np.repeat((ramp if axis == 0 else ramp.T)[..., None], 3, -1).astype(
        np.float32
    )
    across = np.array([side * 0.98, side * 1.02, side * 3.0])
    d = np.zeros((3, 3))
    d[:, axis], d[:, 2] = across, 1.0
    front, beside, far = look_up(step3_environment(picture, 64), d)[:, 0]
    assert abs(front - beside) < 0.02 and abs(far - beside) > 0.1
