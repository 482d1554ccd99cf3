"""Shading: the light's own radiance, the camera's bias, the object's shadow on itself; and
what is not called for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.layers import Layer, Layers, neutral
from arfx.core.light import DirectionalLight, Light
from arfx.core.model import Model
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.papers.s1_lightmap import PrintedLightmapParams
from arfx.run.parameters import stage_of
from arfx.stages import STAGES
from arfx.stages.light.region import ShadowRegion
from arfx.stages.light.soft_visibility import (
    soft_visibility,
    visible_fraction,
    visible_fraction_by_rays,
)
from arfx.stages.lightmap import Lightmap, LightmapParams
from tests.contract.stage_laws import run as run_law
from tests.scenes import box_model, facts, layers_of
from tests.unit.stages.lightmap_scenes import (
    DARK,
    MADE,
    RADIUS_M,
    ball_model,
    disc_samples,
    from_above,
    hemisphere_samples,
    hides_box,
    lamp,
    on_plane,
    one_sided,
    run_stage,
    towards,
)

LEVELS = ("standard", "reference")
BARE = LightmapParams(self_shadow=0.0, plane_blocks=False)
PRINTED = PrintedLightmapParams(self_shadow=0.0, plane_blocks=False)
SOFT = (
    (1.1, 1.0, 0.9), (0.10, 0.05, 0.0), (0.30, 0.25, 0.2), (-0.10, 0.0, 0.1), (0.02, 0.01, 0.03),
    (0.04, 0.0, -0.02), (0.05, 0.02, 0.01), (-0.03, 0.02, 0.0), (0.01, 0.03, -0.02),
)  # fmt: skip
TWO = (
    DirectionalLight(towards(20, 40), (0.5, 0.4, 0.3), 3.0),
    DirectionalLight(towards(200, 10), (0.1, 0.2, 0.4), 20.0),
)


def surface(
    s: Scene, normals: np.ndarray, positions: np.ndarray, albedo: float = 0.87, coverage: float = 1.0,
    material: tuple[float, float, float] = (0.0, 0.9, 0.0),
) -> Layers:  # fmt: skip
    """Layers of the whole picture with these normals and positions (h, w, 3): matt unless
    the material says otherwise.
    """
    arrays = {name: neutral(name, s.camera.rect) for name in MADE}
    arrays[Layer.COVERAGE] = np.full_like(arrays[Layer.COVERAGE], coverage)
    for name, values in (
        (Layer.NORMAL, normals),
        (Layer.POSITION, positions),
    ):  # as a job makes them: C order
        arrays[name] = np.ascontiguousarray(values, np.float32)
    arrays[Layer.ALBEDO] = np.full_like(arrays[Layer.ALBEDO], albedo)
    arrays[Layer.MATERIAL][..., :3] = material
    return layers_of(s.camera.rect, arrays)


def shaded(
    s: Scene,
    layers: Layers,
    params: LightmapParams = BARE,
    level: str = "standard",
    soft: bool = True,
    **changes: object,
) -> np.ndarray:
    """VIRTUAL. The plane's shadow, which is not looked at, is left out.

    soft : as of the stage
    """
    stage: Any = stage_of(
        "lightmap", params.model_copy(update=dict(shadow_strength=0.0))
    )
    stage.soft = soft
    ready = ReadyStage.of(stage, s, level_named(stage.levels, level))
    return run_stage(
        s, layers=layers, ready=ready, model_box=s.camera.rect, **changes
    )[Layer.VIRTUAL]


def any_normals(s: Scene) -> np.ndarray:
    n = np.random.default_rng(0).normal(size=(s.camera.height, s.camera.width, 3))
    out: np.ndarray = n / np.linalg.norm(n, axis=-1, keepdims=True)
    return out


def far(s: Scene) -> np.ndarray:
    """Positions high over the object, where nothing of it is in the way."""
    return np.broadcast_to([0.0, 0.0, 0.3], (s.camera.height, s.camera.width, 3))


@pytest.mark.parametrize(
    "light",
    [Light(lights=TWO), Light(lights=TWO, soft=SOFT), Light((0.3, 0.2, 0.1), ())],
)
@pytest.mark.parametrize("params", [BARE, PRINTED])
def test_a_matt_surface_shows_the_radiance_of_the_light_and_the_bias(
    light: Light, params: LightmapParams
) -> None:
    s, bias = on_plane(box_model(), light), (0.02, 0.01, 0.03)
    n = any_normals(s)
    made = shaded(s, surface(s, n, far(s), coverage=0.25), params, bias_rgb=bias)
    np.testing.assert_allclose(
        made, 0.25 * (0.87 * light.radiance(n) + np.array(bias)), atol=2e-6
    )


@pytest.mark.parametrize("exposure", [0.3, 1.0, 1.7])
def test_virtual_paper_matches_the_paper_beside_it(exposure: float) -> None:
    """What a camera with gain and bias shows of the marker's white, and what the stage
    makes of a virtual patch of it.
    """
    light = Light((0.2, 0.2, 0.25), TWO, "marker").scaled(np.array([exposure] * 3))
    s, bias = on_plane(box_model(), DARK), (0.03, 0.02, 0.01)
    up = np.broadcast_to([0.0, 0.0, 1.0], (s.camera.height, s.camera.width, 3))
    made = shaded(
        s,
        surface(s, up, far(s)),
        LightmapParams(self_shadow=0.0),
        light=light,
        bias_rgb=bias,
    )
    marker = np.array(bias) + 0.87 * light.radiance(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(made, np.broadcast_to(marker, made.shape), atol=2e-6)


def test_light_under_the_horizon_reaches_the_object_only_if_the_plane_lets_it() -> (
    None
):
    s = on_plane(box_model(), lamp(0, -20, 2.0, ambient=0.0))
    down = np.broadcast_to(towards(0, -20), (s.camera.height, s.camera.width, 3))
    layers = surface(s, down, far(s))
    assert (shaded(s, layers, LightmapParams(self_shadow=0.0)) == 0).all()
    assert shaded(s, layers).min() > 0.4
    # half a disc over the horizon is half the light
    s = on_plane(box_model(), lamp(0, 0, 10.0, ambient=0.0))
    facing = np.broadcast_to([1.0, 0, 0], down.shape)
    assert shaded(
        s, surface(s, facing, far(s)), LightmapParams(self_shadow=0.0)
    ) == pytest.approx(0.87 * 0.25, rel=1e-3)


def test_a_highlight_lies_where_the_half_vector_meets_the_normal() -> None:
    s, pose = on_plane(box_model(), lamp(70, 40, 1.0, ambient=0.0)), from_above()
    n, at = any_normals(s), far(s)
    made = shaded(s, surface(s, n, at, 0.0, material=(0.0, 0.25, 1.0)))[..., 0]
    to_eye = pose.inverse().translation_m - at[0, 0]
    half = to_eye / np.linalg.norm(to_eye) + np.array(towards(70, 40))
    brightest = n[np.unravel_index(made.argmax(), made.shape)]
    assert brightest @ half / np.linalg.norm(half) > np.cos(np.radians(2))
    assert made.max() > 50 * np.median(made[made > 0])


def stacked() -> Model:
    """A cube on the plane and a table of four times its footprint at its foot: the cube
    shades the table's top.
    """
    cube, slab = box_model().parts[0], box_model().parts[0]
    low = slab.vertices * [4.0, 4.0, 0.2] - [0, 0, 0.6]
    return Model(
        (cube, replace(slab, vertices=low)), up="z", source="cube on a table"
    )


@pytest.mark.parametrize(("level", "most"), [("standard", 0.05), ("reference", 0.03)])
def test_shadow_on_itself_against_true_rays(level: str, most: float) -> None:
    """The table's top around the cube; the light of 12 degrees leaves a wide penumbra there."""
    light = lamp(30, 40, 12.0, ambient=0.0)
    s = on_plane(
        stacked(),
        light,
        Camera(50, 50, np.array([[50.0, 0, 25], [0, 50, 25], [0, 0, 1]])),
    )  # a pixel for each place
    side = s.world_from_model[0, 0]  # of the cube, metres
    top = 0.2 * side
    y, x = (
        np.mgrid[-1:1:240j, -1:1:320j].reshape(2, -1) * 1.6 * side
    )  # the table reaches 2 sides from its middle
    beside = np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) > 0.53 * side)
    pick = np.random.default_rng(0).choice(beside, 2500, replace=False)
    at = np.stack([x[pick], y[pick], np.full(2500, top)], -1)
    up = np.broadcast_to([0.0, 0.0, 1.0], (50, 50, 3))
    layers = surface(s, up, at.reshape(50, 50, 3))
    made = shaded(s, layers, LightmapParams(), level)[..., 0].ravel() / (
        0.87 * 0.5 * np.sin(np.radians(40))
    )
    # the closed form's cube is 2 RADIUS_M wide and stands on z = 0
    points = (at - [0, 0, top]) * (2 * RADIUS_M / side)
    rays = disc_samples(light.lights[0].unit, 12.0, 16)
    weight = rays[:, 2] / rays[:, 2].sum()
    truth = (1 - hides_box(points, rays)) @ weight
    assert (
        0.05 < (truth < 0.9).mean() < 0.6
        and ((truth > 0.1) & (truth < 0.9)).sum() > 100
    )
    error = np.abs(made - truth)
    assert error[(truth > 0.02) & (truth < 0.98)].mean() < most
    assert error[(truth == 1) | (truth == 0)].mean() < 0.01


