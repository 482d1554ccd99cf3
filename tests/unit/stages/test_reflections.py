"""What the object mirrors: the filtered cube, its share of the surroundings, and coats over
the base.
"""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from arfx.core.cube import CubeMap, SeenEnvironment, face_directions, solid_angles
from arfx.core.layers import packed
from arfx.core.light import DirectionalLight, Light
from arfx.core.memo import memo_of
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.scene import Scene
from arfx.errors import RenderError
from arfx.stages.light.environment import (
    Environment,
    environment_of,
    prefiltered,
    radiance,
)
from arfx.stages.light.split_sum import split_sum
from arfx.stages.light.surroundings import frame_environment
from arfx.stages.lightmap.coats import add_clear_coat, add_sheen
from arfx.stages.lightmap.shading import Lights, Surface, harmonic_terms, shade
from tests.scenes import box_model, facts
from tests.scenes import scene as small_scene

F32 = np.float32
SIDE = 48
UP = np.array([0.0, 0.0, 1.0])


def ball(
    albedo: float, metallic: float, roughness: float, specular: float = 0.5
) -> tuple[Surface, np.ndarray]:
    """(a ball seen from far above, (h, w) where it is)."""
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE * 2 - 1
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    on = z > 0.2
    normal = np.stack([x, y, z], -1)
    material = np.broadcast_to([metallic, roughness, specular, 1], (*x.shape, 4))
    colour = np.full_like(normal, albedo)
    layers = on, normal, 1e-3 * normal, colour, material, np.zeros_like(normal)
    return Surface(*(packed(np.ascontiguousarray(a, F32)) for a in layers)), on


def lights(soft_visibility: float = 1.0, lamps: int = 0) -> Lights:
    towards = np.array([[0.3, 0.1, 0.95]] * lamps, F32).reshape(-1, 3)
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    visible = np.ones((lamps, SIDE, SIDE), F32)
    soft = np.full((SIDE, SIDE), soft_visibility, F32)
    return Lights(
        towards, np.ones((lamps, 3), F32), np.zeros(lamps, F32), visible, soft
    )


EYE, NO_BIAS = np.array([0, 0, 10.0], F32), np.zeros(3, F32)
EVEN = environment_of(prefiltered(np.ones((6, 8, 8, 3))), np.eye(3))
EVEN_SOFT = harmonic_terms(np.zeros((0, 3)), np.ones(3))


def in_even_light(surface: Surface, light: Lights) -> np.ndarray:
    return shade(surface, EYE, light, EVEN_SOFT, EVEN, F32(1), split_sum(), NO_BIAS)


@numba.njit
def looked_up(
    environment: Environment, directions: np.ndarray, roughness: float
) -> np.ndarray:
    out = np.empty((len(directions), 3), np.float32)
    for i in range(len(directions)):
        light = radiance(environment, directions[i], np.float32(roughness))
        out[i, 0], out[i, 1], out[i, 2] = light
    return out


def directions(count: int) -> np.ndarray:
    d = np.random.default_rng(0).normal(size=(count, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True), F32)


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.3, 0.5, 0.8, 1.0])
def test_a_white_surface_in_even_light_is_white(
    metallic: float, roughness: float
) -> None:
    surface, on = ball(1.0, metallic, roughness)
    np.testing.assert_allclose(in_even_light(surface, lights())[on], 1, atol=0.01)


def test_a_filtered_cube_is_the_mean_under_the_lobe() -> None:
    d = face_directions(64).reshape(-1, 3)
    spot = 4.0 * (d @ np.array([0.6, 0.5, 0.62]) > 0.95)
    cube = (1 + 0.5 * d + spot[:, None]).reshape(6, 64, 64, 3)
    environment, seen = environment_of(prefiltered(cube), np.eye(3)), directions(200)
    solid = np.tile(solid_angles(64).ravel(), 6)
    for roughness in (0.2, 0.35, 0.55, 0.75, 1.0):
        alpha2, cosine = roughness**4, np.clip(seen @ d.T, -1, 1)
        weight = alpha2 / ((1 + cosine) / 2 * (alpha2 - 1) + 1) ** 2
        weight *= np.clip(cosine, 0, None) * solid
        truth = weight @ cube.reshape(-1, 3) / weight.sum(1, keepdims=True)
        assert np.abs(looked_up(environment, seen, roughness) - truth).mean() < 0.03


