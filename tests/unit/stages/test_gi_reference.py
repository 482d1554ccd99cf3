"""Level `reference`: what its paths bring, its lobes and its samples of the environment,
each against a sum or a formula.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.cube import CubeMap, face_directions, solid_angles
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import CLAMP, MIRROR, REPEAT, Material, Texture
from arfx.core.numerics import divide, normalise
from arfx.stages.gi import GiParams
from arfx.stages.gi.reference_lobes import (
    Lobes,
    MaterialLobes,
    PlaneLobes,
)
from arfx.stages.gi.reference_scene import RayScene
from arfx.stages.gi.reference_sky import Environment
from arfx.stages.light.surfels import wrapped
from arfx.stages.light.surroundings import lobe_width
from tests.unit.stages.gi_scenes import (
    BLACK,
    EVEN,
    MATT_RED,
    MATT_WHITE,
    ball,
    box,
    from_above,
    ground_points,
    inner,
    on_plane,
    plain_plate,
    run_gi,
)

CAMERA = Camera(64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]))
DIM = Light((0.2, 0.2, 0.2), ())
VIEW = normalise(np.array([[0.5, 0.3, 0.7]]))


def even_hemisphere(n: int) -> np.ndarray:
    """(n, 3) unit directions over z = 0, of equal solid angle 2 pi / n."""
    z, phi = (np.arange(n) + 0.5) / n, np.arange(n) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(phi), flat * np.sin(phi), z], -1)


def numbers(n: int) -> np.ndarray:
    return np.random.default_rng(0).random((n, 3))


def material(
    n: int,
    roughness: float,
    albedo: float = 0.5,
    f0: float = 0.04,
    metal: float = 0.0,
) -> MaterialLobes:
    up, column = np.tile([0, 0, 1.0], (n, 1)), np.ones((n, 1))
    return MaterialLobes(
        up,
        np.tile(VIEW, (n, 1)),
        np.full((n, 3), albedo),
        metal * column,
        f0 * column,
        roughness * column,
    )


def plane(n: int, x: float, all_around: bool) -> PlaneLobes:
    points = np.tile([x, 0, 0.0], (n, 1))
    return PlaneLobes(
        points, np.tile([0, 0, 1.0], (n, 1)), np.array([0, 0, 1.2]), 1.0, all_around
    )


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("metal", [0.0, 1.0])
def test_directions_have_the_density_that_is_told_and_keep_the_mean(
    roughness: float, metal: float
) -> None:
    n = 200_000
    lobes = material(n, roughness, metal=metal)
    even = lobes.at(even_hemisphere(n))
    assert 2 * np.pi * even.density.mean() <= 1.01, (
        "some directions of the gloss do not leave the surface"
    )
    summed = 2 * np.pi * even.total.mean(0)
    drawn = lobes.at(lobes.directions(numbers(n)))
    weight = divide(drawn.total, drawn.density)
    np.testing.assert_allclose(weight.mean(0), summed, rtol=0.02)
    assert weight.max() < 2.5, "no single path counts much"


@pytest.mark.parametrize("all_around", [False, True])
def test_rays_towards_a_ball_bring_its_form_factor(all_around: bool) -> None:
    """The ball stands over the plane: r^2 h / d^3."""
    n, centre = 50_000, np.array([0, 0, 1.2])
    for x in (0.0, 1.5, 6.0):
        lobes = plane(n, x, all_around)
        d = lobes.directions(numbers(n))
        to = centre - [x, 0, 0]
        along = d @ to
        hit = (along > 0) & (to @ to - along**2 <= 1)
        got = divide(lobes.at(d).total, lobes.at(d).density)[:, 0] * hit
        assert got.mean() == pytest.approx(1.2 / np.hypot(x, 1.2) ** 3, rel=0.03)


@pytest.mark.parametrize("lobes", [material(20_000, 0.5), plane(20_000, 6.0, True)])
def test_a_density_sums_to_one(lobes: Lobes) -> None:
    assert 2 * np.pi * lobes.at(
        even_hemisphere(20_000)
    ).density.mean() == pytest.approx(1, abs=0.02)


def lit_room() -> np.ndarray:
    """A cube (6, 16, 16, 3) with a spot 200 times as bright as the rest."""
    cube = np.full((6, 16, 16, 3), 0.3)
    cube[4, 7:9, 7:9] = 60.0
    return cube


def test_samples_of_the_environment_are_taken_by_their_density() -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    environment = Environment((lit_room(),) * 2, turn)
    assert environment.bright
    d = environment.samples(numbers(100_000)[:, :2])
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-12)
    radiance = environment.radiance(d, np.ones((len(d), 3)))[:, 0]
    texels, solid = face_directions(64), np.tile(solid_angles(64).ravel(), 6)
    exact = (
        environment.radiance(texels.reshape(-1, 3) @ turn, np.ones((solid.size, 3)))[
            :, 0
        ]
        @ solid
    )
    assert (radiance / environment.density(d)[:, 0]).mean() == pytest.approx(
        exact, rel=0.01
    )
    assert not Environment((np.ones((6, 4, 4, 3)),) * 2, turn).bright


def test_what_nobody_saw_is_as_bright_as_the_ray_is_wide() -> None:
    """A mirror looks through between the lamps that a matt surface takes light from."""
    environment = Environment(
        (np.full((6, 4, 4, 3), 0.2), np.ones((6, 4, 4, 3))), np.eye(3)
    )
    wide = np.tile([[0.0], [0.5], [1.0]], 3)
    assert environment.radiance(normalise(np.ones((3, 3))), wide)[
        :, 0
    ] == pytest.approx([0.2, 0.6, 1.0])
    widths = [float(lobe_width(np.array(r))) for r in (0.0, 0.35, 1.0)]
    assert widths[0] == 0 and 0.2 < widths[1] < 0.9 and widths[2] == 1


def test_textures_are_read_where_rays_meet_them() -> None:
    base = np.zeros((2, 2, 4), np.uint8)
    base[0, 1], base[..., 3] = 255, 255
    s = on_plane(box(MATT_WHITE), EVEN)
    part = s.model.parts[0]
    white = RayScene(s)
    eye, down = np.array([[0.01, 0.02, 1.0]]), np.array([[0, 0, -1.0]])
    met = white.nearest(eye, down)
    assert met.triangle[0] >= 0 and met.distance[0] == pytest.approx(
        1 - s.model_points_m[:, 2].max()
    )
    surface = white.surface(met, eye, down)
    assert surface.normal[0] == pytest.approx([0, 0, 1]) and surface.albedo[
        0
    ] == pytest.approx([1] * 3)
    for u, expected in ((0.25, 0.0), (0.75, 1.0)):
        uv = np.tile([u, 0.25], (len(part.vertices), 1))
        textured = Material(
            base_colour=(1, 1, 1, 1), specular=0.0, base_texture=Texture(base)
        )
        model = replace(s.model, parts=(replace(part, material=textured, uv=uv),))
        scene = on_plane(model, EVEN)
        assert RayScene(scene).surface(met, eye, down).albedo[0] == pytest.approx(
            [expected] * 3
        )


def test_what_lies_beyond_a_picture_repeats_ends_or_is_mirrored() -> None:
    t = np.array([-0.25, 0.25, 1.25, 2.25])
    assert wrapped(t, REPEAT).tolist() == [0.75, 0.25, 0.25, 0.25]
    assert wrapped(t, CLAMP).tolist() == [0, 0.25, 1, 1]
    assert wrapped(t, MIRROR).tolist() == [0.25, 0.25, 0.75, 0.25]


@pytest.mark.parametrize(
    "body",
    [
        MATT_WHITE,
        Material(base_colour=(1, 1, 1, 1), metallic=1.0, roughness=0.0),
        Material(base_colour=(1, 1, 1, 1), roughness=0.3),
        Material(base_colour=(1, 1, 1, 1), roughness=1.0),
    ],
)
def test_white_furnace(body: Material) -> None:
    """Varnish leaves the matt part what it does not mirror: by Fresnel's term alone 3 % of what is
    rough were lost."""
    made = run_gi(
        on_plane(ball(body), EVEN, CAMERA),
        "reference",
        plate=plain_plate(CAMERA, (1, 1, 1)),
        params=GiParams(samples=16),
    )
    inside = inner(made[Layer.COVERAGE])
    assert made[Layer.VIRTUAL][inside].mean() == pytest.approx(1, abs=0.01)
    beside = made[Layer.COVERAGE] == 0
    assert made[Layer.SHADOW][beside].mean() == pytest.approx(1, abs=0.01)


def test_a_black_ball_takes_its_form_factor_from_the_plane() -> None:
    s = on_plane(ball(BLACK), EVEN, CAMERA)
    made = run_gi(s, "reference", params=GiParams(samples=64))
    radius = s.model_points_m[:, 2].max() / 2
    ground = ground_points(s, from_above())
    away = np.hypot(ground[..., 0], ground[..., 1])
    beside = (made[Layer.COVERAGE] == 0) & (away > 1.5 * radius) & (away < 4 * radius)
    taken = 1 - made[Layer.SHADOW][beside][:, 0]
    exact = (radius**3 / (away**2 + radius**2) ** 1.5)[beside]
    assert taken.mean() == pytest.approx(exact.mean(), rel=0.03)
    assert np.abs(taken - exact).mean() < 0.02


@pytest.mark.parametrize("roughness", [0.4, 1.0])
def test_a_bright_spot_of_the_environment_makes_no_specks(roughness: float) -> None:
    metal = Material(
        base_colour=(0.9, 0.9, 0.9, 1.0), metallic=1.0, roughness=roughness
    )
    for body in (metal, MATT_WHITE):
        s = on_plane(ball(body), DIM, CAMERA)
        around = CubeMap.of(lit_room())
        made = [
            run_gi(s, "reference", params=GiParams(samples=n), environment=around)
            for n in (8, 9)
        ]
        on = made[0][Layer.COVERAGE] > 0
        a, b = (m[Layer.VIRTUAL][on].max(-1) for m in made)
        # by chance alone 3 to 5 times the mean
        assert np.percentile(np.abs(a - b), 99) < 1.6 * (a.mean() + b.mean()) / 2


def test_the_default_samples_leave_little_noise() -> None:
    s = on_plane(box(MATT_RED), Light((0.4, 0.4, 0.4), ()), CAMERA)
    runs = [run_gi(s, "reference", index=k) for k in range(2)]
    on = inner(runs[0][Layer.COVERAGE])
    a, b = (r[Layer.VIRTUAL][on] for r in runs)
    slope = 255 * 1.055 / 2.4 * np.clip((a + b) / 2, 0.0031308, 1) ** (1 / 2.4 - 1)
    assert (np.abs(a - b) * slope).mean() / np.sqrt(2) < 0.5, "grey levels"
