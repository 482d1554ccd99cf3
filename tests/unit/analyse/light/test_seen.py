"""What a clip saw of its surroundings: a mirror ball shows the room, without seam or
flicker; what was not seen is guessed.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from arfx.analyse.light import seen
from arfx.analyse.light.seen import Snapshot, given_everywhere, with_seen
from arfx.analyse.light.surroundings import (
    environment_sample,
    turned,
    with_environment,
)
from arfx.core.camera import Camera
from arfx.core.cube import bordered, face_directions, look_up, resampled
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light
from arfx.core.pose import rotation_from_euler_deg
from arfx.core.scene import Scene
from arfx.errors import RenderError
from arfx.stages.gi.health import seam_ratio
from arfx.stages.light.surroundings import frame_surroundings, seen_map
from tests.unit.analyse.light.seen_rooms import (
    CAMERA,
    UP,
    Clip,
    irradiance,
    sky,
    walls,
)
from tests.unit.stages.gi_scenes import (
    MIRROR,
    ball,
    facts,
    inner,
    on_plane,
    run_gi,
    surface,
)

QUAD = np.array(
    [[30.0, 70], [45, 70], [45, 85], [30, 85]]
)  # on the desk, in the looks' pixels
ROUND = Clip(walls(2.0), (-170, 170))
CLIPS = {
    "round a room": ROUND,
    "most of the way round a small room": Clip(walls(1.4, 2.4), (-190, 80)),
    "round a hall": Clip(walls(5.0, 3.0), (-120, 200), distance_m=0.9),
    "under a sky": Clip(sky, (-90, 230), looks_at_m=0.39),
}


def analysed(
    clip: Clip, still_camera: bool = False
) -> tuple[tuple[FrameFacts, ...], dict[str, np.ndarray]]:
    samples = [
        environment_sample(
            look.frame,
            look.picture.astype(float),
            QUAD,
            look.picture.shape[1],
            np.zeros(3),
        )
        for look in clip.looks
    ]
    guessed = with_environment(clip.facts, samples, still_camera)
    return with_seen(guessed, clip.looks, CAMERA, still_camera, np.zeros(3), UP)


def scene(maps: dict[str, np.ndarray]) -> Scene:
    return replace(on_plane(ball(MIRROR), Light(), CAMERA), environment_maps=maps)


def seen_now(f: FrameFacts, s: Scene) -> np.ndarray:
    """(6, n, n, 4) what was seen, WORLD axes."""
    known = f.seen_environment
    assert known is not None
    first, second = (seen_map(name, s) for name in known.maps)
    axes = np.eye(3) if known.axes is None else np.reshape(known.axes, (3, 3))
    return turned(first + known.share * (second - first), axes)


def cubes(f: FrameFacts, s: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Radiance as a mirror sees it, and as a matt surface does."""
    assert f.light is not None
    return frame_surroundings(f, s, f.light).cubes()


def traced(clip: Clip, f: FrameFacts, s: Scene) -> tuple[np.ndarray, np.ndarray]:
    """((n, 3) radiance of the mirror ball's inner pixels, whether they are)."""
    layers = surface(s, f)
    core = inner(layers[Layer.COVERAGE])
    at, normal = (
        layers[Layer.POSITION][core].astype(float),
        layers[Layer.NORMAL][core].astype(float),
    )
    towards = at - f.pose.inverse().translation_m
    away = towards - 2 * (towards * normal).sum(1, keepdims=True) * normal
    return clip.shown(f.index)(at, away), core


@pytest.mark.parametrize("name", CLIPS)
def test_a_mirror_ball_shows_the_room(name: str) -> None:
    """Mean absolute error of linear radiance over the ball against rays in the true room:
    half of the guess's, or less.
    """
    clip = CLIPS[name]
    found, maps = analysed(clip)
    f = found[18]
    x, y = CAMERA.project(f.pose.apply(np.array([0, 0, 0.06])))
    near = Camera(
        110,
        110,
        np.array(
            [
                [560.0, 0, 54.5 - 4 * (x - CAMERA.cx)],
                [0, 560, 54.5 - 4 * (y - CAMERA.cy)],
                [0, 0, 1],
            ]
        ),
    )
    s = replace(on_plane(ball(MIRROR, 4), Light(), near), environment_maps=maps)
    assert f.environment is not None and all(
        m.shape == (6, 64, 64, 4) for m in maps.values()
    )
    given = {
        "plate": clip.picture(18, near),
        "light": f.light,
        "environment": f.environment,
    }
    error = []
    for seen_environment in (None, f.seen_environment):
        made = run_gi(
            s, "standard", f.pose, seen_environment=seen_environment, **given
        )
        truth, core = traced(clip, facts(s, f.pose).with_(index=18), s)
        error.append(np.abs(made[Layer.VIRTUAL][core] - truth).mean())
    assert error[1] < 0.5 * error[0], error


