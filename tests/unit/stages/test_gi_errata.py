"""Each erratum of docs/methods/gi.md#errata that other tests do not show: what is printed, beside what is done instead."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.cube import CubeMap
from arfx.core.light import Light
from arfx.core.model import Material, Model, Part
from arfx.stages.gi.cones import START, Bricks, around_normals, six_cones, steps_of, trace_many
from arfx.stages.gi.frame_light import environment_cube
from arfx.stages.gi.pyramid import atlas_of, levels_of, structure_of
from arfx.stages.gi.surroundings import irradiance
from arfx.stages.gi.voxelise import voxelise
from tests.scenes import facts
from tests.unit.stages.gi_scenes import (
    CAMERA,
    LAMP,
    MATT_RED,
    NIGHT,
    box,
    from_above,
    on_plane,
)


def traced(atlas: Bricks, steps: list[list[float]], origin: list[float], direction: np.ndarray) -> np.ndarray:
    """(4,) of one cone without a surface of its own."""
    out = trace_many(
        atlas, np.array(steps, np.float32), np.array([origin], np.float32),
        np.asarray(direction, np.float32)[None, None], np.zeros((1, 3), np.float32), np.float32(0), False,
    )  # fmt: skip
    return np.asarray(out[0])


def block(alpha: float, n: int = 16) -> Bricks:
    """All of the volume, radiance 1 (premultiplied), opacity alpha."""
    cells = np.argwhere(np.ones((n, n, n)))
    return atlas_of(structure_of(cells, n), np.tile(np.float32([alpha, alpha, alpha, alpha]), (len(cells), 1)))


@pytest.mark.parametrize("direction", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (-2, 1, -3)])
def test_three_faces_are_blended_by_squares(direction: tuple[int, int, int]) -> None:
    """Inside what is equally bright from all sides a coarse sample is as bright; by |n| it is up to sqrt 3 brighter."""
    d = np.array(direction) / np.linalg.norm(direction)
    got = traced(block(1.0), [[0.0, 2, 1.0]], [8, 8, 8], d)
    assert got[:3] == pytest.approx(1, abs=1e-5)
    faces = [0 if d[0] >= 0 else 1, 2 if d[1] >= 0 else 3, 4 if d[2] >= 0 else 5]
    value = levels_of(structure_of(np.argwhere(np.ones((16, 16, 16))), 16), np.ones((16**3, 4), np.float32))[2][0, faces, 0]
    assert (d**2 * value).sum() == pytest.approx(1) and (np.abs(d) * value).sum() == pytest.approx(np.abs(d).sum())
    if np.count_nonzero(d) > 1:
        assert np.abs(d).sum() > 1.25


@pytest.mark.parametrize("parts", [1, 2, 4, 8])
def test_shorter_steps_give_the_same_light(parts: int) -> None:
    """A voxel's length of a glowing medium, in parts: what it sends is 1 - (what it lets through), however it is cut.

    With the opacity corrected and the radiance not, as printed, it grows with the number of parts: twice as bright at four.
    """
    atlas, alpha = block(0.5), 0.5
    steps = [[k / parts, 0, 1 / parts] for k in range(parts)]
    got = traced(atlas, steps, [4, 8, 8], np.array([1, 0, 0]))
    assert got[:3] == pytest.approx(alpha, abs=1e-5) and got[3] == pytest.approx(1 - alpha, abs=1e-5)
    printed, left = 0.0, 1.0
    for _ in range(parts):
        printed += left * alpha  # premultiplied by the opacity of a whole voxel
        left *= (1 - alpha) ** (1 / parts)
    assert printed == pytest.approx(alpha) if parts == 1 else printed > 1.25 * alpha
    if parts == 4:
        assert printed / alpha > 2


def two_colours(swap: bool) -> Model:
    """Two crossing sheets, red and green, that share voxels, in one order or the other."""
    corners = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [-0.5, 0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    parts = [
        Part(corners, faces, np.tile([0, -1.0, 0], (4, 1)), Material(base_colour=(1.0, 0, 0, 1), specular=0.0)),
        Part(corners[:, [1, 0, 2]], faces, np.tile([1.0, 0, 0], (4, 1)), Material(base_colour=(0, 1.0, 0, 1), specular=0.0)),
    ]
    return Model(tuple(parts[::-1] if swap else parts), up="z")


def test_what_shares_a_voxel_is_averaged_whatever_the_order() -> None:
    """Overwriting, as printed, leaves the colour that came last."""
    a, b = (voxelise(on_plane(two_colours(swap), NIGHT), 32) for swap in (False, True))
    np.testing.assert_allclose(a.albedo, b.albedo, atol=1e-5)
    shared = (a.albedo[:, 0] > 0.2) & (a.albedo[:, 1] > 0.2)
    assert shared.sum() > 10, "along the line where they cross"
    for made, last in ((a, [0.0, 1.0, 0.0]), (b, [1.0, 0.0, 0.0])):
        assert np.abs(made.albedo[shared] - last).max(1).min() > 0.15


@pytest.mark.parametrize("normal", [(0, 0, 1.0), (0.5, 0.2, 0.8), (1.0, 1.0, 1.0)])
def test_cones_begin_off_their_own_surface(normal: tuple[float, float, float]) -> None:
    """From the surface itself they meet its voxels: a convex object would hide the light from itself."""
    n = np.array(normal) / np.linalg.norm(normal)
    cells = np.argwhere(np.ones((32, 32, 32)))
    height = (cells + 0.5 - 16) @ n
    cells = cells[np.abs(height) < 0.6]
    values = np.zeros((len(cells), 4), np.float32)
    values[:, 3] = 1
    atlas = atlas_of(structure_of(cells, 32), values)
    six, weights, tan_half = six_cones()
    around = around_normals(n[None].astype(np.float32), six)
    left = []
    for start, clip in ((0.0, False), (float(START), True)):
        out = trace_many(
            atlas, steps_of(tan_half, 32), np.full((1, 3), 16, np.float32),
            around, n[None].astype(np.float32), np.float32(start), clip,
        )  # fmt: skip
        left.append(float(out[:, 3] @ weights))
    assert np.sqrt(3) == pytest.approx(START)
    assert left[0] < 0.6 and left[1] > 0.97


def test_the_lamps_are_no_part_of_the_environment() -> None:
    """A picture of the surroundings holds a clipped lamp at most: it is scaled to the light without lamps, those stay exact."""
    cube = np.full((6, 8, 8, 3), 0.3)
    cube[4, 3:5, 3:5] = 1.0  # clipped
    s = on_plane(box(MATT_RED), LAMP, CAMERA)
    f = facts(s, from_above()).with_(environment=CubeMap.of(cube))
    got, factor = environment_cube(f, s, LAMP)
    up = np.array([0, 0, 1.0])
    np.testing.assert_allclose(irradiance(got * factor, up), LAMP.soft_radiance(up), rtol=1e-3)
    assert (LAMP.radiance(up) > 1.5 * LAMP.soft_radiance(up)).all(), "all of the light would count the lamp twice"


def test_the_light_is_the_frames_own() -> None:
    s = on_plane(box(MATT_RED), NIGHT, CAMERA)
    own = Light((0.2, 0.1, 0.1), ())
    assert s.light_of(facts(s).with_(light=own)) is own and s.light_of(facts(s)) is NIGHT
