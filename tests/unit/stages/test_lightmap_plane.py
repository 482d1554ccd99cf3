"""The shadow on the plane: against closed-form rays, at the contact, at the horizon,
coloured, kept, and never twice.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.facts import PlaneShadow
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light
from arfx.core.model import BLEND, MASK, Material
from arfx.core.sampling import disc
from arfx.core.stage import ReadyStage
from arfx.errors import RenderError
from arfx.stages.light.beams import QUANTUM, REACH, disc_directions, quantised
from arfx.stages.light.caster import make_caster
from arfx.stages.light.plane_shadow import PLANE_LEVELS, beam_texture
from arfx.stages.light.silhouette import covered_fraction, height_map
from arfx.stages.lightmap import Lightmap, LightmapParams
from arfx.stages.lightmap import stage as stage_module
from tests.scenes import box_model, layers_of
from tests.unit.stages.lightmap_scenes import (
    HIDES,
    MODELS,
    RADIUS_M,
    ball_model,
    disc_samples,
    from_above,
    ground_points,
    hemisphere_samples,
    lamp,
    on_plane,
    one_sided,
    run_stage,
    towards,
    true_ratio,
)

LIT = 0.578  # linear light of code 200: the plane without shadow
# Nothing virtual covers a pixel here: the object's shadow on itself, the dearest to
# prepare, would be read by none.
PLANE = LightmapParams(self_shadow=0.0)


@cache
def reference(
    name: str, azimuth: float, elevation: float, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that see the plane (n,), flat, and the true ratio there (n, 3): 256 rays to
    the lamp, 1,024 to the sky.
    """
    light = lamp(azimuth, elevation, size)
    s, pose = on_plane(MODELS[name](), light), from_above()
    points = ground_points(s, pose).reshape(-1, 3)
    pick = np.random.default_rng(0).choice(len(points), 1500, replace=False)
    pick = pick[np.isfinite(points[pick]).all(1)]
    eye = pose.inverse().translation_m
    to_eye = eye - points[pick]
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    seen = [
        not HIDES[name](points[[i]], d[None])[0, 0]
        for i, d in zip(pick, to_eye, strict=True)
    ]
    pick = pick[np.array(seen)]
    return pick, true_ratio(light, HIDES[name], points[pick], 32)


def errors(
    name: str,
    level: str,
    faint: float | None,
    azimuth: float,
    elevation: float,
    size: float,
) -> tuple[float, float]:
    """PSNR (dB) and mean absolute error (8-bit steps) on a plane of code 200, where the
    true shadow takes over 2 %.
    """
    pick, truth = reference(name, azimuth, elevation, size)
    s = on_plane(MODELS[name](), lamp(azimuth, elevation, size))
    made = run_stage(s, level, params=PLANE, faint=faint)[Layer.SHADOW].reshape(
        -1, 3
    )[pick]
    inside = truth.min(1) < 0.98
    assert inside.sum() > 150
    e = 255 * (
        SRGB.encode(LIT * made[inside].astype(float))
        - SRGB.encode(LIT * truth[inside])
    )
    return float(10 * np.log10(255**2 / (e * e).mean())), float(np.abs(e).mean())


@pytest.mark.parametrize(
    ("light", "name"),
    [
        ((40, 50, 20.0), "ball"),
        ((40, 50, 20.0), "box"),
        ((150, 35, 5.0), "box"),
        ((100, 20, 10.0), "ball"),
    ],
)
def test_error_against_true_rays_falls_with_the_level(
    name: str, light: tuple[float, float, float]
) -> None:
    got = {
        level: errors(name, level, 0.0, *light) for level in ("standard", "reference")
    }
    psnr, mean = ({k: v[i] for k, v in got.items()} for i in (0, 1))
    assert psnr["standard"] > 38 and mean["standard"] < 0.8, got
    # what is left of these is the noise of the true rays
    assert psnr["reference"] > 46 and mean["reference"] < mean["standard"] + 0.03, got