@pytest.mark.parametrize(
    ("name", "radius_m"),
    [("round a room", 2.0), ("round a hall", 5.0), ("under a sky", np.inf)],
)
def test_the_rooms_distance_is_where_the_pictures_agree(
    name: str, radius_m: float
) -> None:
    clip = CLIPS[name]
    lit = [(look, clip.facts[look.frame]) for look in clip.looks]
    posed = [
        seen._Posed(look, f, f.light or Light(), CAMERA, False, np.zeros(3))
        for look, f in lit
    ]
    assert seen._inverse_radius(posed, UP) == pytest.approx(1 / radius_m, rel=0.35)


def test_a_grey_room_is_grey_without_a_seam() -> None:
    grey = np.array([0.2, 0.4, 0.3])
    clip = Clip(lambda o, d: np.broadcast_to(grey, d.shape), (-170, 170))
    found, maps = analysed(clip)
    for cube in cubes(found[20], scene(maps)):
        np.testing.assert_allclose(cube, np.broadcast_to(grey, cube.shape), rtol=4e-3)
    # a room with something in it
    found, maps = analysed(ROUND)
    whole = cubes(found[20], scene(maps))[0]
    assert seam_ratio(whole[:, ::4, ::4]) < 1.6


def test_faces_join_across_their_edges() -> None:
    d = face_directions(16)
    smooth = np.stack(
        [1 + d[..., 0], 1 + d[..., 1] * d[..., 2], 1 - d[..., 2], d[..., 0] ** 2], -1
    )
    np.testing.assert_array_equal(bordered(smooth)[:, 1:-1, 1:-1], smooth)
    fine, e = resampled(smooth, 64), face_directions(64)
    want = np.stack(
        [1 + e[..., 0], 1 + e[..., 1] * e[..., 2], 1 - e[..., 2], e[..., 0] ** 2], -1
    )
    np.testing.assert_allclose(fine, want, atol=0.012)
    assert seam_ratio(fine[:, ::2, ::2]) < 1.5
    many = np.random.default_rng(1).normal(size=(500, 3))
    np.testing.assert_allclose(look_up(fine, many), look_up(want, many), atol=0.012)


def test_what_was_seen_is_known_and_the_rest_is_the_guess() -> None:
    clip = Clip(walls(1.4), (-90, -80))
    found, maps = analysed(clip)
    rgba = seen_now(found[20], scene(maps))
    ahead, behind, above = look_up(
        rgba, np.array([[0.08, 1, 0.3], [0, -1, 0.3], [0, 0, 1.0]])
    )[:, 3]
    assert ahead == pytest.approx(1, abs=1e-3) and behind < 0.02 and above < 0.5
    assert (rgba[..., 3].ravel() <= 1).all() and np.ptp(rgba[..., 3]) > 0.97


def test_the_map_follows_the_clip() -> None:
    clip = Clip(walls(2.0), (-90, -90), seconds=16.0, later=walls(2.0, tint=0.4))
    found, maps = analysed(clip)
    ahead = np.array([[0.2, 1, 0.25]])
    first, last = (
        look_up(seen_now(found[k], scene(maps)), ahead)[0, :3] for k in (4, 36)
    )
    shares = [found[k].light.mean_radiance for k in (4, 36)]  # type: ignore[union-attr]
    assert last * shares[1] == pytest.approx(0.4 * first * shares[0], rel=0.1)


def test_a_still_room_does_not_flicker() -> None:
    """Under noise of 2 % of white: beside maps of single looks, one in each frame."""
    clip = replace(ROUND.at_rest(), seconds=8.0)
    noise = np.random.default_rng(3)
    looks = [Snapshot(look.frame, np.clip(look.picture + noise.normal(0, 0.02, look.picture.shape), 0, 1).astype(np.float16), look.darkest)
             for look in clip.looks]  # fmt: skip
    found, maps = with_seen(analysed(clip)[0], looks, CAMERA, False, np.zeros(3), UP)
    s = scene(maps)
    shown = [frame_surroundings(f, s, f.light).cubes()[0] for f in found]  # type: ignore[arg-type]
    step = np.mean([np.abs(b - a).mean() for a, b in itertools.pairwise(shown)])
    alone = [
        with_seen([*clip.facts], [look], CAMERA, False, np.zeros(3), UP)
        for look in looks[6:8]
    ]
    a, b = (seen_now(f[0], scene(m))[..., :3] for f, m in alone)
    each_alone = np.abs((b - a) * clip.facts[0].light.mean_radiance).mean()  # type: ignore[union-attr]
    assert step < 0.1 * each_alone and step < 1e-3
    assert max(np.abs(b - a).max() for a, b in itertools.pairwise(shown)) < 0.02


