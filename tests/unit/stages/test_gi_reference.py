"""Rays of level `reference`: no single pixels far too bright, and the same mean as without what prevents them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from arfx.core.camera import Camera
from arfx.core.cube import CubeMap, look_up
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import Material, Model, Part
from arfx.core.scene import Scene
from arfx.stages.gi import GiParams, reference_tracer
from arfx.stages.gi.reference_kernels import cube_radiance
from arfx.stages.gi.reference_noise import grey_slope
from arfx.stages.gi.reference_sampling import Gloss, Sampler
from arfx.stages.gi.reference_tracer import Of, Tracer
from tests.unit.stages.gi_scenes import MATT_WHITE, ball, box, from_above, ground_points, inner, on_plane, plain_plate, run_gi

CAMERA = Camera(64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]))
DIM = Light((0.2, 0.2, 0.2), ())
LAMP_M, LAMP_RADIANCE = 0.08, 300.0  # radius in units of the model's ball


def with_a_small_lamp(body: Material) -> Scene:
    """A ball, and beside it a ball of a twelfth its size that glows 300 times as bright as white."""
    large, small = trimesh.creation.icosphere(subdivisions=3), trimesh.creation.icosphere(subdivisions=3, radius=LAMP_M)
    glow = Material(base_colour=(0.0, 0.0, 0.0, 1.0), specular=0.0, emissive=(LAMP_RADIANCE,) * 3)
    parts = [
        Part(np.array(b.vertices) + at, np.array(b.faces, np.int32), np.array(b.vertices), m)
        for b, at, m in ((large, [0, 0, 0], body), (small, [1.3, 0, 0.3], glow))
    ]
    return on_plane(Model(tuple(parts), up="z"), DIM, CAMERA)


def test_a_small_lamp_gives_the_plane_what_it_has_to() -> None:
    """Form factor of a ball of radius r, h above the plane and D away: r^2 h / D^3. Four samples that are drawn for the plane's
    sake alone miss the lamp nearly everywhere, and where they meet it the plane is 14 times too bright."""
    s = with_a_small_lamp(Material(base_colour=(0.0, 0.0, 0.0, 1.0), specular=0.0))
    made = run_gi(s, "reference", params=GiParams(samples=4))
    points = s.world_from_anchor.inverse().apply(s.model_points_m)
    lamp = points[-len(s.model.parts[1].vertices) :].mean(0)
    r, h = LAMP_M * np.linalg.norm(s.world_from_model[:3, 0]), lamp[2]
    g = ground_points(s, from_above())
    away = np.linalg.norm(g - lamp, axis=-1)
    lit = (made[Layer.COVERAGE] == 0) & (away < 2.5 * h) & (g[..., 0] > lamp[0])
    ratio = (made[Layer.SHADOW][..., 0] / (1 + LAMP_RADIANCE * r**2 * h / away**3 / 0.2))[lit]
    assert lit.sum() > 50
    assert ratio.mean() == pytest.approx(1, abs=0.1) and ratio.std() < 0.6


@pytest.mark.parametrize("roughness", [0.4, 1.0])
def test_a_bright_spot_of_the_environment_makes_no_specks(roughness: float) -> None:
    cube = np.full((6, 16, 16, 3), 0.3)
    cube[4, 7:9, 7:9] = 60.0
    metal = Material(base_colour=(0.9, 0.9, 0.9, 1.0), metallic=1.0, roughness=roughness)
    for material in (metal, MATT_WHITE):
        s = on_plane(ball(material), DIM, CAMERA)
        made = [run_gi(s, "reference", params=GiParams(samples=n), environment=CubeMap.of(cube)) for n in (8, 9)]
        on = made[0][Layer.COVERAGE] > 0
        a, b = (m[Layer.VIRTUAL][on].max(-1) for m in made)
        # by chance alone 3 to 5 times the mean
        assert np.percentile(np.abs(a - b), 99) < 1.6 * (a.mean() + b.mean()) / 2


@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("view_deg", [5, 60, 88])
def test_gloss_never_weighs_more_than_one_and_keeps_its_mean(roughness: float, view_deg: float) -> None:
    """All normals sampled alike, as was done, weigh up to hundreds at grazing view."""
    k, t = 20000, np.radians(view_deg)
    n = np.tile([0.0, 0.6, 0.8], (k, 1))
    v = np.tile(np.cos(t) * np.array([0, 0.6, 0.8]) + np.sin(t) * np.array([1.0, 0, 0]), (k, 1))
    gloss = Gloss(n, v, np.ones((k, 3)), roughness)
    draw = Sampler(np.arange(k, dtype=np.uint32), 0, 5)
    rows, d, weight, density = gloss.directions(draw)
    assert weight.max() <= 1 + 1e-6 and np.isfinite(density).all()
    again, same = gloss.at(rows, d)
    np.testing.assert_allclose(same, density, rtol=2e-2)
    np.testing.assert_allclose(again / density[:, None], weight, rtol=2e-2)
    if roughness == 1.0:  # wide enough to be summed up evenly over the hemisphere
        rng = np.random.default_rng(0)
        z, phi = rng.random(k), 2 * np.pi * rng.random(k)
        side = np.sqrt(1 - z**2)
        x_axis, y_axis = np.array([1.0, 0, 0]), np.array([0, 0.8, -0.6])
        even = (side * np.cos(phi))[:, None] * x_axis + (side * np.sin(phi))[:, None] * y_axis + z[:, None] * n
        value, p = gloss.at(np.arange(k), even)
        assert weight[:, 0].sum() / k == pytest.approx(2 * np.pi * value[:, 0].mean(), rel=0.03)
        assert 2 * np.pi * p.mean() <= 1.02


def test_a_mirror_that_is_seldom_asked_for_keeps_its_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the plane receives from a ball of a mirror: as where every place of a path is asked for what it mirrors."""
    s = on_plane(ball(Material(base_colour=(0.0, 0.0, 0.0, 1.0), specular=1.0)), DIM, CAMERA)
    cube = np.full((6, 16, 16, 3), 0.3)
    cube[4] = 0.6
    change = []
    for mirrors in (0.01, reference_tracer.MIRRORS):
        monkeypatch.setattr(reference_tracer, "MIRRORS", mirrors)
        made = run_gi(s, "reference", params=GiParams(samples=64), environment=CubeMap.of(cube))
        change.append((1 - made[Layer.SHADOW][made[Layer.COVERAGE] == 0]).mean())
    assert change[1] == pytest.approx(change[0], rel=0.01)