def test_soft_light_from_one_side_leaves_a_shadow_on_the_other() -> None:
    shape = (0.6, 0.0, -0.2)
    s, pose = on_plane(ball_model(), one_sided(shape)), from_above(5)
    points = ground_points(s, pose)
    r = np.linalg.norm(points[..., :2], axis=-1)
    beside = np.argwhere(
        (np.abs(points[..., 1]) < 0.2 * RADIUS_M)
        & (r > 1.05 * RADIUS_M)
        & (r < 2.5 * RADIUS_M)
    )
    at = points[beside[:, 0], beside[:, 1]]
    sky = hemisphere_samples(40)
    light = 1 + sky @ shape
    hidden = HIDES["ball"](at, sky)
    truth, even = hidden @ light / light.sum(), hidden.mean(1)
    made = (
        1
        - run_stage(s, "standard", pose, PLANE, faint=0.0)[Layer.SHADOW][
            beside[:, 0], beside[:, 1], 0
        ]
    )
    assert np.abs(made - truth).mean() < 0.006 < 0.03 < np.abs(even - truth).mean()
    assert made[at[:, 0] < 0].mean() > 1.3 * made[at[:, 0] > 0].mean()


@pytest.mark.parametrize("name", ["ball", "box"])
def test_leaving_out_what_is_faint_costs_less_than_two_grey_levels(name: str) -> None:
    psnr, mean = errors(name, "standard", None, 40, 50, 20.0)
    assert psnr > 40 and mean < 2


def test_half_the_light_makes_146_of_200() -> None:
    """The umbra of a light that is half of what lights the plane, away from what the
    ambient light loses.
    """
    from arfx.stages import STAGES
    from tests.contract.stage_laws import random_layers
    from tests.contract.stage_laws import run as run_law
    from tests.scenes import facts

    sine = np.sin(np.radians(40))
    s = on_plane(box_model(), lamp(90, 40, 0.5, (0.5 / sine,) * 3, 0.5), height_m=0.5)
    shadow = run_stage(s, params=PLANE, faint=0.0, pose=from_above(60, 2.0))[
        Layer.SHADOW
    ]
    at = s.camera.project(
        from_above(60, 2.0).apply(
            np.array([0, -(0.5 + RADIUS_M) / np.tan(np.radians(40)), 0])
        )
    )
    x, y = np.round(at).astype(int)
    assert shadow[y, x] == pytest.approx(
        0.5, abs=0.012
    )  # a box half a metre up takes 0.6 % of the sky
    composite = ReadyStage.of(STAGES["composite"](), s, "standard")
    layers = random_layers(s.camera.rect, 0)
    ones = np.ones_like(shadow)
    plate = (SRGB.decode(np.array(200 / 255)) * ones).astype(np.float32)
    layers = layers_of(
        layers.rect,
        {
            Layer.PLATE: plate,
            Layer.IMAGE: plate,
            Layer.VIRTUAL: 0 * ones,
            Layer.COVERAGE: 0 * ones[..., 0],
            Layer.SHADOW: 0.5 * ones,
        },
    )
    made = run_law(composite, layers, facts(s))[Layer.IMAGE]
    assert np.round(255 * SRGB.encode(made[y, x])).tolist() == [146] * 3
    # the camera's bias stays: b + (200 - b) x 0.5
    bias = (0.02, 0.01, 0.0)
    made = run_law(composite, layers, facts(s).with_(bias_rgb=bias))[Layer.IMAGE]
    np.testing.assert_allclose(
        made[y, x], np.array(bias) + (plate[y, x] - np.array(bias)) / 2, atol=1e-6
    )


@pytest.mark.parametrize("level", ["standard"])
@pytest.mark.parametrize("azimuth", [0, 100, 215])
def test_it_falls_away_from_the_light(level: str, azimuth: float) -> None:
    s = on_plane(ball_model(3), lamp(azimuth, 35, 3.0, ambient=0.0))
    pose = from_above()
    dark = 1 - run_stage(s, level, pose, PLANE)[Layer.SHADOW][..., 0]
    points = ground_points(s, pose)
    middle = (points * dark[..., None]).sum((0, 1)) / dark.sum()
    # the middle of a ball's shadow lies where the ray through its centre meets the plane
    away = -np.array(towards(azimuth, 0)) * RADIUS_M / np.tan(np.radians(35))
    np.testing.assert_allclose(middle[:2], away[:2], atol=0.15 * RADIUS_M)