def test_a_lamp_that_is_a_light_is_not_seen_twice() -> None:
    def lit(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        d = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.where(
            d @ lamp[:, None] > np.cos(np.radians(4)), 1.0, sky(origins, directions)
        )

    lamp = np.array([0.1, 0.95, 0.29])
    lamp /= np.linalg.norm(lamp)
    clip = Clip(lit, (-100, -80))
    found, maps = analysed(clip)
    at = np.array([lamp])
    assert look_up(seen_now(found[20], scene(maps)), at)[0, :3].max() > 1.5
    light = replace(
        clip.facts[0].light, lights=(DirectionalLight(tuple(lamp), (0.0, 0.0, 0.0)),)
    )  # type: ignore[type-var]
    known = [f.with_(light=light) for f in clip.facts]
    found, maps = with_seen(known, clip.looks, CAMERA, False, np.zeros(3), UP)
    assert look_up(seen_now(found[20], scene(maps)), at)[0, :3].max() < 1.2


def test_before_a_still_camera_the_map_rests_in_the_cameras_axes() -> None:
    clip = ROUND.at_rest()
    turn = rotation_from_euler_deg(0, 0, 70)
    moved = [
        (
            f.with_(
                camera_from_world=replace(f.pose, rotation=f.pose.rotation @ turn)
            )
            if f.index > 20
            else f
        )
        for f in clip.facts
    ]
    found, maps = with_seen(moved, clip.looks, CAMERA, True, np.zeros(3), UP)
    before, after = (seen_now(found[k], scene(maps)) for k in (20, 21))
    ahead = np.array([0, 0, 1.0])
    for k, rgba in ((20, before), (21, after)):
        world = found[k].pose.rotation.T @ ahead
        np.testing.assert_allclose(
            look_up(rgba, world[None])[0],
            look_up(before, (found[20].pose.rotation.T @ ahead)[None])[0],
            atol=0.06,
        )


def test_a_given_panorama_is_known_everywhere() -> None:
    picture = np.full((64, 128, 3), 0.2, np.float32)
    picture[:, 30:34] = 0.8
    found, maps = given_everywhere(ROUND.facts, picture, np.eye(3))
    (rgba,) = maps.values()
    assert rgba.shape == (6, 64, 64, 4) and (rgba[..., 3] == 1).all()
    side, other = look_up(rgba.astype(float), np.array([[0, 1.0, 0], [0, -1.0, 0]]))[
        :, 0
    ]
    assert side / other == pytest.approx(4, rel=0.1)
    assert {f.seen_environment for f in found} == {found[0].seen_environment}
    given = found[0]
    narrow, wide = cubes(given, scene(maps))
    np.testing.assert_array_equal(narrow, wide)
    assert irradiance(narrow, UP) == pytest.approx(
        given.light.soft_radiance(UP), rel=1e-4
    )  # type: ignore[union-attr]


def test_frames_without_a_pose_have_none_and_a_missing_map_is_said() -> None:
    lost = [
        f if f.index % 2 else f.with_(camera_from_world=None) for f in ROUND.facts
    ]
    found, maps = with_seen(
        lost,
        [Snapshot(1, ROUND.looks[0].picture, np.zeros(3))],
        CAMERA,
        False,
        np.zeros(3),
        UP,
    )
    assert (
        found[0].seen_environment is None
        and found[1].seen_environment is not None
        and len(maps) == 1
    )
    with pytest.raises(RenderError, match="is not among the job's"):
        seen_now(found[1], scene({}))
    assert with_seen(lost, [], CAMERA, False, np.zeros(3), UP)[1] == {}
    assert (
        FrameFacts.from_json(found[1].to_json()).seen_environment
        == found[1].seen_environment
    )


def test_a_fisheye_lens_sees_what_it_sees() -> None:
    wide = Camera(
        120,
        120,
        np.array([[60.0, 0, 59.5], [0, 60, 59.5], [0, 0, 1]]),
        np.zeros(4),
        "fisheye",
    )
    clip = CLIPS["under a sky"].at_rest()
    looks = [
        Snapshot(k, clip.picture(k, wide).astype(np.float16), np.zeros(3))
        for k in (0, 20)
    ]
    found, maps = with_seen(clip.facts, looks, wide, False, np.zeros(3), UP)
    rgba = seen_now(found[0], scene(maps))
    assert np.isfinite(rgba).all() and (rgba[..., 3] > 0.99).mean() > 0.15
    around = np.array(
        [
            clip.pose(0).rotation[2],
            clip.pose(0).rotation[2] + [0, 0, 0.7],
            clip.pose(0).rotation[2] + 0.5 * clip.pose(0).rotation[0],
        ]
    )
    shown = look_up(rgba, around)[:, :3] * clip.facts[0].light.mean_radiance  # type: ignore[union-attr]
    np.testing.assert_allclose(shown, sky(np.zeros((3, 3)), around), atol=0.02)
