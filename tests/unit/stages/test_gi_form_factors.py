"""What planes see of the object, by rays: closed forms, and light that metal and several planes send."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.core.cube import CubeMap, face_directions
from arfx.core.layers import Layer
from arfx.core.model import BLEND, Material, Model
from arfx.stages.gi.field import make_voxel_model
from arfx.stages.gi.form_factors import factors_of, solid, voxel_at
from arfx.stages.gi.frame_light import at_horizon, environment_cube
from arfx.stages.gi.pixels import widened_roughness
from arfx.stages.gi.surroundings import irradiance
from arfx.stages.gi.voxelise import voxelise
from arfx.stages.light.planes import planes_of, texel_positions
from tests.scenes import facts
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    EVEN,
    LAMP,
    MATT_WHITE,
    ball,
    box,
    from_above,
    ground_points,
    on_plane,
    run_gi,
)

RADIUS_M = 0.06


@pytest.mark.parametrize("level", ["standard", "high"])
def test_a_black_ball_takes_its_form_factor_from_the_plane(level: str) -> None:
    """(R / D)^2 times the cosine, all the way to where it stands. Voxels alone take 6 to 10 % of the hemisphere too much."""
    s, pose = on_plane(ball(BLACK, 5), EVEN, CAMERA), from_above(60)
    made = run_gi(s, level, pose)
    g = ground_points(s, pose)
    away = np.hypot(g[..., 0], g[..., 1])
    for low, high in ((0.03, 0.05), (0.05, 0.08), (0.08, 0.12)):
        at = (made[Layer.COVERAGE] == 0) & (away > low) & (away < high)
        lost = 1 - made[Layer.SHADOW][..., 0][at]
        expected = RADIUS_M**3 / (away[at] ** 2 + RADIUS_M**2) ** 1.5
        assert at.sum() > 20 and (lost - expected).mean() == pytest.approx(0, abs=0.012), (low, high)


def test_rays_say_which_voxel_they_meet() -> None:
    s = on_plane(box(MATT_WHITE), EVEN, CAMERA)
    planes, voxels = planes_of(s), voxelise(s, 32)
    cones = np.array([[0, 0, 1.0]])
    f = factors_of(s, voxels, texel_positions(planes, 32)[0], planes.axes[0], cones, 64)
    assert np.bincount(f.texel, minlength=32**2).max() == 64 and f.covered.max() == pytest.approx(1, abs=1e-5)
    # a texel beside the box meets its side and nothing else
    x, y, _ = texel_positions(planes, 32)[0].reshape(-1, 3)[f.texel].T
    beside = (x > 0.065) & (np.abs(y) < 0.05)
    assert beside.sum() > 50
    np.testing.assert_allclose(voxels.centres_m[f.voxel[beside], 0], 0.06, atol=0.6 * voxels.volume.voxel_m)
    inside = f.source != np.arange(32**2)
    assert 0 < inside.sum() < 60, "texels in the box itself take what the nearest outside it has"
    places = voxels.centres_m + 0.4 * voxels.volume.voxel_m * np.array([1, -1, 1])
    np.testing.assert_array_equal(voxel_at(voxels, places), np.arange(len(places)))


def test_what_can_be_seen_through_keeps_its_cones() -> None:
    s = on_plane(box(MATT_WHITE), EVEN, CAMERA)
    part = s.model.parts[0]
    glass = Model((replace(part, material=replace(part.material, alpha_mode=BLEND)),), up="z")
    see_through = on_plane(glass, EVEN, CAMERA)
    assert solid(s) and not solid(see_through)
    assert make_voxel_model(s, 32, planes_of(s), 32, 6, 16).factors
    assert not make_voxel_model(see_through, 32, planes_of(see_through), 32, 6, 16).factors


def test_a_mirror_sends_on_what_it_mirrors_and_no_lamp_as_if_it_were_matt() -> None:
    """Under an even sky and a lamp a matt white ball lights the plane on the lamp's side; a mirror cannot."""
    mirror = Material(base_colour=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
    pose = from_above(60)
    plate = np.full((CAMERA.height, CAMERA.width, 3), 0.4, np.float32)
    lit = {}
    for name, m in (("matt", MATT_WHITE), ("mirror", mirror)):
        s = on_plane(ball(m), LAMP, CAMERA)
        made = run_gi(s, "standard", pose, plate)
        g = ground_points(s, pose)
        d = np.array(LAMP.lights[0].direction)[:2]
        side = (g[..., :2] @ d / np.linalg.norm(d) > 0.03) & (np.hypot(g[..., 0], g[..., 1]) < 0.11) & (made[Layer.COVERAGE] == 0)
        lit[name] = made[Layer.SHADOW][side].mean()
    assert lit["matt"] > lit["mirror"] + 0.01
    assert 0.9 < lit["mirror"] < 1.02


def test_a_guessed_environment_begins_with_the_plane_and_keeps_the_light() -> None:
    up = np.array([0, 0, 1.0])
    cube = np.where(face_directions(8)[..., :1] > 0, 1.6, 0.2) * np.ones(3)
    plane, want = np.array([0.5, 0.4, 0.3]), np.array([0.9, 0.9, 0.9])
    soft = at_horizon(cube, up, plane, want)
    assert soft is not None
    made, factor = soft
    np.testing.assert_allclose(irradiance(made * factor, up), want, rtol=1e-6)
    below, high = face_directions(8)[..., 2] < 0, face_directions(8)[..., 2] > 0.5
    np.testing.assert_allclose((made * factor)[below], np.broadcast_to(plane, (int(below.sum()), 3)))
    np.testing.assert_allclose(made[high], cube[high])
    for nothing in ([np.nan] * 3, [50.0] * 3):
        assert at_horizon(cube, up, np.array(nothing), want) is None
    s = on_plane(box(MATT_WHITE), LAMP, CAMERA)
    f = facts(s, from_above())
    given = environment_cube(f.with_(environment=CubeMap.of(cube)), s, LAMP)[0]
    np.testing.assert_allclose(given, cube, rtol=1e-3)  # a panorama is taken as it is
    guessed = environment_cube(f.with_(environment=CubeMap.of(cube, None, plane)), s, LAMP)[0]
    assert np.abs(guessed - cube).max() > 0.1


@pytest.mark.parametrize("radius_px", [8, 40])
def test_a_curved_mirror_blurs_by_what_a_pixel_holds(radius_px: int) -> None:
    y, x = np.mgrid[-50:51, -50:51] / radius_px
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    normal = np.stack([x, y, z], -1).astype(np.float32)
    coverage = (z > 0).astype(np.float32)
    # half-angle of what a pixel mirrors: the normals' difference, 1 / radius; mirror_tangent is about sqrt(8) roughness^2
    assert np.sqrt(8) * widened_roughness(np.float32(0), coverage, normal, 50, 50) ** 2 == pytest.approx(1 / radius_px, rel=0.05)
    assert widened_roughness(np.float32(0.6), coverage, normal, 50, 50) == pytest.approx(0.6)
    flat = np.tile(np.float32([0, 0, 1]), (5, 5, 1))
    assert widened_roughness(np.float32(0.01), np.ones((5, 5), np.float32), flat, 2, 2) == pytest.approx(0.01)
