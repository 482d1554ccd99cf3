"""The yardstick itself: errors of known size must come out as they were put in."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts
from arfx.core.light import DirectionalLight, Light
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from arfx.measure.truth import (
    compare,
    cuts,
    exceeded,
    light_errors,
    map_errors,
    pose_errors,
    presence,
    world_key,
)
from arfx.synth.clip import frame_truth
from arfx.synth.truth import Truth
from tests.unit.synth.little_scenes import little_scene, picture_of

KEY, SIZE = "36h11:3", 0.1


@pytest.fixture(scope="module")
def truth() -> Truth:
    scene = little_scene(
        320, 240, frames=40,
        path={"kind": "orbit", "radius_m": 0.5, "azimuth_deg": [-130, -40], "elevation_deg": [35, 55], "hand_deg": 0.3},
        marker=[{"spec": f"{KEY}:100mm"}, {"spec": "36h11:4:60mm", "position_m": [0.12, 0.03, 0], "rotate_deg": [0, 0, 25]}],
        light={"lamps": [{"azimuth_deg": 30, "elevation_deg": 60}]},
    )  # fmt: skip
    world, _ = picture_of(scene)
    header = {
        "arfx_truth": 1,
        "world": KEY,
        "markers": {KEY: SIZE, "36h11:4": 0.06},
        "camera": world.camera.to_json(),
    }
    return Truth(header, tuple(frame_truth(world, n) for n in range(40)))


def exact(truth: Truth, key: str = KEY) -> list[Pose]:
    return [f.markers[key].camera_from_marker for f in truth.frames]


def facts_of(truth: Truth, poses: list[Pose], **more: object) -> list[FrameFacts]:
    return [
        FrameFacts(f.index, f.time_s, f.shot, MEASURED, p, p, opacity=1.0, **more)  # type: ignore[arg-type]
        for f, p in zip(truth.frames, poses, strict=True)
    ]


def test_the_truth_itself_has_no_error(truth: Truth) -> None:
    e = pose_errors(exact(truth), truth, KEY, SIZE)
    assert e["frames"] == 40 and e["flips"] == 0
    assert (
        max(
            e["rotation_deg"]["max"],
            e["position_mm"]["max"],
            e["corner_px"],
            e["tremble_px"],
        )
        < 1e-6
    )
    assert abs(e["lag_frames"]) < 1e-6


def test_errors_come_out_as_they_were_put_in(truth: Truth) -> None:
    """Turned by 1.5 degrees about the marker's own z, moved by 3 mm along the optical axis."""
    wrong = [
        Pose(np.eye(3), np.array([0, 0, 0.003]))
        @ p
        @ Pose.from_rotvec(np.radians([0, 0, 1.5]), np.zeros(3))
        for p in exact(truth)
    ]
    e = pose_errors(wrong, truth, KEY, SIZE)
    assert e["rotation_deg"] == {
        k: pytest.approx(1.5) for k in ("median", "p95", "max")
    }
    assert e["position_mm"] == {
        k: pytest.approx(3.0) for k in ("median", "p95", "max")
    }
    f, side = 160 / np.tan(np.radians(30)), 0.1
    turned = (
        f * side / np.sqrt(2) * np.radians(1.5) / 0.5
    )  # px at the corners, at 0.5 m, if the view were frontal
    assert 0.6 * turned < e["corner_px"] < 1.3 * turned


def mirrored(pose: Pose) -> Pose:
    """The planar twin: the normal mirrored at the line of sight, the rest turned along."""
    view = pose.translation_m / np.linalg.norm(pose.translation_m)
    normal = 2 * (pose.rotation[:, 2] @ view) * view - pose.rotation[:, 2]
    x = pose.rotation[:, 0] - (pose.rotation[:, 0] @ normal) * normal
    x /= np.linalg.norm(x)
    return Pose(
        np.stack([x, np.cross(normal, x), normal], axis=1), pose.translation_m
    )


def test_the_mirrored_solution_counts_as_a_flip(truth: Truth) -> None:
    estimates = exact(truth)
    for i in (7, 8, 20):
        estimates[i] = mirrored(estimates[i])
    assert pose_errors(estimates, truth, KEY, SIZE)["flips"] == 3
    away = [
        p @ Pose.from_rotvec(np.radians([0, 0, 15]), np.zeros(3))
        for p in exact(truth)
    ]
    assert pose_errors(away, truth, KEY, SIZE)["flips"] == 0, (
        "a large error that is no flip"
    )