@pytest.mark.parametrize("level", ["standard"])
@pytest.mark.parametrize("elevation", [75, 30, 8])
def test_contact_is_dark_and_the_shadow_hangs_on_the_object(
    level: str, elevation: float
) -> None:
    s = on_plane(box_model(), lamp(0, elevation, 8.0, ambient=0.15))
    pose = from_above()
    shadow = run_stage(s, level, pose, PLANE)[Layer.SHADOW][..., 0]

    def at(x: float, y: float) -> float:
        column, row = np.round(
            s.camera.project(pose.apply(np.array([x, y, 0.0])))
        ).astype(int)
        return shadow[row, column]

    share = (
        0.5
        * np.sin(np.radians(elevation))
        / (0.15 + 0.5 * np.sin(np.radians(elevation)))
    )
    for y in (-0.04, 0.0, 0.04):
        # beside the wall half the sky is left, of the lamp nothing on the far side and all
        # on the near side
        assert at(-RADIUS_M - 0.004, y) < (1 - share) * 0.7
        assert at(-RADIUS_M + 0.004, y) < 0.1, "under the object"
        assert at(RADIUS_M + 0.004, y) > share
    count, label = cv2.connectedComponents((shadow < 0.8).astype(np.uint8))
    large = [c for c in range(1, count) if (label == c).sum() > 3]
    assert len(large) == 1, "one piece, with the object in it"


def test_no_shadow_where_the_light_reaches() -> None:
    s = on_plane(box_model(), lamp(0, 45, 2.0, ambient=0.0))
    pose = from_above()
    for level in ("standard",):
        shadow = run_stage(s, level, pose, PLANE)[Layer.SHADOW][..., 0]
        points = ground_points(s, pose)
        clear = np.abs(points[..., 1]) > RADIUS_M + 0.012
        clear |= points[..., 0] > RADIUS_M + 0.008
        clear |= points[..., 0] < -3 * RADIUS_M - 0.02
        assert (shadow[clear] == 1).all()


@cache
def ambient_alone(level: str) -> np.ndarray:
    """The shadow of test_horizon's ball without any lamp."""
    return run_stage(
        on_plane(ball_model(2), Light((0.2, 0.2, 0.2), ())), level, params=PLANE
    )[Layer.SHADOW]


ELEVATIONS_DEG = (-90.0, -30.0, -1e-6, 0.0, 1e-9, 1e-3, 0.2, 3.0, 90.0)


@pytest.mark.parametrize(
    ("level", "elevation"),
    [
        *itertools.product(("standard",), ELEVATIONS_DEG),
        *(("reference", e) for e in (-90.0, 0.0, 1e-3)),
    ],
)
def test_horizon(level: str, elevation: float) -> None:
    s = on_plane(ball_model(2), lamp(30, elevation, 6.0))
    made = run_stage(s, level, params=PLANE)[Layer.SHADOW]
    assert np.isfinite(made).all() and made.min() >= 0 and made.max() <= 1
    if elevation <= 1e-3:
        np.testing.assert_allclose(made, ambient_alone(level), atol=1e-3)
    elif elevation < 90:
        assert (made < ambient_alone(level) - 1e-3).sum() > 50


def test_no_light_no_shadow_and_nothing_bad() -> None:
    for light in (
        Light((0, 0, 0), ()),
        lamp(0, 40, 5, (0, 0, 0), 0.0),
        lamp(0, -40, 5, ambient=0.0),
    ):
        assert (
            run_stage(on_plane(ball_model(2), light), params=PLANE)[Layer.SHADOW] == 1
        ).all()
    odd = Light(
        (0.2, 0.2, 0.2),
        (
            DirectionalLight((0, 0, 0), (1, 1, 1)),
            DirectionalLight((0, 0, 1), (np.inf, 1, 1)),
        ),
    )
    assert np.isfinite(
        run_stage(on_plane(ball_model(2), odd), params=PLANE)[Layer.SHADOW]
    ).all()


def test_two_lights_take_their_own_colours() -> None:
    red, blue = (0.6, 0.3, 0.1), (0.1, 0.2, 0.5)
    lights = (
        DirectionalLight(towards(0, 40), red, 1.0),
        DirectionalLight(towards(120, 40), blue, 1.0),
    )
    s = on_plane(box_model(), Light((0.2, 0.2, 0.2), lights), height_m=0.4)
    pose = from_above(50, 2.2)
    shadow = run_stage(s, pose=pose, params=PLANE, faint=0.0)[Layer.SHADOW]
    sine, reach = np.sin(np.radians(40)), (0.4 + RADIUS_M) / np.tan(np.radians(40))
    whole = 0.2 + sine * (np.array(red) + np.array(blue))
    for azimuth, left in ((0, blue), (120, red)):
        at = np.append(-np.array(towards(azimuth, 0))[:2] * reach, 0.0)
        x, y = np.round(s.camera.project(pose.apply(at))).astype(int)
        np.testing.assert_allclose(
            shadow[y, x], (0.2 + sine * np.array(left)) / whole, atol=0.012
        )
    assert (shadow > 0).all() and (shadow <= 1).all()


