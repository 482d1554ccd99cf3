"""Yao, Tao, Wu 2018 as printed, the volumes: octree, mean of children, cones."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.papers.s4_cones import cone_trace
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_volumes import (
    Volumes,
    morton,
    node_below,
    octree_of,
    step2_volumes,
)
from arfx.papers.s4_voxels import Volume
from tests.unit.stages.gi_scenes import LAMP, MATT_RED, box, on_plane

N = 16
CUBE = Volume(N, (0.0, 0.0, 0.0), 1.0)
WALL = np.array([(7, y, z) for z in range(N) for y in range(N)])


def filled(
    cells: np.ndarray,
    alpha: float = 1.0,
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Volumes:
    normals = np.tile(normal, (len(cells), 1))
    return octree_of(CUBE, cells, normals, np.full(len(cells), alpha))


def scene_volumes(n: int) -> Volumes:
    s = on_plane(box(MATT_RED), LAMP)
    return step2_volumes(step1_mesh(s, 0.5), s, n)


def traced(
    volumes: Volumes,
    V: np.ndarray,
    steps: list[list[float]],
    start: list[float],
    d: list[float],
) -> np.ndarray:
    walk = np.array(steps, np.float32)
    return np.asarray(
        cone_trace(volumes, V, walk, np.array([start]), np.array([[d]]))[0, 0]
    )


def test_a_wall_one_voxel_thick_leaks() -> None:
    wall = filled(WALL)
    opacity = [wall.tree.eta[wall.rows_of(level), 3] for level in range(4)]
    assert [set(a.tolist()) for a in opacity] == [{1.0}, {0.5}, {0.25}, {0.125}]
    nothing = np.zeros((len(wall.tree.eta), 3), np.float32)
    got = traced(wall, nothing, [[6.0, 3, 1.0]], [-2, 8, 8], [1, 0, 0])
    assert got[3] == pytest.approx(0.875), "a cone eight voxels wide at the wall"
    got = traced(wall, nothing, [[9.5, 0, 1.0]], [-2, 8, 8], [1, 0, 0])
    assert got[3] == 0, "one as wide as a voxel"


def test_nothing_empty_is_stored_and_everything_else_is_found() -> None:
    cells = np.unique(np.random.default_rng(1).integers(0, N, (60, 3)), axis=0)
    made = filled(cells)
    ancestors = sum(len(np.unique(cells >> level, axis=0)) for level in range(5))
    assert (
        len(made.tree.eta) == ancestors and len(made.starts) == 4 == made.tree.depth
    ), "n levels, n - 1 steps"
    assert (made.tree.eta[:, 3] > 0).all()
    stored = {tuple(c) for c in cells}
    lowest = made.rows_of(0).start
    for x, y, z in np.ndindex(N, N, N):
        node = node_below(made.tree, 0, 4, x, y, z)
        assert (node >= 0) == ((x, y, z) in stored)
        if node >= 0:
            assert made.codes[node - lowest] == morton(np.array([[x, y, z]]))[0]
            assert (
                made.leaf_of(np.array([[x + 0.5, y + 0.5, z + 0.5]]))[0]
                == node - lowest
            )
    assert (made.leaf_of(np.array([[-0.5, 3, 3], [3, 3, N + 0.5]])) == -1).all()


def test_the_root_is_the_mean_of_all_voxels() -> None:
    cells = np.unique(np.random.default_rng(2).integers(0, N, (60, 3)), axis=0)
    made, values = filled(cells), np.random.default_rng(3).random((len(cells), 3))
    np.testing.assert_allclose(
        made.filtered(values)[0], values.sum(0) / N**3, rtol=1e-5
    )


def test_half_a_step() -> None:
    """The opacity is corrected for the step, .29289 for half of one at .5; the radiance is
    not, as printed.
    """
    every = np.argwhere(np.ones((N, N, N)))
    half = filled(every, 0.5)
    V = half.filtered(np.full((len(every), 3), 0.5))
    one = traced(half, V, [[0.0, 0, 0.5]], [8, 8, 8], [1, 0, 0])
    two = traced(half, V, [[0.0, 0, 0.5], [0.5, 0, 0.5]], [8, 8, 8], [1, 0, 0])
    four = traced(half, V, [[k / 4, 0, 0.25] for k in range(4)], [8, 8, 8], [1, 0, 0])
    assert (
        1 - one[3] == pytest.approx(0.29289, abs=1e-5)
        and two[3] == pytest.approx(0.5)
        and four[3] == pytest.approx(0.5)
    )
    assert one[0] == pytest.approx(0.5) and two[0] == pytest.approx(
        0.5 + 0.5 * np.sqrt(0.5)
    )
    assert four[0] / 0.5 > 2, "over twice as bright as a whole step"


def test_voxels_that_face_away_are_not_met() -> None:
    """What V_eta is for: a surface does not hide the light from itself."""
    floor = np.array([(x, y, 7) for y in range(N) for x in range(N)])
    up = filled(floor, 1.0, (0.0, 0.0, 1.0))
    V = up.filtered(np.ones((len(floor), 3)))
    away = traced(
        up, V, [[t, 0, 1.0] for t in (0.5, 1.0, 1.5)], [8, 8, 7.5], [0.6, 0, 0.8]
    )
    onto = traced(
        up, V, [[t, 0, 1.0] for t in (0.5, 1.0, 1.5)], [8, 8, 8.5], [0.6, 0, -0.8]
    )
    assert away.tolist() == [0, 0, 0, 1] and onto[3] < 0.05 and onto[0] > 0.9


def test_the_volume_of_normals_holds_the_plane_and_the_object() -> None:
    made = scene_volumes(32)
    eta = made.tree.eta[made.rows_of(0)]
    middle = made.leaf_of(np.array([[0.0, 0.0, 1e-6], [0.09, 0.09, 1e-6]]))
    assert (middle >= 0).all()
    np.testing.assert_allclose(
        eta[middle[1]], [0, 0, 1, 1], atol=1e-5
    )  # the plane beside the object
    horizontal = np.linalg.norm(eta[:, :2], axis=1) / eta[:, 3]
    assert (horizontal > 0.99).sum() > 100, "the box's sides"


def test_the_octree_grows_with_the_surface() -> None:
    (few, dense32), (many, dense64) = (
        scene_volumes(n).memory_bytes(4) for n in (32, 64)
    )
    assert dense64 / dense32 == pytest.approx(8, rel=1e-3) and many / few < 5
    assert many < 0.06 * dense64
