"""Scene files: what is refused, where the message points, and that the samples read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx import synth
from arfx.errors import ConfigError, InputError
from arfx.synth.description import load_scene, parse_scene
from arfx.synth.world import (
    camera_from_room,
    look_at,
    room_from_object,
    smooth_noise,
)

SAMPLES = sorted((Path(__file__).parents[3] / "sample_scenes").glob("*/scene.toml"))


def test_every_sample_scene_reads_and_is_small_enough() -> None:
    assert (
        len(SAMPLES) >= 8
        and sum(p.parent.name.startswith("09") for p in SAMPLES) >= 4
    )
    for path in SAMPLES:
        scene = load_scene(path)
        assert scene.configured and scene.description and scene.frames <= 60
        assert (
            scene.clip.width * scene.clip.height * scene.frames <= 18e6
        )  # tracing takes about a second a million pixels


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed = 1\n[clip]\nwidth = 640\nheigth = 360\n", r"s\.toml:4: clip\.heigth"),
        ("[[sphere]]\nradius_m = '5 parsec'\n", r"s\.toml:2: sphere\.0\.radius_m"),
        ("[[marker]]\nspec = '36h11:999:10cm'\n", r"s\.toml:2: marker\.0\.spec"),
        ("[lens]\naperture_m = '8mm'\n", "focus_m is needed"),
        ("[[box]]\nattached_to = 'nobody'\n", "names nothing"),
        ("[hidden]\ntransfer = 'rec2020'\n", "transfer"),
        ("[clip]\nfile = '../clip.mp4'\n", r"s\.toml:2: clip\.file"),
        (
            "[[box]]\nmotion.keys = [{ time_s = 1 }, { time_s = 1 }]\n",
            "times of keys must increase: 1 s stands behind 1 s",
        ),
        ("[clip\n", "not TOML"),
    ],
)
def test_a_wrong_key_is_named_with_its_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_scene(text, "s.toml")


def test_every_wrong_key_is_named_at_once() -> None:
    with pytest.raises(ConfigError) as e:
        parse_scene("sede = 1\n[clip]\nfps = -3\n", "s.toml")
    assert "sede" in str(e.value) and "fps" in str(e.value)


def test_a_missing_scene_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path / "none.toml")


def test_look_at_keeps_the_room_upright() -> None:
    pose = look_at(np.array([0.3, -0.4, 0.5]), np.array([0.1, 0.1, 0.0]))
    assert np.allclose(pose.apply(np.array([0.3, -0.4, 0.5])), 0)
    target = pose.apply(np.array([0.1, 0.1, 0.0]))
    assert np.allclose(target[:2], 0) and target[2] > 0
    up = pose.rotation @ [0, 0, 1]
    assert up[0] == pytest.approx(0, abs=1e-12) and up[1] < 0, (
        "the room's z points up in the picture (y down)"
    )
    assert np.linalg.det(pose.rotation) == pytest.approx(1)


def test_paths_run_from_their_start_to_their_end_and_through_their_keys() -> None:
    scene = parse_scene("""
        [[shot]]
        path = { kind = "orbit", target_m = [0.1, 0, 0], radius_m = "50cm", azimuth_deg = [-90, 0], elevation_deg = [30, 60] }
        [[shot]]
        path = { kind = "dolly", position_m = [0, -1, 1], end_m = [0, -2, 1], target_m = [1, 0, 0] }
        [[box]]
        motion = { kind = "keys", keys = [
          { time_s = 0, position_m = [0, 0, 0] }, { time_s = 1, position_m = [1, 0, 0] },
          { time_s = 2, position_m = [1, 3, 0] } ] }
        """)
    orbit, dolly = scene.shot[0].path, scene.shot[1].path
    first, last = (camera_from_room(orbit, t, 4.0, 0, "") for t in (0.0, 4.0))
    assert np.allclose(
        first.inverse().translation_m, [0.1, -0.5 * np.cos(np.radians(30)), 0.25]
    )
    assert np.allclose(
        last.inverse().translation_m, [0.1 + 0.25, 0, 0.5 * np.sin(np.radians(60))]
    )
    end = camera_from_room(dolly, 2.0, 2.0, 0, "")
    assert np.allclose(end.inverse().translation_m, [0, -2, 1]) and np.allclose(
        end.apply(np.array([1, 0, 0]))[:2], 0
    )
    box = scene.box[0]
    for t, at in (
        (-1, [0, 0, 0]),
        (0, [0, 0, 0]),
        (1, [1, 0, 0]),
        (2, [1, 3, 0]),
        (9, [1, 3, 0]),
    ):
        assert np.allclose(room_from_object(box, t, 0, "").translation_m, at)
    before, after = (
        room_from_object(box, 1 + dt, 0, "").translation_m for dt in (-1e-4, 1e-4)
    )
    now = room_from_object(box, 1, 0, "").translation_m
    assert np.allclose((now - before) / 1e-4, (after - now) / 1e-4, atol=1e-2), (
        "no jerk at a key"
    )


def test_tremor_has_the_stated_rms_and_is_smooth() -> None:
    values = np.array([smooth_noise(4, "x", t, 4.0) for t in np.arange(0, 60, 0.01)])
    assert np.sqrt((values**2).mean()) == pytest.approx(1, abs=0.1)
    assert np.abs(
        np.diff(values, axis=0)
    ).max() < 0.01 * 2 * np.pi * 4 * 1.6 * np.sqrt(12)


def test_the_robot_stands_on_its_base_and_has_a_flag() -> None:
    import trimesh

    scene = trimesh.load(Path(synth.__file__).with_name("robot.glb"))
    assert 2000 <= sum(len(g.faces) for g in scene.geometry.values()) <= 9000
    low, high = scene.bounds
    assert low[1] == pytest.approx(0, abs=0.02) and high[1] > 1, "y up"
    assert any(
        g.visual.material.baseColorTexture is not None
        for g in scene.geometry.values()
    )
    with pytest.raises(ConfigError, match="'block' or 'robot'"):
        parse_scene('[model]\nshape = "teapot"\n')