def test_strength_scales_the_darkening() -> None:
    s = on_plane(box_model(), lamp(0, 45, 5.0))
    whole, half = (
        run_stage(s, params=PLANE.model_copy(update=dict(shadow_strength=k)))[
            Layer.SHADOW
        ]
        for k in (1.0, 0.5)
    )
    np.testing.assert_allclose(1 - half, (1 - whole) / 2, atol=1e-6)


def test_what_is_blocked_already_is_not_taken_twice() -> None:
    """A real shadow over half of the plane: with the lamp gone there, only the sky can be taken."""
    s = on_plane(box_model(), lamp(0, 45, 1.0, (0.5, 0.5, 0.5), 0.2))
    direct = 0.5 * np.sin(np.radians(45))
    share = 0.2 / (0.2 + direct)
    grid = np.ones((20, 20))
    grid[:10] = share  # plate over lit: below y = 0 only the ambient light is left
    shadow = PlaneShadow((-0.5, -0.5, 0.5, 0.5), tuple(map(tuple, grid.tolist())))
    pose = from_above()
    free, known = (
        run_stage(s, pose=pose, params=PLANE, faint=0.0, plane_shadow=p)[
            Layer.SHADOW
        ][..., 0]
        for p in (None, shadow)
    )
    sky = run_stage(
        on_plane(box_model(), Light((0.2, 0.2, 0.2), ())),
        pose=pose,
        params=PLANE,
        faint=0.0,
    )[Layer.SHADOW][..., 0]
    points = ground_points(s, pose)
    shadowed, lit = points[..., 1] < -0.03, points[..., 1] > 0.03
    np.testing.assert_allclose(known[shadowed], sky[shadowed], atol=1e-4)
    np.testing.assert_allclose(known[lit], free[lit], atol=1e-5)
    assert (free[shadowed] < 0.6 * sky[shadowed]).any(), (
        "without the mask it would be darkened twice"
    )
    # however dark the plate: the result is not under what the ambient light alone leaves
    assert (known[shadowed] * share >= share * sky[shadowed] - 1e-5).all()
    with pytest.raises(RenderError, match="real shadow"):
        run_stage(s, plane_shadow=PlaneShadow((0, 0, 0, 1), ((1.0,),)))


def test_a_still_light_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    for name in ("beam_textures", "depth_map"):
        real = getattr(stage_module, name)
        monkeypatch.setattr(
            stage_module,
            name,
            lambda *a, name=name, real=real: (made.append(name), real(*a))[1],
        )
    light = lamp(30, 45, 5.0)
    s = on_plane(ball_model(2), light)
    ready = ReadyStage.of(Lightmap(), s, "standard")
    go = lambda li, **k: run_stage(s, ready=ready, light=li, **k)[Layer.SHADOW]  # noqa: E731
    first = go(light)
    assert sorted(made) == ["beam_textures", "depth_map"]
    d = np.array(towards(30, 45))
    same = Light(
        (0.3, 0.3, 0.3), (DirectionalLight(tuple(d), (0.9, 0.8, 0.7), 5.0),), "marker"
    )
    go(same), go(light, pose=from_above(50))
    assert len(made) == 2, "brightness and the camera change nothing of it"
    moved = go(lamp(30.5, 45, 5.0))
    assert len(made) == 4 and np.abs(moved - first).max() > 0.01
    np.testing.assert_array_equal(go(light), first)
    assert len(made) == 4
    for k in range(12):
        go(lamp(40 + 3 * k, 45, 5.0))
    assert len(ready.memo.of_light._kinds[""]) <= 8, "memory is bounded"
    np.testing.assert_array_equal(go(light), first)


def test_directions_are_rounded_finely() -> None:
    g = np.random.default_rng(0)
    for d in g.normal(size=(200, 3)):
        d /= np.linalg.norm(d)
        b = quantised(d, 3.0)
        assert np.linalg.norm(np.array(b.direction) - d) < QUANTUM and np.linalg.norm(
            b.direction
        ) == pytest.approx(1)
        assert quantised(np.array(b.direction), 3.04) == b


