"""The contact shadow against closed forms, and where it lies in the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.core.layers import Layer, Layers
from arfx.core.light import DirectionalLight, Light
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Window
from arfx.stages.contact import SHOWS, Contact, ContactParams, faded, light_left, outline_m
from arfx.stages.occlusion import Occluder, cone, hemisphere
from tests.scenes import box_model, camera, facts, look_at, scene


def test_direction_sets_have_the_right_means() -> None:
    h = hemisphere(4000)
    np.testing.assert_allclose(np.linalg.norm(h, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(h.mean(0), [0, 0, 2 / 3], atol=2e-3)  # mean cosine under cosine weighting
    axis = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    c = cone(axis, 20, 500)
    assert np.degrees(np.arccos((c @ axis).min())) == pytest.approx(10, abs=0.2)
    np.testing.assert_allclose(c.mean(0) / np.linalg.norm(c.mean(0)), axis, atol=1e-3)


def test_a_half_plane_wall_takes_half_the_hemisphere() -> None:
    wall = np.array([[0, -1e4, -1e4], [0, 1e4, -1e4], [0, 1e4, 1e4], [0, -1e4, 1e4]], float)
    o = Occluder(wall, np.array([[0, 1, 2], [0, 2, 3]]))
    assert o.visible_share(np.array([[0.01, 0, 0.0]]), hemisphere(4096))[0] == pytest.approx(0.5, abs=0.01)


def test_a_sphere_overhead_takes_its_form_factor() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    o = Occluder(ball.vertices + np.array([0, 0, 3]), ball.faces)
    # form factor of a sphere above a facing plane element: (r / d)^2
    assert 1 - o.visible_share(np.zeros((1, 3)), hemisphere(20000))[0] == pytest.approx(1 / 9, rel=0.02)


def light_scene(elevation_deg: float, size_deg: float = 1.0) -> Scene:
    s = scene(camera(320, 240))
    e = np.radians(elevation_deg)
    light = Light((0.0, 0.0, 0.0), (DirectionalLight((np.cos(e), 0.0, np.sin(e)), (1.0, 1.0, 1.0), size_deg),))
    return Scene(s.camera, s.model, s.world_from_model, s.markers, s.world_from_marker, light=light)


def test_a_directional_shadow_has_the_length_of_the_object_over_tan_elevation() -> None:
    s = light_scene(45)
    centre, half = np.array([-0.05, 0.0]), np.array([0.18, 0.12])
    n = 256
    left = light_left(s, centre, half, n, 64)[..., 0]
    x = centre[0] + half[0] * ((np.arange(n) + 0.5) / n * 2 - 1)
    row = left[int((0 - centre[1]) / half[1] * n / 2 + n / 2)]
    dark = x[row < 0.5]
    # a 12 cm cube under light from +x at 45 degrees: dark from -6 - 12 cm to +6 cm
    assert dark.min() == pytest.approx(-0.18, abs=0.004) and dark.max() == pytest.approx(0.06, abs=0.004)
    assert left[:, -1].min() == left[0].min() == 1.0


def test_the_outline_holds_every_place_that_the_shadow_shows_in_and_little_more() -> None:
    s = light_scene(45, size_deg=10)
    outline = outline_m(s)
    centre, half, n = np.array([-0.05, 0.0]), np.array([0.25, 0.2]), 200
    left = faded(light_left(s, centre, half, n, 96))[..., 0]
    rows, columns = np.nonzero(left < 1)
    places = centre + half * ((np.column_stack([columns, rows]) + 0.5) / n * 2 - 1)
    hull = cv2.convexHull(outline.astype(np.float32))
    outside = [-cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y in places]
    assert max(outside) < 0.002  # texels of the coarse map are 10 mm
    shown = cv2.contourArea(cv2.convexHull(places.astype(np.float32)))
    assert cv2.contourArea(hull) < 1.35 * shown


def test_faint_darkening_goes_and_the_rest_stays_without_a_step() -> None:
    dark = np.linspace(0, 1, 2001)
    kept = 1 - faded(np.repeat((1 - dark)[:, None], 3, 1))[:, 0]
    assert (kept[dark <= SHOWS] == 0).all() and kept[dark >= 3 * SHOWS] == pytest.approx(dark[dark >= 3 * SHOWS])
    assert (np.diff(kept) >= 0).all() and np.diff(kept).max() < 4 * np.diff(dark).max()


def test_a_hovering_object_detaches_its_shadow_and_a_standing_one_does_not() -> None:
    s = light_scene(60)
    lifted = s.world_from_model.copy()
    lifted[2, 3] += 0.2
    for world_from_model, touches in ((s.world_from_model, True), (lifted, False)):
        t = Scene(s.camera, s.model, world_from_model, light=Light((0.5, 0.5, 0.5), ()))
        centre, half = np.zeros(2), np.array([0.2, 0.2])
        left = light_left(t, centre, half, 128, 256)[..., 0]
        column, row = (int(64 + 64 * (at - c) / h) for at, c, h in zip((0.066, 0.0), centre, half, strict=True))
        edge = left[row, column]  # 6 mm outside the cube's side
        assert (edge < 0.75) == touches


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, 0.0)])
def test_the_shadow_lands_where_the_plane_projects(distortion: tuple[float, ...]) -> None:
    base = scene(camera(320, 240, distortion))
    light = Light((0.0, 0.0, 0.0), (DirectionalLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0), 0.5),))
    s = Scene(base.camera, box_model(), base.world_from_model, base.markers, base.world_from_marker, light=light)
    pose = look_at(0.6, 35)
    stage = Contact()
    prepared = stage.prepare(s, stage.levels[2])
    f = facts(s, pose)
    shadow = stage.run(Window((Layers(s.camera.rect),), (f,)), s, prepared, stage.levels[2], np.random.default_rng(0))[
        Layer.SHADOW
    ]
    inside = np.array([[x, y, 0] for x in (-0.05, 0, 0.05) for y in (-0.05, 0, 0.05)])
    outside = np.array([[0.075 * np.cos(a) * 1.3, 0.075 * np.sin(a) * 1.3, 0] for a in np.arange(0, 6, 0.5)])
    at = lambda p: shadow[tuple(np.round(s.camera.project(pose.apply(p))).astype(int).T[::-1])][:, 0]  # noqa: E731
    assert at(inside).max() < 0.05 and at(outside).min() > 0.9


def test_demand_says_why_not() -> None:
    s, stage = scene(), Contact()
    f = facts(s)
    assert stage.demand(f, s, s.camera.rect).reason == "contact shadow in view"
    assert stage.demand(f.with_(camera_from_world=look_at(tilt_deg=130)), s, s.camera.rect).reason == "plane seen from behind"
    assert "half a grey level" in Contact(ContactParams(0.001)).demand(f, s, s.camera.rect).reason
    assert stage.demand(f, s, Rect(0, 0, 3, 3)).reason == "contact shadow out of view"
