"""Indirect light of the object and of the plane: white furnace, resolution, identity, hard
cases, and errata (docs/methods/gi.md#errata)."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.camera import Camera
from arfx.core.cube import CubeMap, SeenEnvironment
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.model import Material, Model, Part
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.errors import RenderError
from arfx.plan.planner import plan_frame
from arfx.run.frame import ready_stages, run_frame
from arfx.run.parameters import make_stages
from arfx.stages import STAGES, stages_with
from arfx.stages.gi import Gi, GiParams
from tests.scenes import box_model, facts, layers_of
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    EVEN,
    GLOWING,
    LAMP,
    MATT_RED,
    MATT_WHITE,
    MIRROR,
    NIGHT,
    ball,
    box,
    from_above,
    ground_points,
    inner,
    on_plane,
    plain_plate,
    run_gi,
    surface,
)

LEVELS = ["draft", "standard"]


def on(
    shape,
    material,
    light: Light = LAMP,
    height_m: float = 0.0,
    camera: Camera = CAMERA,
) -> Scene:  # type: ignore[no-untyped-def]
    return on_plane(shape(material), light, camera, height_m)


def ring(
    s: Scene,
    coverage: np.ndarray,
    low_m: float,
    high_m: float,
    pose: Pose | None = None,
) -> np.ndarray:
    g = ground_points(s, pose or from_above())
    away = np.hypot(g[..., 0], g[..., 1])
    return (coverage == 0) & (away > low_m) & (away < high_m)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("shape", [ball, box])
def test_white_furnace(level: str, shape) -> None:  # type: ignore[no-untyped-def]
    """White object, white plane, even light of 1 from everywhere: nothing is to be seen, at
    every level.
    """
    made = run_gi(
        on(shape, MATT_WHITE, EVEN), level, plate=plain_plate(rgb=(1, 1, 1))
    )
    light = made[Layer.VIRTUAL][inner(made[Layer.COVERAGE])]
    assert light.mean() == pytest.approx(1, abs=0.02)
    # what is left out after the last bounce is missing where walls and floor meet
    assert light.min() > 0.9 and light.max() < 1.02
    outside = made[Layer.SHADOW][made[Layer.COVERAGE] == 0]
    assert outside.mean() == pytest.approx(1, abs=0.01) and outside.max() < 1.02


@pytest.mark.parametrize("shape", [ball, box])
def test_brightness_does_not_depend_on_the_resolution(shape) -> None:  # type: ignore[no-untyped-def]
    s = on(shape, MATT_RED)
    a, b = run_gi(s, "draft"), run_gi(s, "standard")
    core = inner(a[Layer.COVERAGE])
    assert a[Layer.VIRTUAL][core].mean() == pytest.approx(
        b[Layer.VIRTUAL][core].mean(), rel=0.03
    )
    near = ring(s, a[Layer.COVERAGE], 0, 0.15)
    assert (1 - a[Layer.SHADOW][near]).mean() == pytest.approx(
        (1 - b[Layer.SHADOW][near]).mean(), abs=0.01
    )


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_a_red_object_colours_the_plane_and_a_black_one_darkens_it(
    level: str,
) -> None:
    params = GiParams(samples=16)
    red = run_gi(on(box, MATT_RED), level, params=params)
    black = run_gi(on(box, BLACK), level, params=params)
    near = ring(on(box, MATT_RED), red[Layer.COVERAGE], 0.0, 0.11)
    r, g, _ = red[Layer.SHADOW][near].mean(0)
    assert r - g > 0.03
    dark = black[Layer.SHADOW][near]
    assert dark.mean() < 0.93 and dark.max() <= 1 + 1e-5  # pure shadow
    assert np.abs(dark[:, 0] - dark[:, 1]).max() < 0.02
    assert black[Layer.VIRTUAL].max() == 0  # and sends nothing itself
    assert (red[Layer.VIRTUAL][red[Layer.COVERAGE] == 0] == 0).all()


@pytest.mark.parametrize("shape", [ball, box])
@pytest.mark.parametrize("level", LEVELS)
def test_a_convex_object_does_not_hide_the_light_from_itself(
    level: str, shape
) -> None:  # type: ignore[no-untyped-def]
    """Rays that met the surface they start on would find a dark grey object in an even light."""
    dark = replace(MATT_WHITE, base_colour=(0.1, 0.1, 0.1, 1.0))
    made = run_gi(on(shape, dark, EVEN), level, plate=plain_plate(rgb=(1, 1, 1)))
    up = inner(made[Layer.COVERAGE]) & (made[Layer.NORMAL][..., 2] > 0.9)
    assert made[Layer.VIRTUAL][up].mean() / 0.1 == pytest.approx(1, abs=0.03)


def test_the_plane_colours_the_object() -> None:
    s = on(ball, MATT_WHITE)
    made = run_gi(s, plate=plain_plate(rgb=(0.6, 0.1, 0.1)))
    grey = run_gi(s, plate=plain_plate(rgb=(0.3, 0.3, 0.3)))
    low = inner(made[Layer.COVERAGE]) & (made[Layer.NORMAL][..., 2] < -0.1)
    high = inner(made[Layer.COVERAGE]) & (made[Layer.NORMAL][..., 2] > 0.6)
    redness = made[Layer.VIRTUAL][..., 0] / made[Layer.VIRTUAL][..., 1].clip(1e-3)
    assert redness[low].mean() > 1.8 and redness[high].mean() < 1.2
    assert np.ptp(grey[Layer.VIRTUAL], axis=-1).max() < 1e-4


@pytest.mark.parametrize("level", ["standard", "reference"])
def test_a_mirror_shows_the_picture_on_the_plane(level: str) -> None:
    """Left half of the plane red, right half blue: in the ball's lower half too, on the
    same side.
    """
    s, pose = on(ball, MIRROR), from_above(turn_deg=0)
    plate = plain_plate(rgb=(0.6, 0.05, 0.05))
    plate[:, CAMERA.width // 2 :] = (0.05, 0.05, 0.6)
    made = run_gi(s, level, pose, plate, GiParams(samples=8))
    low = inner(made[Layer.COVERAGE]) & (made[Layer.NORMAL][..., 2] < 0.05)
    x = np.arange(CAMERA.width)[None] + 0 * low
    left, right = (
        made[Layer.VIRTUAL][low & (x < 74)].mean(0),
        made[Layer.VIRTUAL][low & (x > 86)].mean(0),
    )
    assert left[0] > 5 * left[2] and right[2] > 5 * right[0]


@pytest.mark.parametrize("level", ["draft", "standard"])
def test_an_emissive_object_lights_the_plane(level: str) -> None:
    s = on(ball, GLOWING)
    made = run_gi(s, level)
    near = ring(s, made[Layer.COVERAGE], 0, 0.12)
    assert (
        made[Layer.SHADOW][near].mean(0)[0] > 1.1
        and made[Layer.SHADOW][near].mean(0)[2] < 1
    )


@pytest.mark.parametrize("level", ["draft", "standard"])
@pytest.mark.parametrize("height", [0.0, 0.001, -0.03, 0.3])
def test_touching_hovering_and_sunk(level: str, height: float) -> None:
    s = on(box, BLACK, height_m=height)
    made = run_gi(s, level)
    assert all(np.isfinite(made[k]).all() for k in (Layer.VIRTUAL, Layer.SHADOW))
    dark = 1 - made[Layer.SHADOW][ring(s, made[Layer.COVERAGE], 0.0, 0.1)].mean()
    assert (dark > 0.07) if height < 0.01 else (dark < 0.1)


def test_a_millimetre_makes_no_jump() -> None:
    made = [run_gi(on(box, BLACK, height_m=h))[Layer.SHADOW] for h in (0.0, 0.001)]
    near = ring(on(box, BLACK), run_gi(on(box, BLACK))[Layer.COVERAGE], 0, 0.2)
    assert np.abs(made[0] - made[1])[near].mean() < 0.01


@pytest.mark.parametrize("level", ["draft", "standard"])
def test_camera_inside_and_an_object_that_fills_the_picture(level: str) -> None:
    s = on(box, MATT_RED)
    inside = Pose(
        from_above().rotation, -from_above().rotation @ np.array([0.0, 0.01, 0.05])
    )
    for pose in (inside, Pose(from_above(10).rotation, np.array([0, 0, 0.2]))):
        made = run_gi(s, level, pose)
        assert (
            np.isfinite(made[Layer.VIRTUAL]).all()
            and np.isfinite(made[Layer.SHADOW]).all()
        )


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_no_light_at_all(level: str) -> None:
    s = on(box, MATT_RED, NIGHT)
    made = run_gi(
        s, level, plate=plain_plate(rgb=(0, 0, 0)), params=GiParams(samples=2)
    )
    assert made[Layer.VIRTUAL].max() == 0 and (made[Layer.SHADOW] == 1).all()


def test_an_object_out_of_sight_of_the_plane_changes_no_pixel() -> None:
    """An empty delta is the identity, bit for bit: as high as the disc can reach, nothing
    is left to change.
    """
    made = run_gi(on(ball, BLACK, height_m=4.0))
    assert (made[Layer.SHADOW] == 1).all() and not made[Layer.VIRTUAL].any()
    nothing = run_gi(on(box, MATT_RED), params=GiParams(strength=0.0))
    assert (nothing[Layer.SHADOW] == 1).all()


def test_nothing_is_changed_beyond_the_disc() -> None:
    s, f = on(box, MATT_RED), facts(on(box, MATT_RED), from_above())
    wide = Camera(160, 120, np.array([[40.0, 0, 80], [0, 40, 60], [0, 0, 1]]))
    s = replace(s, camera=wide)
    rect = Gi().demand(facts(s, from_above()), s, wide.rect).rect
    assert not rect.empty and rect.area < wide.rect.area
    made = run_gi(s)[Layer.SHADOW].copy()
    made[rect.slices] = 1
    assert (made == 1).all() and f.visible


def test_a_picture_one_pixel_wide() -> None:
    s = on(
        box,
        MATT_RED,
        camera=Camera(1, 120, np.array([[150.0, 0, 0], [0, 150, 60], [0, 0, 1]])),
    )
    for level in ("draft", "standard", "reference"):
        made = run_gi(s, level, params=GiParams(samples=2))
        assert (
            made[Layer.SHADOW].shape == (120, 1, 3)
            and np.isfinite(made[Layer.VIRTUAL]).all()
        )


def test_contact_is_where_the_object_stands() -> None:
    s = on(ball, BLACK)
    pose = from_above(10, 0.6)
    dark = 1 - run_gi(s, "standard", pose)[Layer.SHADOW][..., 0]
    g = ground_points(s, pose)
    middle = (g * dark[..., None]).sum((0, 1)) / dark.sum()
    assert np.linalg.norm(middle[:2]) < 0.01
    # falls with the distance: form factor of the ball from the plane, (r / d)^2 x height / d
    for away in (0.15, 0.2):
        at = ring(s, np.zeros_like(dark), away - 0.01, away + 0.01, pose)
        d2 = away**2 + 0.06**2
        assert dark[at].mean() == pytest.approx(
            0.4 / (0.4 + 0.35) * 0.06**2 / d2 * 0.06 / np.sqrt(d2), rel=0.4
        )


def test_degenerate_parts() -> None:
    p = box_model(material=MATT_RED).parts[0]
    sliver = Part(
        np.array([[0, 0, 0], [0, 0, 0], [0.5, 0, 0.0]]),
        np.array([[0, 1, 2]], np.int32),
        np.tile([0, 0, 1.0], (3, 1)),
    )
    made = run_gi(on_plane(Model((p, sliver), up="z"), LAMP, CAMERA))
    assert (
        np.isfinite(made[Layer.VIRTUAL]).all()
        and np.isfinite(made[Layer.SHADOW]).all()
    )


def test_environment_of_the_facts_is_seen_from_the_right_side() -> None:
    """A red wall on +x, in the world's axes: a white ball is redder there, a mirror shows
    it there.
    """
    cube = np.full((6, 8, 8, 3), 0.2)
    cube[0] = (2.0, 0.0, 0.0)
    s = on(ball, MATT_WHITE, Light((0.4, 0.4, 0.4), ()))
    made = run_gi(s, environment=CubeMap.of(cube))
    n, core = made[Layer.NORMAL], inner(made[Layer.COVERAGE])
    redness = made[Layer.VIRTUAL][..., 0] - made[Layer.VIRTUAL][..., 1]
    assert redness[core & (n[..., 0] > 0.5)].mean() > 0.15
    assert (
        redness[core & (n[..., 0] < -0.5)].mean() < -0.1
    )  # scaled to the plane's light, which is grey
    cube[5, 0, 0] = np.nan
    with pytest.raises(RenderError, match="environment"):
        run_gi(s, environment=CubeMap.of(cube))


def test_kept_light_is_used_again_and_another_is_not() -> None:
    s = on(box, MATT_RED)
    ready, f = ReadyStage.of(Gi(), s, "standard"), facts(s, from_above())
    layers = layers_of(CAMERA.rect, surface(s, f) | {Layer.PLATE: plain_plate()})
    out = []
    for light in (LAMP, LAMP, EVEN, LAMP):
        out.append(ready.run(layers, f.with_(light=light))[Layer.VIRTUAL].array)  # type: ignore[union-attr]
    assert np.array_equal(out[0], out[3])
    assert np.abs(out[0] - out[2]).max() > 0.1
    assert ready.memo.of_light.made == 2, "each light is solved once"


@pytest.mark.parametrize("level", LEVELS)
def test_light_that_grows_and_turns_blue_is_followed_without_steps(
    level: str,
) -> None:
    """Light is kept in steps of some per cent, and shown as bright as it is."""
    s, pose = on(ball, MATT_WHITE, EVEN), from_above()
    ready, f = ReadyStage.of(Gi(), s, level), facts(s, pose)
    seen = []
    growth = np.linspace(1, 1.06, 13)[:, None] ** [1.0, 1.0, 2.0]
    for times in growth:
        light = Light(
            ambient_rgb=tuple((times * EVEN.ambient_rgb).tolist()), lights=()
        )
        plate = (plain_plate() * times).astype(np.float32)
        layers = layers_of(CAMERA.rect, surface(s, f) | {Layer.PLATE: plate})
        out = ready.run(layers, f.with_(light=light))[Layer.VIRTUAL]
        assert isinstance(out, Pixels)
        seen.append(out.array.sum((0, 1)))
    np.testing.assert_allclose(seen / seen[0], growth, rtol=0.004)
    assert ready.memo.of_light.made < len(growth)


@pytest.mark.parametrize("level", LEVELS)
def test_surroundings_that_turn_into_others_are_followed_without_steps(
    level: str,
) -> None:
    halves = {}
    for name, face in (("from the right", 0), ("from the left", 1)):
        halves[name] = np.ones((6, 8, 8, 4), np.float16)
        halves[name][face, ..., :3] = 3
    s = replace(on(ball, MATT_WHITE, EVEN), environment_maps=halves)
    ready, f = ReadyStage.of(Gi(), s, level), facts(s, from_above())
    layers = layers_of(CAMERA.rect, surface(s, f) | {Layer.PLATE: plain_plate()})
    middle, seen = CAMERA.rect.width // 2, []
    for share in np.linspace(0, 1, 21):
        around = SeenEnvironment(tuple(halves), float(share))
        out = ready.run(layers, f.with_(light=EVEN, seen_environment=around))[
            Layer.VIRTUAL
        ]
        assert isinstance(out, Pixels)
        seen.append(out.array[:, :middle].sum() - out.array[:, middle:].sum())
    steps = np.diff(seen)
    assert np.abs(steps).min() > 0
    assert np.ptp(steps) < 0.2 * np.abs(steps).mean()


def test_a_job_with_gi_has_lightmap_and_takes_its_ambient_light() -> None:
    assert stages_with(["gi"]) == ("raster", "lightmap", "gi", "composite")
    config = SimpleNamespace(
        pipeline=SimpleNamespace(stages=("lightmap", "gi")), input=SimpleNamespace(depth=None),
        params={name: STAGES[name].Params() for name in STAGES},
    )  # fmt: skip
    stages = make_stages(config)  # type: ignore[arg-type]
    assert stages["lightmap"].soft is False  # type: ignore[attr-defined]
    config.pipeline.stages = ("lightmap",)
    assert make_stages(config)["lightmap"].soft is True  # type: ignore[arg-type, attr-defined]
    config.pipeline.stages = "auto"
    assert "gi" not in make_stages(config)  # type: ignore[arg-type]


@pytest.mark.parametrize("pipeline", [("lightmap",), ("lightmap", "gi")])
@pytest.mark.parametrize(
    ("metallic", "roughness"), [(0.0, 0.5), (1.0, 0.1), (1.0, 0.4), (1.0, 0.9)]
)
def test_a_ball_in_an_even_white_room_shows_its_light_once(
    pipeline: tuple[str, ...], metallic: float, roughness: float
) -> None:
    """What lightmap mirrors of the surroundings in every job gi does not add again."""
    white = Material(
        base_colour=(1.0, 1.0, 1.0, 1.0), metallic=metallic, roughness=roughness
    )
    s = on(ball, white, EVEN)
    params = {name: STAGES[name].Params() for name in STAGES}
    config = SimpleNamespace(
        pipeline=SimpleNamespace(stages=pipeline),
        input=SimpleNamespace(depth=None),
        params=params,
    )
    stages = make_stages(config)  # type: ignore[arg-type]
    levels = {
        name: level_named(stage.levels, "standard") for name, stage in stages.items()
    }
    plan = plan_frame(
        list(stages.values()), levels, facts(s, from_above()), s, CAMERA.rect
    )
    plate = plain_plate(rgb=(1, 1, 1))[plan.rect.slices]
    layers = run_frame(
        plate, facts(s, from_above()), plan, ready_stages(plan, stages, s)
    ).layers
    made = layers.view(plan.rect)
    assert ("gi" in stages) == ("gi" in pipeline)
    light = made[Layer.VIRTUAL][inner(made[Layer.COVERAGE])]
    assert len(light) > 500 and light.mean() == pytest.approx(1, abs=0.02)


def test_settings_are_checked_and_the_demand_tells_why() -> None:
    for wrong in ({"strength": 2.0}, {"samples": 0}):
        with pytest.raises(ValidationError):
            GiParams(**wrong)  # type: ignore[arg-type]
    s = on(box, MATT_RED)
    f = facts(s, from_above())
    assert "half a grey level within" in Gi().demand(f, s, CAMERA.rect).reason
    below = f.with_(
        camera_from_world=Pose(np.eye(3), np.array([0, 0, 0.5])),
        model_box=Rect(0, 0, 0, 0),
    )
    assert "behind" in Gi().demand(below, s, CAMERA.rect).reason
    away = f.with_(light=NIGHT)
    assert "no indirect light" in Gi().demand(away, s, CAMERA.rect).reason