def test_a_nearly_frontal_print_can_flip_too() -> None:
    """Tilted by 2.5 degrees, the mirrored solution is only 5 degrees off."""
    height = 0.5 * np.cos(np.radians(2.5)), -0.5 * np.sin(np.radians(2.5))
    path = {
        "kind": "static",
        "position_m": [0, height[1], height[0]],
        "target_m": [0, 0, 0],
    }
    world, _ = picture_of(
        little_scene(320, 240, frames=4, path=path, marker=[{"spec": f"{KEY}:40mm"}])
    )
    header = {
        "arfx_truth": 1,
        "world": KEY,
        "markers": {KEY: 0.04},
        "camera": world.camera.to_json(),
    }
    frontal = Truth(header, tuple(frame_truth(world, n) for n in range(4)))
    estimates = exact(frontal)
    estimates[1] = mirrored(estimates[1])
    figures = pose_errors(estimates, frontal, KEY, 0.04)
    assert figures["flips"] == 1 and 4.9 < figures["rotation_deg"]["max"] < 5.1


@pytest.mark.parametrize("late", [-0.4, 0.1, 0.5])
def test_lag_is_measured_in_frames(truth: Truth, late: float) -> None:
    poses = exact(truth)
    estimates = []
    for i in range(len(poses)):
        j = int(np.clip(np.floor(i - late), 0, len(poses) - 2))
        step = poses[j].inverse() @ poses[j + 1]
        part = i - late - j
        estimates.append(
            poses[j] @ Pose.from_rotvec(step.rotvec * part, step.translation_m * part)
        )
    assert pose_errors(estimates, truth, KEY, SIZE)["lag_frames"] == pytest.approx(
        late, abs=0.03
    )


def test_trembling_is_the_second_difference_of_the_error(truth: Truth) -> None:
    """White errors of variance s² have second differences of variance 6 s²; a standing
    offset has none.
    """
    rng = np.random.default_rng(2)
    moved = [
        Pose(p.rotation, p.translation_m + np.array([0.002, 0.001, 0]))
        for p in exact(truth)
    ]
    assert pose_errors(moved, truth, KEY, SIZE)["tremble_px"] < 0.02
    s = 2e-4
    noisy = [
        Pose(p.rotation, p.translation_m + np.array([*rng.normal(0, s, 2), 0]))
        for p in exact(truth)
    ]
    f = 160 / np.tan(np.radians(30))
    assert pose_errors(noisy, truth, KEY, SIZE)["tremble_px"] == pytest.approx(
        np.sqrt(6 * 2) * s * f / 0.5, rel=0.25
    )


def test_frames_without_an_estimate_are_left_out(truth: Truth) -> None:
    estimates: list[Pose | None] = [
        p if i % 2 else None for i, p in enumerate(exact(truth))
    ]
    assert pose_errors(estimates, truth, KEY, SIZE)["frames"] == 20
    assert pose_errors([None] * 40, truth, KEY, SIZE) == {"frames": 0}


def test_presence_tells_missed_from_invented(truth: Truth) -> None:
    facts = facts_of(truth, exact(truth))
    facts[3] = facts[3].with_(status=ABSENT, camera_from_world=None)
    facts[4] = facts[4].with_(status=INTERPOLATED)
    assert presence(facts, truth, [KEY]) == {
        "seen": 40,
        "missed": 1,
        "hidden": 0,
        "invented": 0,
        "bridged": 1,
        "unclear": 0,
    }
    from dataclasses import replace

    hidden = Truth(truth.header, tuple(
        replace(f, markers={k: replace(m, visible=0.0 if f.index < 10 else 0.7) for k, m in f.markers.items()})
        for f in truth.frames
    ))  # fmt: skip
    assert presence(facts, hidden, [KEY]) == {
        "seen": 0,
        "missed": 0,
        "hidden": 10,
        "invented": 8,
        "bridged": 1,
        "unclear": 30,
    }


def test_cuts_are_compared_frame_by_frame(truth: Truth) -> None:
    from dataclasses import replace

    cut = Truth(
        truth.header, tuple(replace(f, shot=int(f.index >= 20)) for f in truth.frames)
    )
    facts = facts_of(truth, exact(truth))
    assert cuts(facts, cut) == {"found": 0, "missed": 1, "invented": 0}
    assert cuts([f.with_(shot=int(f.index >= 20)) for f in facts], cut) == {
        "found": 1,
        "missed": 0,
        "invented": 0,
    }
    assert cuts([f.with_(shot=int(f.index >= 21)) for f in facts], cut) == {
        "found": 0,
        "missed": 1,
        "invented": 1,
    }


