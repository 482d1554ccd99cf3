"""What the reference's samples are drawn from, and where they end."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.numerics import normalise
from arfx.stages.gi.reference import _width
from arfx.stages.gi.reference_noise import BATCH_SAMPLES, LEAST_BATCHES, NOISE, settled
from arfx.stages.gi.reference_sampling import Sampler, cosine_density, towards_ball
from arfx.stages.gi.reference_scene import Surroundings

PIXELS = np.arange(500, dtype=np.uint32) * np.uint32(7919)


@pytest.mark.parametrize("count", [4, 16, 64])
@pytest.mark.parametrize("first", [0, 64])
def test_samples_of_a_pixel_are_even(count: int, first: int) -> None:
    """One in each row, column and square of a grid, in every run of 4^k samples: not so under chance alone."""
    across = round(count**0.5)
    drawn = np.array([Sampler(PIXELS[:3], s, 5).pair() for s in range(first, first + count)])
    for u, v in drawn.transpose(2, 1, 0):
        assert sorted((u * count).astype(int)) == sorted((v * count).astype(int)) == list(range(count))
        assert len(set(zip((u * across).astype(int), (v * across).astype(int), strict=True))) == count


def test_pixels_are_not_alike() -> None:
    u, v = Sampler(PIXELS, 0, 5).pair()
    assert abs(np.corrcoef(u, v)[0, 1]) < 0.15 and np.histogram(u, 4, (0, 1))[0].min() > 90
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 0.15


def test_rays_towards_a_ball_bring_its_form_factor() -> None:
    """Far away every ray counts; nearby they are the plane's own. The ball stands over the plane: F = r^2 h / d^3."""
    normal, centre = np.array([0.0, 0, 1]), np.array([0.0, 0, 1.2])
    for x in (0.0, 1.5, 6.0):
        points, normals = np.tile([x, 0, 0.0], (500, 1)), np.tile(normal, (500, 1))
        got = np.zeros(500)
        for s in range(16):
            d, density, near = towards_ball(points, normals, centre, 1.0, Sampler(PIXELS, s, 5))
            to = centre - points
            along = (d * to).sum(1)
            hit = (along > 0) & ((to**2).sum(1) - along**2 <= 1 + 1e-9)
            assert hit.all() or near.all()
            got += hit * cosine_density(normals, d) / density / 16
        away = np.hypot(x, 1.2)
        assert got.mean() == pytest.approx(1.2 / away**3, rel=0.02)
        assert near.all() if x == 0 else got.std() < 0.1 * got.mean()


def test_quiet_pixels_end_early_and_noisy_ones_do_not() -> None:
    taken = np.zeros(300, int)

    def draw(rows: np.ndarray, s: int) -> np.ndarray:
        taken[rows] += 1
        noise = np.random.default_rng(s).normal(size=300)[rows] * np.where(rows < 100, 0.0, 20.0)
        return np.repeat((7.0 + noise)[:, None], 3, 1)

    most = np.where(np.arange(300) < 200, 64, 2)
    got = settled(draw, lambda values, rows: values, most)
    assert (taken[:100] == BATCH_SAMPLES * LEAST_BATCHES).all() and (got[:100] == 7).all()
    assert taken[100:200].mean() > 60 and (taken[200:] == 2).all()
    assert 4 * NOISE < got[100:200].std() < 4


def test_what_nobody_saw_is_as_bright_as_the_ray_is_wide() -> None:
    """A mirror looks through between the lamps that a matt surface takes light from."""
    around = Surroundings.__new__(Surroundings)
    around.narrow, around.cube, around.turn = np.full((6, 4, 4, 3), 0.2), np.full((6, 4, 4, 3), 1.0), np.eye(3)
    widths = _width(np.array([0.0, 0.35, 1.0]))
    assert widths[0] == 0 and 0.2 < widths[1] < 0.9 and widths[2] == 1
    got = around.environment(normalise(np.ones((3, 3))), widths)
    assert got[:, 0] == pytest.approx(0.2 + 0.8 * widths)
