"""Voxels of the model: walls that stay opaque, numbers of docs/methods/gi.md#numbers, memory that grows with the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.core.cube import solid_angles
from arfx.core.model import Model, Part
from arfx.stages.gi.cones import cosine_cones, six_cones, steps_of, trace_many
from arfx.stages.gi.pyramid import atlas_of, levels_of, structure_of
from arfx.stages.gi.voxelise import voxelise
from tests.unit.stages.gi_scenes import GLOWING, MATT_RED, MATT_WHITE, NIGHT, ball, box, box_model, on_plane

WALL = np.array([(7, y, z) for z in range(16) for y in range(16)])


def wall(alpha: float = 1.0) -> np.ndarray:
    values = np.zeros((len(WALL), 4), np.float32)
    values[:, 3] = alpha
    return values


def test_a_wall_one_voxel_thick() -> None:
    levels = levels_of(structure_of(WALL, 16), wall())
    assert [float(v[:, 0, 3].max()) for v in levels[:4]] == [1, 1, 1, 1]
    assert [float(v[:, 0, 3].min()) for v in levels[:4]] == [1, 1, 1, 1]  # the whole wall


def test_no_light_passes_a_wall() -> None:
    """A cone that is eight voxels wide at the wall meets it with one sample of level 3."""
    structure = structure_of(WALL, 16)
    atlas = atlas_of(structure, wall())
    got = trace_many(
        atlas, np.array([[6.0, 3, 1.0]], np.float32),
        np.array([[-2.0, 8, 8]], np.float32), np.array([[[1, 0, 0]]], np.float32), np.zeros((1, 3), np.float32), np.float32(0),
        False,
    )  # fmt: skip
    assert got[0, 3] == pytest.approx(0, abs=1e-6)


def test_seen_edge_on_the_wall_hides_more_and_more_of_less() -> None:
    levels = levels_of(structure_of(WALL, 16), wall())
    expected = [1.0]
    for _ in range(3):  # half of the columns, each behind another
        expected.append(0.5 * (1 - (1 - expected[-1]) ** 2))
    assert [float(v[0, 2, 3]) for v in levels[:4][1:]] == pytest.approx(expected[1:])


def test_nearer_voxels_hide_farther_ones_from_each_side() -> None:
    cells = np.array([(0, 0, 0), (1, 0, 0)])
    values = np.array([[1, 0, 0, 1], [0, 0, 0.5, 0.5]], np.float32)  # red and opaque, then blue and half
    first = levels_of(structure_of(cells, 2), values)[1][0]
    np.testing.assert_allclose(first[0] * 4, [1, 0, 0, 1])  # along +x the red one hides the blue
    np.testing.assert_allclose(first[1] * 4, [0.5, 0, 0.5, 1])  # along -x half of it shows through


def test_levels_need_one_filter_pass_less_than_there_are() -> None:
    for n in (16, 64):
        assert len(structure_of(np.zeros((1, 3), int), n).layers) == int(np.log2(n)) + 1
    assert structure_of(np.zeros((1, 3), int), 64).layers[-1].n == 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_values_between_voxels_are_trilinear_across_bricks(axis: int, sign: int) -> None:
    """A ray along the row of voxels whose opacity rises: the light that is left is the product of what samples between take."""
    cells = np.zeros((8, 3), int)
    cells[:, axis] = np.arange(8)
    values = np.zeros((8, 4), np.float32)
    values[:, 3] = np.linspace(0.02, 0.3, 8)
    structure = structure_of(cells, 8)
    atlas = atlas_of(structure, values)
    steps = np.array([[t, 0, 1.0] for t in np.arange(0.25, 7, 0.5)], np.float32)
    start, d = np.full(3, 0.5), np.zeros(3)
    start[axis], d[axis] = (0.5, 1.0) if sign > 0 else (7.5, -1.0)
    got = trace_many(
        atlas, steps, start[None].astype(np.float32),
        d[None, None].astype(np.float32), np.zeros((1, 3), np.float32), np.float32(0), False,
    )[0, 3]  # fmt: skip
    at = start[axis] + sign * steps[:, 0]
    between = np.interp(at - 0.5, np.arange(8), values[:, 3])
    assert got == pytest.approx(float(np.prod(1 - between)), rel=1e-4)


def through(alpha: float, exponents: list[float]) -> float:
    """What a full block of voxels leaves of a ray whose samples have these step lengths in voxels."""
    cells = np.argwhere(np.ones((8, 8, 8)))
    values = np.zeros((len(cells), 4), np.float32)
    values[:, 3] = alpha
    structure = structure_of(cells, 8)
    atlas = atlas_of(structure, values)
    steps = np.array([[1.5 + k, 0, e] for k, e in enumerate(exponents)], np.float32)
    point, direction = np.full((1, 3), 2.0, np.float32), np.array([[[1, 0, 0]]], np.float32)
    return float(
        trace_many(
            atlas,
            steps,
            point,
            direction,
            np.zeros((1, 3), np.float32),
            np.float32(0),
            False,
        )[0, 3]
    )


def test_half_a_step_takes_its_share_of_the_light() -> None:
    assert 1 - through(0.5, [0.5]) == pytest.approx(0.29289, abs=1e-5)
    assert 1 - through(0.5, [0.5, 0.5]) == pytest.approx(0.5, abs=1e-6)


def test_cone_weights_sum_to_one() -> None:
    directions, weights, tangent = six_cones()
    assert weights.tolist() == pytest.approx([0.25] + [0.15] * 5) and weights.sum() == pytest.approx(1)
    assert tangent == pytest.approx(np.tan(np.radians(30)))
    for d, w, _ in (six_cones(), cosine_cones(16)):
        assert w.sum() == pytest.approx(1, abs=1e-6)
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
        assert (d[:, 2] > 0).all()
    # squares of a unit vector's components sum to 1; the components themselves do not
    assert (directions**2).sum(1) == pytest.approx(np.ones(6), abs=1e-6) and np.abs(directions).sum(1).max() > 1.3


def test_texels_fill_the_sphere() -> None:
    assert 6 * solid_angles(8).sum() == pytest.approx(4 * np.pi)


def test_samples_of_a_cone_leave_no_gap() -> None:
    for tangent in (0.02, 0.2, 0.577):
        steps = steps_of(tangent, 64)
        length = steps[:, 2] * 2 ** steps[:, 1]
        ends = steps[:, 0] + length / 2
        np.testing.assert_allclose(ends[:-1], (steps[:, 0] - length / 2)[1:], rtol=1e-4)
        assert (2 ** steps[:, 1] <= np.maximum(1, 2 * tangent * steps[:, 0] * 1.2)).all()


@pytest.mark.parametrize("n", [32, 64, 128])
def test_surface_is_closed_and_where_it_belongs(n: int) -> None:
    s = on_plane(ball(MATT_RED), NIGHT)
    v = voxelise(s, n)
    away = np.linalg.norm(v.centres_m - [0, 0, 0.06], axis=1)
    assert np.abs(away - 0.06).max() < 1.2 * v.volume.voxel_m
    assert v.centres_m[:, 2].min() > 0  # nothing under the plane it stands on
    np.testing.assert_allclose(v.albedo, np.tile([0.8, 0.04, 0.03], (len(v.albedo), 1)), atol=1e-5)
    outward = ((v.centres_m - [0, 0, 0.06]) / away[:, None] * v.normal).sum(1)
    assert outward.min() > 0.95
    # closed: what fills from outside does not reach the middle
    import scipy.ndimage

    grid = np.zeros((n + 2,) * 3, bool)
    grid[tuple((v.cells[v.opacity > 0.3] + 1).T)] = True
    outside = scipy.ndimage.label(~grid)[0]
    middle = np.floor((np.array([0, 0, 0.06]) - v.volume.low_m) / v.volume.voxel_m).astype(int) + 1
    assert outside[tuple(middle)] != outside[0, 0, 0]


def test_memory_grows_with_the_surface() -> None:
    s = on_plane(ball(MATT_RED, 4), NIGHT)
    made = {n: structure_of(voxelise(s, n).cells, n) for n in (128, 256)}
    size = {n: 4 * m.floats + m.brick_of.nbytes for n, m in made.items()}
    assert 3 < size[256] / size[128] < 5  # 8 without bricks
    assert size[256] < 0.35 * sum(4 * (4 if k == 0 else 24) * layer.n**3 for k, layer in enumerate(made[256].layers))


def test_triangles_that_are_none_count_for_nothing() -> None:
    good = box_model(material=MATT_WHITE)
    p = good.parts[0]
    vertices = np.concatenate([p.vertices, [[np.nan, 0, 0], [0, 0, 0], [0.2, 0.2, 0.2]]])
    n = len(p.vertices)
    faces = np.concatenate([p.faces, [[n, n + 1, n + 2], [n + 1, n + 1, n + 2], [n + 1, n + 2, n + 2]]]).astype(np.int32)
    bad = Model((Part(vertices, faces, np.concatenate([p.normals, np.tile([0, 0, 1.0], (3, 1))]), p.material),), up="z")
    placed = on_plane(good, NIGHT)
    a, b = voxelise(placed, 32), voxelise(replace(placed, model=bad), 32)
    assert np.array_equal(a.cells, b.cells) and np.array_equal(a.opacity, b.opacity)
    assert np.isfinite(b.albedo).all() and np.isfinite(b.normal).all()


def test_order_of_the_triangles_does_not_matter() -> None:
    s = on_plane(box(GLOWING), NIGHT)
    p = s.model.parts[0]
    turned = replace(s, model=Model((replace(p, faces=p.faces[::-1].copy()),), up="z"))
    a, b = voxelise(s, 32), voxelise(turned, 32)
    np.testing.assert_allclose(a.emission, b.emission, atol=1e-5)
    np.testing.assert_allclose(a.emission, np.tile([1, 0.5, 0], (len(a.emission), 1)), atol=1e-5)


def test_two_hundred_thousand_faces() -> None:
    s = on_plane(ball(MATT_RED, 7), NIGHT)  # 327,680
    v = voxelise(s, 64)
    few = voxelise(on_plane(ball(MATT_RED, 5), NIGHT), 64)
    assert abs(len(v.cells) / len(few.cells) - 1) < 0.05