def test_no_direction_of_a_disc_lies_under_the_longest_shadow() -> None:
    for elevation in (0.001, 1, 4, 20):
        d = disc_directions(
            quantised(np.array(towards(10, elevation)), 30.0), disc(64)
        )
        assert (d[:, 2] * REACH >= np.linalg.norm(d[:, :2], axis=1) - 1e-12).all()


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, 0.0)])
def test_it_lands_where_the_plane_projects(distortion: tuple[float, ...]) -> None:
    camera = Camera(
        320,
        240,
        np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]),
        np.array(distortion),
    )
    s, pose = (
        on_plane(box_model(), lamp(0, 90, 0.5, ambient=0.0), camera),
        from_above(),
    )
    shadow = run_stage(s, pose=pose, params=PLANE)[Layer.SHADOW][..., 0]
    points = ground_points(s, pose)[..., :2]
    far = np.abs(points).max(-1)
    assert (
        shadow[far < RADIUS_M - 0.003].max() < 0.02
        and shadow[far > RADIUS_M + 0.003].min() > 0.98
    )


def soup(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that share vertices at random: open, crossing, turned either way."""
    g = np.random.default_rng(seed)
    return g.uniform([4, 4, 0], [58, 42, 12], (n, 3)), np.array(
        [g.choice(n, 3, replace=False) for _ in range(n)], np.int32
    )


@pytest.mark.parametrize("seed", range(5))
def test_silhouettes_are_the_union_of_the_triangles(seed: int) -> None:
    """Whatever the mesh is: open, in itself crossing, facets facing any way."""
    from arfx.stages.light.caster import _edges

    vertices, faces = soup(14, seed)
    across = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]],
        vertices[faces[:, 2]] - vertices[faces[:, 0]],
    )
    d = np.array([0.3, -0.2, 1.0])
    slope = -d[:2] / d[2]
    made = covered_fraction(
        vertices.astype(np.float32),
        _edges(vertices, faces),
        across.T.astype(np.float32),
        d[None],
        slope[None],
        (48, 64),
    )
    flat = vertices[:, :2] + vertices[:, 2:] * slope
    y, x = np.mgrid[0:48, 0:64].astype(float)
    inside = np.zeros((48, 64), bool)
    near = np.zeros((48, 64), bool)  # rounding may decide within 1e-3 of an edge
    for a, b, c in flat[faces]:
        side = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        length = [np.linalg.norm(q - p) for p, q in ((a, b), (b, c), (c, a))]
        inside |= (np.min(side, 0) > 0) | (np.max(side, 0) < 0)
        near |= (
            np.min([np.abs(s) / n for s, n in zip(side, length, strict=True)], 0)
            < 1e-3
        )
    assert 0.1 < inside.mean() < 0.95
    assert (made[~near] == inside[~near]).all()


def test_many_crossings_of_a_row_are_counted() -> None:
    """A comb of 60 teeth."""
    from arfx.stages.light.caster import _edges

    x = np.arange(60) * 2.0 + 2
    vertices = np.concatenate(
        [
            np.column_stack([x + dx, np.full(60, y), np.zeros(60)])
            for dx, y in ((0.5, 2), (1.5, 2), (1, 30))
        ]
    )
    faces = np.column_stack(
        [np.arange(60), np.arange(60) + 60, np.arange(60) + 120]
    ).astype(np.int32)
    up = np.tile([0, 0, 1], (60, 1)).astype(np.float32).T
    made = covered_fraction(
        vertices.astype(np.float32),
        _edges(vertices, faces),
        up,
        np.array([[0, 0, 1.0]]),
        np.zeros((1, 2)),
        (32, 128),
    )
    row = made[3] > 0
    assert row[3:122:2].all() and not row[2:122:2].any()


def test_the_highest_surface_wins() -> None:
    vertices = np.array(
        [[0, 0, 1], [20, 0, 1], [0, 20, 1], [0, 0, 0], [20, 0, 4], [0, 20, 0]],
        np.float32,
    )
    made = height_map(
        *np.ascontiguousarray(vertices.T),
        np.array([[0, 1, 2], [3, 4, 5]], np.int32),
        24,
        24,
        np.float32(-9),
    )
    x, y = np.meshgrid(np.arange(24), np.arange(24))
    inside = x + y < 20
    np.testing.assert_allclose(made[inside], np.maximum(1, x[inside] / 5), atol=1e-5)
    assert (made[x + y > 20] == -9).all()


@pytest.mark.parametrize("level", ["standard"])
def test_the_penumbra_is_as_wide_as_the_light_and_the_height_make_it(
    level: str,
) -> None:
    """A box half a metre up under a vertical light of 10 degrees: its edge against the
    share of a disc beyond a chord.
    """
    s = on_plane(box_model(), lamp(0, 90, 10.0), height_m=0.5)
    caster = make_caster(s)
    texture = beam_texture(
        caster, quantised(np.array([0, 0, 1.0]), 10.0), PLANE_LEVELS[level]
    )
    x = np.linspace(-0.12, 0.0, 61)
    places = np.column_stack([x, np.zeros(61), np.ones(61)]) @ texture.texel_from_m.T
    made = cv2.remap(
        texture.dark,
        *(places[:, i : i + 1].astype(np.float32) for i in (0, 1)),
        cv2.INTER_LINEAR,
    )[:, 0]
    truth = HIDES["box"](
        np.column_stack([x, np.zeros((61, 2))]),
        disc_samples(np.array([0, 0, 1.0]), 10.0, 64),
        0.5,
    ).mean(1)
    assert ((truth > 0.05) & (truth < 0.95)).sum() > 20
    assert np.abs(made - truth).max() < 0.06
    assert np.diff(made).min() > -0.01, "a ramp without steps back"
    assert np.diff(made).max() < 1.8 * np.diff(truth).max(), "and without steps"


@pytest.mark.parametrize("level", ["standard"])
def test_a_shadow_is_as_dark_as_its_object_is_opaque(level: str) -> None:
    light = lamp(30, 50, 5.0)

    def shadow(*materials: Material) -> np.ndarray:
        boxes = [box_model(material=m).parts[0] for m in materials]
        model = replace(
            box_model(),
            parts=tuple(
                replace(b, vertices=b.vertices / (k + 1)) for k, b in enumerate(boxes)
            ),
        )
        return run_stage(on_plane(model, light), level, params=PLANE, faint=0.0)[
            Layer.SHADOW
        ]

    def made_of(alpha: float, mode: str = BLEND) -> Material:
        return Material(base_colour=(1.0, 1.0, 1.0, alpha), alpha_mode=mode)

    full = shadow(Material())
    assert full.min() < 0.7
    assert np.allclose(shadow(made_of(0.25)), 1 - 0.25 * (1 - full), atol=1e-3)
    assert (shadow(made_of(0.0)) == 1).all() and (
        shadow(made_of(0.3, MASK)) == 1
    ).all(), "nothing to see casts no shadow"
    assert np.array_equal(shadow(made_of(0.8, MASK)), full)
    small = shadow(made_of(0.0), Material())
    assert 0 < (1 - small).sum() < 0.6 * (1 - full).sum(), (
        "what lies in an invisible hull casts its own shadow"
    )


def test_what_is_sunk_under_the_plane_casts_nothing_on_it() -> None:
    """A ball that stands with its middle on the plane: its shadow begins at the circle of
    the cut.
    """
    half_sunk, whole = (
        on_plane(ball_model(), lamp(0, 60, 0.5, ambient=0.0), height_m=h)
        for h in (-RADIUS_M, 0.0)
    )
    assert make_caster(half_sunk).above_vertices[:, 2].min() >= 0
    pose = from_above()
    points = ground_points(half_sunk, pose)
    to_light = np.array(towards(0, 60))[None]
    flat = points.reshape(-1, 3)
    truth = HIDES["ball"](flat, to_light, -RADIUS_M).reshape(points.shape[:2])
    truth |= (
        np.linalg.norm(points, axis=-1) < RADIUS_M
    )  # within the ball: the light is outside it, on whatever side
    blurred = cv2.dilate(truth.astype(np.uint8), np.ones((5, 5))) != cv2.erode(
        truth.astype(np.uint8), np.ones((5, 5))
    )
    shadow = run_stage(half_sunk, pose=pose, params=PLANE, faint=0.0)[Layer.SHADOW][
        ..., 0
    ]
    assert (np.abs(shadow - (1 - truth))[~blurred] < 0.05).all()
    assert (
        run_stage(whole, pose=pose, params=PLANE, faint=0.0)[Layer.SHADOW][..., 0]
        != shadow
    ).mean() > 0.01


def test_a_needle_whose_area_is_rounded_away_has_no_height() -> None:
    """Its corners in another order have an area: it was divided by."""
    corners = np.array(
        [
            [14.500542640686035, 53.2870979309082],
            [-1.947291374206543, 30.760379791259766],
            [9.061826705932617, 45.83831024169922],
        ],
        np.float32,
    )
    u, v = np.ascontiguousarray(corners.T)
    height = np.ones(3, np.float32)
    for order in itertools.permutations(range(3)):
        faces = np.array([order], np.int32)
        made = height_map(u, v, height, faces, 64, 64, np.float32(-1))
        assert set(np.unique(made)) <= {-1.0, 1.0}