def test_map_errors_and_world_of_either_marker(truth: Truth) -> None:
    room = truth.frames[0].room_from_marker
    other = room[KEY].inverse() @ room["36h11:4"]
    off = Pose.from_rotvec(np.radians([0, 2.0, 0]), np.zeros(3))
    mapped = {
        KEY: Pose.identity(),
        "36h11:4": Pose(np.eye(3), np.array([0.004, 0, 0])) @ other @ off,
    }
    e = map_errors(mapped, truth, KEY)
    assert (
        e is not None
        and e["position_mm_max"] == pytest.approx(4)
        and e["rotation_deg_max"] == pytest.approx(2)
    )
    assert map_errors({KEY: Pose.identity()}, truth, KEY) is None
    swapped = {"36h11:4": Pose.identity(), KEY: other.inverse()}
    assert world_key(mapped, truth) == KEY and world_key(swapped, truth) == "36h11:4"
    figures = compare(facts_of(truth, exact(truth, "36h11:4")), swapped, truth)
    assert (
        figures["world"] == "36h11:4" and figures["arfx"]["position_mm"]["max"] < 1e-6
    )


def lit(
    azimuth: float, elevation: float, cone: float = 5.0, brightness: float = 1.0
) -> Light:
    a, e = np.radians([azimuth, elevation])
    unit = (
        float(np.cos(e) * np.cos(a)),
        float(np.cos(e) * np.sin(a)),
        float(np.sin(e)),
    )
    rgb = (0.5 * brightness,) * 3
    return Light(
        (0.3 * brightness,) * 3,
        (DirectionalLight(unit, rgb, 2.0, cone),),
        source="marker",
    )


def test_light_error_is_the_angle_to_the_true_lamp(truth: Truth) -> None:
    world = {KEY: Pose.identity()}
    e = light_errors(facts_of(truth, exact(truth), light=lit(30, 72)), world, truth)
    assert e is not None and e["direction_deg"]["median"] == pytest.approx(
        12, abs=1e-6
    )
    assert e["false"] == len(truth.frames) and e["measured"] == len(
        truth.frames
    )  # off by more than twice its cone
    wide = light_errors(
        facts_of(truth, exact(truth), light=lit(30, 72, cone=8)), world, truth
    )
    assert wide is not None and wide["false"] == 0
    assert light_errors(facts_of(truth, exact(truth)), world, truth) is None


def test_irradiance_and_bias_are_judged_on_the_markers_themselves(
    truth: Truth,
) -> None:
    world = {KEY: Pose.identity()}
    right = light_errors(
        facts_of(truth, exact(truth), light=lit(30, 60)), world, truth
    )
    bright = light_errors(
        facts_of(truth, exact(truth), light=lit(30, 60, brightness=1.1)), world, truth
    )
    assert right is not None and bright is not None
    assert right["irradiance"]["p95"] < 1e-9 and bright["irradiance"][
        "median"
    ] == pytest.approx(0.1)
    off = facts_of(truth, exact(truth), light=lit(30, 60))
    biased = light_errors(
        [f.with_(bias_rgb=(0.0, 0.0, 2 / 255 / 12.92)) for f in off], world, truth
    )
    assert biased is not None and biased["bias_grey"] == pytest.approx(2)


def test_bounds_name_what_breaks_them() -> None:
    figures = {"arfx": {"flips": 2, "corner_px": 0.2}, "presence": {"seen": 30}}
    bounds = {
        "max": {"arfx.flips": 0, "arfx.corner_px": 0.3, "map.position_mm_max": 1},
        "min": {"presence.seen": 31},
    }
    broken = exceeded(figures, bounds)
    assert len(broken) == 3
    assert (
        "arfx.flips is 2, at most 0" in broken[0]
        and "no such figure" in broken[1]
        and "at least 31" in broken[2]
    )
    said = exceeded({"static": "both"}, {"is": {"static": "camera"}})
    assert said == ["static is 'both', it should be 'camera'"]
    assert not exceeded({"static": "camera"}, {"is": {"static": "camera"}})
    assert exceeded({"arfx": {"flips": float("nan")}}, {"max": {"arfx.flips": 0}}), (
        "a figure that is no number breaks its bound"
    )


def test_specs_without_a_dictionary_are_enough_for_corners() -> None:
    assert np.allclose(np.abs(MarkerSpec("", 0, SIZE).corners_m[:, :2]), SIZE / 2)