def test_soft_light_that_the_object_hides_from_itself_against_true_rays() -> None:
    """The table's top around the cube, in even light and in light from one side."""
    s = on_plane(stacked(), one_sided((0.0, 0.0, 0.0)))
    side = s.world_from_model[0, 0]
    x, y = (np.random.default_rng(0).random((2, 2000)) * 2 - 1) * 1.2 * side
    beside = np.maximum(np.abs(x), np.abs(y)) > 0.55 * side
    at = np.stack([x, y, np.full(2000, 0.2 * side)], -1)[beside][None]
    up, covered = (
        np.broadcast_to(np.array([0.0, 0.0, 1.0]), at.shape).astype(np.float32),
        np.ones(at.shape[:2], np.float32),
    )
    sky, region = hemisphere_samples(30), ShadowRegion(s)
    hidden = hides_box((at[0] - [0, 0, 0.2 * side]) * (2 * RADIUS_M / side), sky)
    for shape in ((0.0, 0.0, 0.0), (0.7, 0.0, 0.3)):
        light = 1 + sky @ shape
        truth = 1 - hidden @ light / light.sum()
        surface_, place = (
            (covered, up, at.astype(np.float32)),
            (Pose.identity(), shape),
        )
        kept = soft_visibility(s, region.rays, region.soft)
        standard = np.abs(
            visible_fraction(surface_, kept, kept.under(shape), *place)[0] - truth
        ).mean()
        traced = visible_fraction_by_rays(surface_, region.rays, region.soft, *place)[
            0
        ]
        reference = np.abs(traced - truth).mean()
        assert truth.min() < 0.65 and reference < 0.006 < standard < 0.02, (
            standard,
            reference,
        )