def test_parts_of_a_rays_radiance_sum_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the first meeting tells and what further bounces correct, with the same random numbers: where the object meets itself
    and the plane."""
    s, whole = on_plane(box(Material(base_colour=(0.7, 0.2, 0.1, 1.0), specular=0.5)), DIM, CAMERA), Tracer.along
    apart = 0

    def in_parts(self: Tracer, *given: Any) -> np.ndarray:
        nonlocal apart
        parts = [whole(self, *(*given, None)[:6], of) for of in (Of.FIRST, Of.REST)]
        apart += int(np.abs(parts[1]).max(initial=0) > 0.01)
        return np.asarray(parts[0] + parts[1])

    made = []
    for along in (whole, in_parts):
        monkeypatch.setattr(Tracer, "along", along)
        made.append(run_gi(s, "reference", params=GiParams(samples=1))[Layer.VIRTUAL])
    np.testing.assert_allclose(made[0], made[1], atol=1e-6)
    assert apart > 0


def test_what_hardly_shines_has_little_noise() -> None:
    """0.9 grey levels of 16 samples over a dark plane; 2.9 where all of the gloss is asked for by one sample in four."""
    s = on_plane(ball(Material(base_colour=(0.0, 0.0, 0.0, 1.0), specular=0.5, roughness=0.6)), DIM, CAMERA)
    runs = [run_gi(s, "reference", plate=plain_plate(rgb=(0.02,) * 3), params=GiParams(samples=16), index=k) for k in range(4)]
    v = np.array([r[Layer.VIRTUAL][inner(r[Layer.COVERAGE])] for r in runs])
    noise = float(np.sqrt((v.var(0, ddof=1) * grey_slope(v.mean(0)) ** 2).mean()))
    assert noise < 1.5


def test_compiled_look_ups_are_those_of_the_core() -> None:
    rng = np.random.default_rng(0)
    faces, d = rng.uniform(0, 1, (6, 5, 5, 3)), rng.normal(size=(500, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    found = cube_radiance(faces, 2 * faces, turn, d, np.full(500, 0.25))
    np.testing.assert_allclose(found, 1.25 * look_up(faces, d @ turn.T), atol=1e-12)
    assert np.isfinite(cube_radiance(faces, faces, turn, np.zeros((1, 3)), np.ones(1))).all()