def test_between_levels_a_lobe_is_as_wide_as_its_roughness_asks() -> None:
    """Red if levels count by roughness: a lobe of .1 then is as blurred as half of one of .2."""
    d = face_directions(64)
    edge = environment_of(prefiltered((d[..., :1] > 0) * np.ones(3)), np.eye(3))
    degrees = np.linspace(-30, 30, 601)
    across = np.stack(
        [np.sin(np.radians(degrees)), np.cos(np.radians(degrees)), 0 * degrees], -1
    ).astype(F32)
    seen = {r: looked_up(edge, across, r)[:, 0] for r in (0.0, 0.1, 0.2)}
    blur = {r: np.abs(seen[r] - seen[0.0]).sum() for r in (0.1, 0.2)}
    assert 0.15 < blur[0.1] / blur[0.2] < 0.35


def test_no_seam_between_faces_nor_step_between_levels() -> None:
    g = np.random.default_rng(1)
    environment = environment_of(prefiltered(g.random((6, 16, 16, 3))), np.eye(3))
    across = np.stack(
        [np.ones(400), np.full(400, 0.3), np.linspace(0.9, 1.1, 400)], -1
    ).astype(F32)
    for roughness in (0.0, 0.3):
        steps = np.abs(np.diff(looked_up(environment, across, roughness), axis=0))
        assert steps.max() < 0.02
    one = across[:1]
    by_roughness = np.array(
        [looked_up(environment, one, r)[0] for r in np.linspace(0, 1, 300)]
    )
    assert np.abs(np.diff(by_roughness, axis=0)).max() < 0.02


def test_a_coat_adds_no_light_and_lamps_are_mirrored_where_they_stand() -> None:
    surface, on = ball(1.0, 0.0, 0.6)
    base = in_even_light(surface, lights())
    mirrors = EYE, lights(), EVEN, F32(1), split_sum(), NO_BIAS
    coat = np.broadcast_to(np.array([1.0, 0.1], F32), (SIDE, SIDE, 2)).copy()
    add_clear_coat(base, surface, coat, *mirrors)
    np.testing.assert_allclose(base[on], 1, atol=0.02)
    black, on = ball(0.0, 0.0, 1.0, 0.0)
    lit = np.zeros((SIDE, SIDE, 3), F32)
    lamp = lights(0.0, 1)
    add_clear_coat(lit, black, coat, EYE, lamp, EVEN, F32(0), split_sum(), NO_BIAS)
    half = lamp.towards[0] + np.array([0, 0, 1.0])
    brightest = np.unravel_index(lit[..., 0].argmax(), on.shape)
    assert black.normal[brightest] @ half / np.linalg.norm(half) > np.cos(
        np.radians(3)
    )


@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0])
def test_fibres_send_back_no_more_than_falls_on_them(roughness: float) -> None:
    surface, on = ball(1.0, 0.0, 1.0)
    sheen = np.broadcast_to(
        np.array([1, 0.5, 0.0, roughness], F32), (SIDE, SIDE, 4)
    ).copy()
    out = in_even_light(surface, lights())
    add_sheen(out, surface, sheen, EYE, lights(), EVEN_SOFT, NO_BIAS)
    np.testing.assert_allclose(out[on][:, 0], 1, atol=0.02)
    assert (out[on][:, 0] >= out[on][:, 1]).all() and (
        out[on][:, 1] >= out[on][:, 2]
    ).all()
    assert out[on].min() >= 0 and out[on][:, 2].min() < 0.99


def test_what_hides_soft_light_hides_what_is_mirrored_and_no_lamp() -> None:
    surface, on = ball(0.8, 1.0, 0.6)
    open_, hidden = (in_even_light(surface, lights(share)) for share in (1.0, 0.0))
    assert open_[on].min() > 0.7 and hidden[on].max() < 0.01
    lit = [in_even_light(surface, lights(share, 1)) for share in (1.0, 0.0)]
    np.testing.assert_allclose(
        lit[0][on] - open_[on], lit[1][on] - hidden[on], atol=1e-5
    )


