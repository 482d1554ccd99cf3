"""Light from place to place against closed forms: form factors, a cavity, mirrors."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import Material, Model, Part
from arfx.stages.gi import GiParams
from arfx.stages.light.surfels import ObjectRays, surfels_of
from tests.scenes import facts
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    EVEN,
    LAMP,
    MATT_RED,
    MATT_WHITE,
    NIGHT,
    ball,
    box,
    from_above,
    ground_points,
    inner,
    on_plane,
    plain_plate,
    run_gi,
)

RADIUS_M = 0.06


def bowl(material: Material, thickness: float = 0.02) -> Model:
    """A thin half ball of radius 1, open above."""
    angle = np.linspace(np.pi / 2, np.pi, 40)
    rim = np.column_stack([np.sin(angle), 1 + np.cos(angle)])
    profile = np.concatenate([rim[::-1], (1 - thickness) * (rim - [0, 1]) + [0, 1]])
    profile[[0, -1], 0] = 0
    mesh = trimesh.creation.revolve(profile, sections=96)
    part = Part(
        np.array(mesh.vertices),
        np.array(mesh.faces, np.int32),
        np.array(mesh.vertex_normals),
        material,
    )
    return Model((part,), up="z", source="bowl")


@pytest.mark.parametrize(("level", "most"), [("draft", 0.05), ("standard", 0.03)])
def test_a_thin_bowl_is_as_bright_inside_as_a_half_ball_and_has_no_dark_dots(
    level: str, most: float
) -> None:
    """Each place of a ball's inside sees every other alike: f / (1 - albedo (1 - f)) of the
    sky, f = 1 / 2 of it open.
    """
    grey = Material(base_colour=(0.5, 0.5, 0.5, 1.0), specular=0.0, roughness=1.0)
    s, pose = on_plane(bowl(grey), EVEN, CAMERA), from_above(0, 0.35)
    made = run_gi(s, level, pose, plain_plate(rgb=(0, 0, 0)))
    g = ground_points(s, pose)
    inside = inner(made[Layer.COVERAGE]) & (
        np.hypot(g[..., 0], g[..., 1]) < 0.9 * RADIUS_M
    )
    light = made[Layer.VIRTUAL][inside][:, 0] / 0.5
    expected = 0.5 / (1 - 0.5 * 0.5)
    assert inside.sum() > 1000 and light.mean() == pytest.approx(expected, rel=most)
    assert (
        light.min() > (1 - 4 * most) * expected
        and light.max() < (1 + 4 * most) * expected
    )


def test_paths_of_the_reference_end_late_enough() -> None:
    """The same inside of a bright bowl; after three places it was 1.5 % off."""
    bright = Material(base_colour=(0.9, 0.9, 0.9, 1.0), specular=0.0, roughness=1.0)
    s, pose = on_plane(bowl(bright), EVEN, CAMERA), from_above(0, 0.35)
    made = run_gi(
        s, "reference", pose, plain_plate(rgb=(0, 0, 0)), GiParams(samples=16)
    )
    g = ground_points(s, pose)
    inside = inner(made[Layer.COVERAGE]) & (
        np.hypot(g[..., 0], g[..., 1]) < 0.7 * RADIUS_M
    )
    light = made[Layer.VIRTUAL][inside][:, 0].mean() / 0.9
    assert light == pytest.approx(0.5 / (1 - 0.9 * 0.5), rel=0.005)


@pytest.mark.parametrize("level", ["draft", "standard"])
def test_a_black_ball_takes_its_form_factor_from_the_plane(level: str) -> None:
    """(R / D)^2 times the cosine, all the way to where it stands."""
    s, pose = on_plane(ball(BLACK, 5), EVEN, CAMERA), from_above(60)
    made = run_gi(s, level, pose)
    g = ground_points(s, pose)
    away = np.hypot(g[..., 0], g[..., 1])
    for low, high in ((0.03, 0.05), (0.05, 0.08), (0.08, 0.12)):
        at = (made[Layer.COVERAGE] == 0) & (away > low) & (away < high)
        lost = 1 - made[Layer.SHADOW][..., 0][at]
        expected = RADIUS_M**3 / (away[at] ** 2 + RADIUS_M**2) ** 1.5
        assert at.sum() > 20 and (lost - expected).mean() == pytest.approx(
            0, abs=0.012
        ), (
            low,
            high,
        )


def test_a_mirror_sends_on_what_it_mirrors_and_no_lamp_as_if_it_were_matt() -> None:
    """Under an even sky and a lamp a matt white ball lights the plane on the lamp's side; a
    mirror cannot.
    """
    mirror = Material(base_colour=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
    pose = from_above(60)
    plate = np.full((CAMERA.height, CAMERA.width, 3), 0.4, np.float32)
    lit = {}
    for name, m in (("matt", MATT_WHITE), ("mirror", mirror)):
        s = on_plane(ball(m), LAMP, CAMERA)
        made = run_gi(s, "standard", pose, plate)
        g = ground_points(s, pose)
        d = np.array(LAMP.lights[0].direction)[:2]
        side = (
            (g[..., :2] @ d / np.linalg.norm(d) > 0.03)
            & (np.hypot(g[..., 0], g[..., 1]) < 0.11)
            & (made[Layer.COVERAGE] == 0)
        )
        lit[name] = made[Layer.SHADOW][side].mean()
    assert lit["matt"] > lit["mirror"] + 0.01
    assert 0.9 < lit["mirror"] < 1.02


def test_the_light_is_the_frames_own() -> None:
    s = on_plane(box(MATT_RED), NIGHT, CAMERA)
    own = Light((0.2, 0.1, 0.1), ())
    assert (
        s.light_of(facts(s).with_(light=own)) is own and s.light_of(facts(s)) is NIGHT
    )


def with_a_rod(material: Material) -> Model:
    """A cube, and a thin rod that stands in the middle of its top."""
    cube = trimesh.creation.box((2, 2, 2))
    rod = trimesh.creation.cylinder(0.02, 1.0, sections=24)
    rod.apply_translation((0, 0, 1.5))
    parts = [
        Part(
            mesh.vertices[mesh.faces].reshape(-1, 3),
            np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3),
            np.repeat(mesh.face_normals, 3, 0),
            material,
        )
        for mesh in (cube, rod)
    ]
    return Model(tuple(parts), up="z", source="rod")


def test_points_stand_for_the_area_that_they_have() -> None:
    """Thin parts have more points, which count for less: they do not darken what they stand on."""
    rays = ObjectRays(on_plane(with_a_rod(MATT_WHITE), EVEN, CAMERA))
    surfels = surfels_of(rays, 20_000)
    of_rod = rays.part[surfels.face] == 1
    true = np.linalg.norm(rays.across, axis=1)
    share = true[rays.part == 1].sum() / true.sum()
    assert of_rod.mean() > 2 * share
    counted = surfels.area[of_rod].sum() / surfels.area.sum()
    np.testing.assert_allclose(counted, share, rtol=0.1)