def test_what_is_near_its_own_shadow_on_the_plane_is_dark() -> None:
    s = on_plane(
        ball_model(3),
        one_sided((0.0, 0.0, 0.0)),
        Camera(50, 50, np.array([[50.0, 0, 25], [0, 50, 25], [0, 0, 1]])),
    )
    n = any_normals(s)
    layers = surface(s, n, RADIUS_M * n + [0, 0, RADIUS_M])
    left = [
        shaded(s, layers, LightmapParams().model_copy(update=dict(self_shadow=k)))[
            ..., 0
        ]
        / (0.87 * 0.4)
        for k in (1.0, 0.5, 0.0)
    ]
    assert (
        np.abs(left[2] - 1).max() < 1e-3
        and np.abs(left[1] - (1 + left[0]) / 2).max() < 1e-3
    )
    height = n[..., 2]
    assert left[0][height > 0.3].min() > 0.93 and left[0][height < -0.9].max() < 0.5
    assert (
        left[0][height < -0.97].mean()
        < 0.25
        < left[0][(height > -0.4) & (height < -0.2)].mean()
    )


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("light", [(0, 60, 2.0), (130, 20, 15.0)])
def test_no_acne_on_a_ball(level: str, light: tuple[float, float, float]) -> None:
    camera = Camera(
        160, 120, np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]])
    )  # 19,200 places on the ball
    s = on_plane(ball_model(3), lamp(*light, ambient=0.0), camera)
    # the facets of the model lie under the sphere of their normals: places on the facets,
    # normals of the sphere
    part = s.model.parts[0]
    g = np.random.default_rng(0)
    f = part.faces[g.integers(0, len(part.faces), s.camera.height * s.camera.width)]
    w = g.dirichlet([1, 1, 1], len(f))
    n = (part.normals[f] * w[..., None]).sum(1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    at = s.model_points_m[f]
    shape = (s.camera.height, s.camera.width, 3)
    place = (at * w[..., None]).sum(1).reshape(shape)
    made = shaded(s, surface(s, n.reshape(shape), place), LightmapParams(), level)[
        ..., 0
    ]
    cosine = n.reshape(shape) @ s.light.lights[0].unit
    ideal = 0.87 * 0.5 * np.clip(cosine, 0, None)
    clear = cosine > np.sin(np.radians(light[2] / 2 + 6))
    assert (np.abs(made - ideal)[clear] < 0.02 * 0.435).mean() > 0.999


@pytest.mark.parametrize(
    ("light", "params", "says"),
    [
        (DARK, LightmapParams(), "at most 0.0 % of the plane's light"),
        (
            lamp(0, 45, 5.0),
            LightmapParams(shadow_strength=0.0),
            "at most 0.0 % of the plane's light",
        ),
        (lamp(0, 45, 5.0), LightmapParams(shadow_strength=0.015), "at most 1."),
        (
            lamp(0, -30, 5.0, ambient=0.0),
            LightmapParams(),
            "at most 0.0 % of the plane's light",
        ),
    ],
)
def test_no_shadow_is_asked_for_below_the_threshold(
    light: Light, params: LightmapParams, says: str
) -> None:
    s = on_plane(box_model(), light)
    f = facts(s, from_above())
    demand = Lightmap(params).demand(f, s, s.camera.rect)
    assert says in demand.reason and "model lit" in demand.reason
    assert demand.rect == f.model_box.pad(2).clip(s.camera.rect), (
        "the model is lit, nothing more"
    )
    gone = Lightmap(params).demand(f.with_(model_box=EMPTY), s, s.camera.rect)
    assert gone.rect.empty and says in gone.reason and "out of view" in gone.reason
    assert (run_stage(s, params=params, pose=from_above())[Layer.SHADOW] == 1).all()


def test_a_shadow_out_of_view_and_a_plane_from_behind_ask_for_nothing() -> None:
    s = on_plane(box_model(), lamp(0, 45, 5.0))
    aside = from_above()
    aside = type(aside)(aside.rotation, aside.translation_m + np.array([3.0, 0, 0]))
    demand = Lightmap().demand(
        facts(s, aside).with_(model_box=EMPTY), s, s.camera.rect
    )
    assert demand.rect.empty and "shadow out of view" in demand.reason
    behind = from_above(180.0)
    demand = Lightmap().demand(facts(s, behind), s, s.camera.rect)
    assert "plane seen from behind" in demand.reason
    assert (run_stage(s, pose=behind)[Layer.SHADOW] == 1).all()


@pytest.mark.parametrize(
    "light", [lamp(0, 35, 5.0), lamp(140, 12, 20.0), lamp(250, 80, 2.0)]
)
def test_outside_the_demand_nothing_changes(light: Light) -> None:
    s = on_plane(ball_model(3), light)
    rect = Lightmap().demand(facts(s, from_above()), s, s.camera.rect).rect
    outside = np.ones((s.camera.height, s.camera.width), bool)
    outside[rect.slices] = False
    made = run_stage(s)
    # what the rectangle leaves out is less than half a grey level
    assert (
        made[Layer.SHADOW][outside].min() > 1 - 0.0044
        and (made[Layer.VIRTUAL] == 0).all()
    )
    plate = np.random.default_rng(0).random(
        (s.camera.height, s.camera.width, 3), np.float32
    )
    none = {
        name: neutral(name, s.camera.rect) for name in (Layer.VIRTUAL, Layer.COVERAGE)
    }
    layers = layers_of(
        s.camera.rect,
        {
            **none,
            Layer.PLATE: plate,
            Layer.IMAGE: plate,
            Layer.SHADOW: made[Layer.SHADOW],
        },
    )
    composite = STAGES["composite"]()
    f = facts(s).with_(bias_rgb=(0.1, 0.05, 0.02))
    image = run_law(ReadyStage.of(composite, s, "standard"), layers, f)[Layer.IMAGE]
    untouched = (made[Layer.SHADOW] == 1).all(-1)
    assert untouched.mean() > 0.2 and (image[untouched] == plate[untouched]).all()


@pytest.mark.parametrize("level", LEVELS)
def test_no_light_makes_anything_that_is_not_finite(level: str) -> None:
    nan, inf = float("nan"), float("inf")
    odd = [
        DirectionalLight((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), DirectionalLight((0, 0, 1), (nan, 1, 1)),
        DirectionalLight((0, 0, 1), (1, inf, 1)), DirectionalLight((1, 0, 1e-9), (1, 1, 1), inf),
        DirectionalLight((0, 1, 0.3), (1, 1, 1), nan), DirectionalLight((0, 1, 0.3), (-1, -1, -1), 400.0),
        DirectionalLight((1e-200, 0, 1e-200), (1, 1, 1), -4.0),
    ]  # fmt: skip
    s = on_plane(box_model(), DARK)
    layers = surface(s, any_normals(s), far(s) * 0, material=(0.5, 0.0, 1.0)).crop(
        Rect(100, 80, 140, 110)
    )
    at = ReadyStage.of(Lightmap(), s, level)
    for light in odd:
        f = facts(s, from_above()).with_(light=Light((0.0, 0.0, 0.0), (light,)))
        assert at.stage.demand(f, s, s.camera.rect).reason
        made = run_law(at, layers, f)
        assert all(np.isfinite(a).all() for a in made.values()), light