def surrounded(
    light: Light, cube: np.ndarray | None, seen: np.ndarray | None = None
) -> Environment:
    """seen : (6, 64, 64, 4)"""
    s: Scene = replace(small_scene(model=box_model()), light=light)
    f = facts(s)
    if cube is not None:
        f = f.with_(environment=CubeMap.of(cube, None, np.array([0.2, 0.2, 0.2])))
    if seen is not None:
        s = replace(s, environment_maps={"a": seen.astype(np.float16)})
        f = f.with_(seen_environment=SeenEnvironment(("a", "a"), 0.0))
    return frame_environment(f, s, light)


def on_plane(environment: Environment) -> np.ndarray:
    """(3,) radiance of a white surface on the plane."""
    d = directions(40_000)
    return np.asarray(
        4
        * (looked_up(environment, d, 0.0) * np.clip(d @ UP, 0, None)[:, None]).mean(0)
    )


LAMP = DirectionalLight((0.0, 0.6, 0.8), (3.0, 3.0, 3.0), 3.0)


@pytest.mark.parametrize(
    "cube", [None, np.full((6, 6, 6, 3), 0.4), np.zeros((6, 6, 6, 3))]
)
def test_the_surroundings_are_as_bright_as_the_light_without_its_lamps(
    cube: np.ndarray | None,
) -> None:
    light = Light((0.5, 0.4, 0.3), (LAMP,))
    without = surrounded(replace(light, lights=()), cube)
    np.testing.assert_array_equal(surrounded(light, cube).texels, without.texels)
    np.testing.assert_allclose(on_plane(without), [0.5, 0.4, 0.3], rtol=0.02)


def test_a_mirror_shows_what_the_clip_saw_and_a_guess_as_bright() -> None:
    d = face_directions(64)
    known = (d[..., 0:1] > 0.5).astype(float)
    seen = np.concatenate([known * 0.8 * np.ones(3), known], -1)
    environment = surrounded(
        Light((0.5, 0.5, 0.5), ()), np.full((6, 6, 6, 3), 0.1), seen
    )
    there, elsewhere = looked_up(
        environment, np.array([[1, 0, 0.2], [0, 0, 1]], F32), 0.0
    )
    np.testing.assert_allclose(there, 0.8 * 0.5, rtol=0.02)
    np.testing.assert_allclose(elsewhere, 0.8 * 0.5, rtol=0.05)
    matt = looked_up(environment, np.array([[0, 0, 1]], F32), 1.0)
    assert (matt > elsewhere).all(), (
        "what is missing of the light comes from lamps between which a mirror looks through"
    )


def test_a_guess_begins_with_the_plane_at_its_horizon() -> None:
    """A mirror would show a hard ring there, between a picture and a guess."""
    d = face_directions(8)
    guess = np.where(d[..., :1] > 0, 0.9, 0.2) * np.ones(3)
    environment = surrounded(Light((0.5, 0.5, 0.5), ()), guess)
    below, above = looked_up(
        environment, np.array([[0.9, 0, -0.4], [0.9, 0, 0.9]], F32), 0.0
    )
    np.testing.assert_allclose(below, 0.2, rtol=1e-3)
    assert above[0] > 0.4


def test_a_camera_at_rest_keeps_what_was_filtered_while_the_world_turns() -> None:
    s, light = small_scene(model=box_model()), Light((0.5, 0.5, 0.5), ())
    room = np.random.default_rng(0).random((6, 6, 6, 3))
    for degrees in (0.0, 0.5, 1.0):
        turn = rotation_from_euler_deg(0, 0, degrees)
        guess = CubeMap.of(room, turn, np.array([0.2, 0.2, 0.2]))
        f = facts(s, Pose(turn, np.array([0, 0, 0.5]))).with_(environment=guess)
        environment = frame_environment(f, s, light)
        np.testing.assert_allclose(environment.turn, turn, atol=1e-6)
    assert memo_of(s).made == 2  # the guess, and what was filtered of it


def test_surroundings_that_are_no_radiance_are_refused() -> None:
    bad = np.full((6, 6, 6, 3), 0.4)
    bad[0, 0, 0, 0] = np.nan
    with pytest.raises(RenderError, match="not finite"):
        surrounded(Light(), bad)
