"""Shares of directions that triangles leave free, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.sampling import hemisphere
from arfx.stages.triangles import Triangles


def test_the_hemisphere_has_the_right_mean() -> None:
    h = hemisphere(4000)
    np.testing.assert_allclose(np.linalg.norm(h, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(
        h.mean(0), [0, 0, 2 / 3], atol=2e-3
    )  # mean cosine under cosine weighting


def test_a_half_plane_wall_takes_half_the_hemisphere() -> None:
    wall = np.array(
        [[0, -1e4, -1e4], [0, 1e4, -1e4], [0, 1e4, 1e4], [0, -1e4, 1e4]], float
    )
    o = Triangles(wall[[[0, 1, 2], [0, 2, 3]]])
    assert o.visible_fraction(np.array([[0.01, 0, 0.0]]), hemisphere(4096))[
        0
    ] == pytest.approx(0.5, abs=0.01)


def test_a_sphere_overhead_takes_its_form_factor() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    o = Triangles(ball.triangles + np.array([0, 0, 3]))
    # form factor of a sphere above a facing plane element: (r / d)^2
    assert 1 - o.visible_fraction(np.zeros((1, 3)), hemisphere(20000))[
        0
    ] == pytest.approx(1 / 9, rel=0.02)


def test_rays_that_are_left_out_meet_nothing() -> None:
    """Only rays through the box around the triangles are traced: the same as all of them,
    flat along the axes or not.
    """
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (40, 3, 3)) * [1, 0.5, 0.2] + [0, 0, 0.4]
    corners[:20, :, 0] = 0.3
    o = Triangles(corners)
    points = np.concatenate([rng.uniform(-3, 3, (300, 3)), corners[:30].mean(1)])
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    directions = np.concatenate([hemisphere(90), axes])
    met = o.blocked(
        np.repeat(points, len(directions), 0), np.tile(directions, (len(points), 1))
    ).reshape(len(points), -1)
    assert 0.02 < met.mean() < 0.5
    np.testing.assert_allclose(
        o.visible_fraction(points, directions), 1 - met.mean(1), atol=1e-12
    )
