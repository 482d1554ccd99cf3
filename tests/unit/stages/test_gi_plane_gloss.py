"""The object mirrored in a glossy real plane, and measured depth that says what is no plane."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from arfx.core.cube import CubeMap
from arfx.core.layers import Layer
from arfx.core.model import Material
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, level_named
from arfx.papers.s4_gi import PrintedGi
from arfx.stages.gi import Gi, GiParams
from arfx.stages.light.planes import PlatePicture, planes_of, texel_positions
from tests.contract.stage_laws import check_roi_law
from tests.scenes import facts
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    EVEN,
    LAMP,
    MATT_RED,
    ball,
    box,
    from_above,
    ground_points,
    inner,
    on_plane,
    plain_plate,
    run_gi,
)

SCENE = on_plane(box(MATT_RED), LAMP, CAMERA)
POSE = from_above(55)


def mirror_image() -> np.ndarray:
    """Pixels of the plane whose mirrored line of sight meets the box of 12 cm; closed form."""
    g = ground_points(SCENE, POSE)
    eye = POSE.inverse().translation_m
    d = (g - eye) * [1, 1, -1]
    low, high = np.array([-0.06, -0.06, 0]), np.array([0.06, 0.06, 0.12])
    with np.errstate(all="ignore"):
        a, b = (low - g) / d, (high - g) / d
    near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return np.asarray((near < far) & (far > 1e-6))


@cache
def by_rays() -> tuple[np.ndarray, np.ndarray]:
    """SHADOW with and without the gloss."""
    both = (GiParams(plane_gloss=g, samples=10) for g in (0.3, 0.0))
    shiny, matt = (
        run_gi(SCENE, "reference", POSE, params=p)[Layer.SHADOW] for p in both
    )
    return shiny, matt


@pytest.mark.parametrize("level", ["draft", "standard"])
def test_the_mirror_image_is_where_and_as_strong_as_rays_say(level: str) -> None:
    params = GiParams(plane_gloss=0.3)
    matt = params.model_copy(update=dict(plane_gloss=0.0))
    made, without = (
        run_gi(SCENE, level, POSE, params=p)[Layer.SHADOW] for p in (params, matt)
    )
    true, plain = by_rays()
    bare = run_gi(SCENE, level, POSE, params=matt)[Layer.COVERAGE] == 0
    image = mirror_image() & bare
    change, expected = made - without, true - plain
    assert expected[image][:, 1].mean() < -0.1, "red takes the place of grey"
    np.testing.assert_allclose(
        change[image].mean(0), expected[image].mean(0), atol=0.035
    )
    assert np.abs(change[bare]).sum() < 1.35 * np.abs(change[image]).sum(), (
        "next to nothing beside it"
    )


def test_a_matt_plane_mirrors_nothing_and_asks_for_nothing() -> None:
    f = facts(SCENE, POSE)
    plain, shiny = (
        Gi(GiParams(plane_gloss=g)).demand(f, SCENE, CAMERA.rect) for g in (0.0, 0.04)
    )
    assert (
        "mirrors" not in plain.reason and "mirrors 0.04 of the light" in shiny.reason
    )
    assert shiny.rect.contains(plain.rect)


@pytest.mark.parametrize("kind", [Gi, PrintedGi])
def test_a_part_of_the_picture_is_as_the_whole(kind: type[Gi]) -> None:
    stage = kind(kind.Params(plane_gloss=0.5))
    check_roi_law(
        ReadyStage.of(stage, SCENE, level_named(stage.levels, "draft")),
        facts(SCENE, POSE),
        3,
    )


def test_no_light_is_taken_that_is_not_there() -> None:
    """A black picture of the plane stays black; nothing becomes negative or infinite."""
    plate = np.zeros((CAMERA.height, CAMERA.width, 3), np.float32)
    for pose in (POSE, from_above(80, 0.3), from_above(0, 0.5)):
        made = run_gi(SCENE, "draft", pose, plate, GiParams(plane_gloss=1.0))
        assert np.isfinite(made[Layer.SHADOW]).all() and made[Layer.SHADOW].min() >= 0


def depth_with_a_thing() -> np.ndarray:
    """The plane's depth, and something 10 cm before it in the left half."""
    g = ground_points(SCENE, POSE)
    depth = POSE.apply(g)[..., 2].astype(np.float32)
    depth[:, : CAMERA.width // 2] -= 0.1
    return depth


def measure(monkeypatch: pytest.MonkeyPatch, depth: np.ndarray) -> None:
    """Depth, metres, is measured in all frames from now on."""
    from tests.unit.stages import gi_scenes

    bare = gi_scenes.surface
    monkeypatch.setattr(
        gi_scenes,
        "surface",
        lambda s, f: bare(s, f) | {Layer.REAL_DEPTH: depth.astype(np.float32)},
    )


@pytest.mark.parametrize("level", ["standard", "reference"])
def test_what_is_not_on_the_plane_is_left_alone(
    level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = GiParams(plane_gloss=0.3, samples=4)
    plain = run_gi(on_plane(box(BLACK), EVEN, CAMERA), level, POSE, params=params)
    measure(monkeypatch, depth_with_a_thing())
    made = run_gi(on_plane(box(BLACK), EVEN, CAMERA), level, POSE, params=params)[
        Layer.SHADOW
    ]
    left = np.arange(CAMERA.width) < CAMERA.width // 2
    assert (made[:, left] == 1).all()
    np.testing.assert_allclose(
        made[:, ~left], plain[Layer.SHADOW][:, ~left], atol=0.02
    )
    assert made[:, ~left].min() < 0.9


def test_a_thing_before_the_plane_is_no_picture_of_the_plane() -> None:
    planes = planes_of(SCENE)
    places = texel_positions(planes, 32)
    plate = np.full((CAMERA.height, CAMERA.width, 3), 0.5, np.float32)
    plate[:, : CAMERA.width // 2] = 9
    whole = Rect.of(CAMERA.width, CAMERA.height)
    axes, nothing = planes.axes[0].astype(float), np.zeros((0, 0), np.float32)
    shown = PlatePicture(
        plate,
        whole,
        whole,
        CAMERA,
        POSE,
        np.zeros(3, np.float32),
        depth_with_a_thing(),
    )
    seen, known = shown.radiance(places[0], axes)
    assert known.sum() > 20 and seen[known > 0].max() < 5
    _, all_of_it = replace(shown, real=nothing).radiance(places[0], axes)
    assert known.sum() < 0.8 * all_of_it.sum()


@pytest.mark.parametrize("level", ["standard", "reference"])
def test_a_thing_before_the_plane_sends_the_object_no_light_of_the_plane(
    level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(monkeypatch, depth_with_a_thing())
    even = np.full((CAMERA.height, CAMERA.width, 3), 0.5, np.float32)
    thing = even.copy()
    thing[:, : CAMERA.width // 2] = 9
    scene = on_plane(box(Material("white")), EVEN, CAMERA)
    lit = [
        run_gi(scene, level, POSE, plate, GiParams(samples=16))[Layer.VIRTUAL].mean(
            (0, 1)
        )
        for plate in (even, thing)
    ]
    np.testing.assert_allclose(lit[1], lit[0], rtol=0.1)


def test_measured_planes_are_real_planes_unless_they_are_the_anchors() -> None:
    floor = RealPlane(
        Pose(np.eye(3), np.array([0.3, 0.1, 0.01])), (-1, -1, 1, 1), 4.0, 3.0, 900
    )
    wall = Pose(np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]), np.array([-0.2, 0, 0]))
    behind = Pose(wall.rotation, np.array([0.3, 0, 0]))
    scene = replace(
        SCENE,
        real_planes=(
            floor,
            *(RealPlane(p, (-1, -1, 1, 1), 4.0, 3.0, 900) for p in (wall, behind)),
        ),
    )
    axes = planes_of(scene).axes
    assert (
        len(axes) == 2
        and np.allclose(axes[1, 3], [1, 0, 0])
        and np.allclose(axes[1, 0, 0], -0.2, atol=1e-6)
    )


@pytest.mark.parametrize("level", ["standard", "reference"])
def test_a_plane_over_the_table_leaves_what_is_measured_on_the_table(
    level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Depth says that pixels show the table, not what was once seen 3 cm over it."""
    scene, params = on_plane(box(BLACK), EVEN, CAMERA), GiParams(samples=16)
    gone = RealPlane(
        Pose(np.eye(3), np.array([0, 0, 0.03])), (-1, -1, 1, 1), 4.0, 3.0, 900
    )
    measure(monkeypatch, POSE.apply(ground_points(scene, POSE))[..., 2])
    alone, made = (
        run_gi(s, level, POSE, params=params)[Layer.SHADOW]
        for s in (scene, replace(scene, real_planes=(gone,)))
    )
    dark = alone[..., 0] < 0.9
    assert dark.sum() > 50 and made[dark].mean() < 0.93


@pytest.mark.parametrize("roughness", [0.3, 1.0])
@pytest.mark.parametrize("level", ["draft", "standard", "reference"])
def test_what_stands_behind_a_plane_does_not_see_it(
    level: str, roughness: float
) -> None:
    """A dark wall through the middle of a ball: its far half is as bright as without it."""
    body = Material(base_colour=(1.0, 1.0, 1.0, 1.0), roughness=roughness)
    scene, params = on_plane(ball(body), EVEN, CAMERA), GiParams(samples=16)
    facing_right = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    wall = RealPlane(Pose(facing_right, np.zeros(3)), (-1, -1, 1, 1), 4.0, 3.0, 900)
    plate = plain_plate(rgb=(0.02, 0.02, 0.02))
    alone, made = (
        run_gi(s, level, POSE, plate, params)
        for s in (scene, replace(scene, real_planes=(wall,)))
    )
    far = inner(alone[Layer.COVERAGE]) & (alone[Layer.NORMAL][..., 0] < -0.6)
    lit = [of[Layer.VIRTUAL][far].mean() for of in (alone, made)]
    np.testing.assert_allclose(lit[1], lit[0], rtol=0.06)


@pytest.mark.parametrize("level", ["standard", "reference"])
def test_a_table_ends_for_what_mirrors_it(level: str) -> None:
    """Beside the table's edge a mirror shows what is behind the table, not more table."""
    cube = np.full((6, 8, 8, 3), 0.3)
    cube[5] = (0.0, 0.0, 2.0)  # below the table: blue
    mirror = Material(base_colour=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
    whole = on_plane(ball(mirror), EVEN, CAMERA)
    table = RealPlane(
        Pose.identity(),
        (-1.0, -0.1, 1.0, 1.0),
        2.0,
        3.0,
        900,
        1,
        (False, True, False, False),
    )
    blue = []
    for scene in (whole, replace(whole, real_planes=(table,))):
        made = run_gi(
            scene,
            level,
            POSE,
            params=GiParams(samples=4),
            environment=CubeMap.of(cube),
        )
        low = (made[Layer.COVERAGE] > 0) & (made[Layer.NORMAL][..., 2] < 0.2)
        blue.append(made[Layer.VIRTUAL][low][:, 2] - made[Layer.VIRTUAL][low][:, 0])
    assert (blue[0] < 0.2).all() and (blue[1] > 0.5).mean() > 0.02
    np.testing.assert_allclose(
        planes_of(replace(whole, real_planes=(table,))).bounds[0, 1], -0.1, atol=1e-6
    )
