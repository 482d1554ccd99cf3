"""The ladder of cues: what is claimed, assumed and refused, and that every frame is as
bright as its marker shows.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.light.frames import Reading, _certain_bias, with_light
from arfx.analyse.light.observe import LightReader, SnapshotTaker
from arfx.analyse.light.patches import WHITE, Patches
from arfx.analyse.light.surroundings import EnvironmentSample
from arfx.analyse.markers.detect import Detection
from arfx.analyse.markers.search import ANY, Sighting
from arfx.analyse.params import LightParams
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED, FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.numerics import angle_between, normalise
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.rect import Rect
from tests.clips import clip_camera

KEY, MARKER = "36h11:3", MarkerSpec("36h11", 3, 0.1)
LAMP = normalise(
    np.array([-0.6, -0.5, -0.6])
)  # camera axes: left, above, behind the camera
AMBIENT, DIRECT = np.array([0.22, 0.23, 0.26]), np.array([0.6, 0.56, 0.5])


@dataclass
class Meter:
    """What the reader has taken."""

    readings: list[Reading] = field(default_factory=list)
    samples: list[EnvironmentSample] = field(default_factory=list)


@dataclass
class Clip:
    """A marker before a camera at rest (or the reverse), read without error. gain : by frame"""

    frames: int = 60
    static: str = "camera"
    tilt_deg: float = 40.0
    gain: list[float] = field(default_factory=list)
    status: dict[int, str] = field(default_factory=dict)
    bias: float = 0.004
    lamp: np.ndarray = field(default_factory=lambda: LAMP)

    def made(self) -> tuple[Analysis, Meter]:
        rng, meter, facts = np.random.default_rng(3), Meter(), []
        for k in range(self.frames):
            a = np.pi * k / self.frames
            turn = rotation_from_euler_deg(
                180 + self.tilt_deg * np.sin(2 * a + 0.4),
                self.tilt_deg * np.cos(a),
                0,
            )
            pose = Pose(turn, np.array([0.0, 0, 0.5]))
            status = self.status.get(k, MEASURED)
            facts.append(
                FrameFacts(
                    k,
                    k / 25,
                    0,
                    status,
                    None if status == ABSENT else pose,
                    pose,
                    opacity=1.0,
                )
            )
            if status != MEASURED:
                continue
            n = turn[:, 2] if self.static == "camera" else np.array([0.0, 0, 1])
            lamp = (
                self.lamp if self.static == "camera" else np.array([0.3, 0.4, 0.86])
            )
            light = (self.gain[k] if self.gain else 1.0) * (
                AMBIENT + DIRECT * max(float(n @ lamp), 0.0)
            )
            mean = np.where(WHITE[:, None], 0.88, 0.05) * light + self.bias
            noise = 0.002 * mean + 1e-4
            patches = Patches(
                mean + noise * rng.normal(size=mean.shape),
                noise**2,
                np.full(8, 50),
                np.zeros(8),
            )
            meter.readings.append(Reading(k, KEY, patches))
            if k % 10 == 0:
                cube = np.full((6, 6, 6, 3), 0.2)
                cube[0] = 0.9  # bright to the right
                meter.samples.append(
                    EnvironmentSample(k, cube, np.full(3, 0.3), np.full(3, np.inf))
                )
        return (
            Analysis(
                tuple(facts), {KEY: Pose.identity()}, self.static, anchor=MARKER
            ),
            meter,
        )

    def exact(
        self, k: int, facts: FrameFacts, normal_world: np.ndarray
    ) -> np.ndarray:
        assert facts.camera_from_world is not None
        n = facts.camera_from_world.rotation @ normal_world
        return (self.gain[k] if self.gain else 1.0) * (
            AMBIENT + DIRECT * max(float(n @ self.lamp), 0.0)
        )


def run(
    clip: Clip, params: LightParams | None = None, panorama: np.ndarray | None = None
) -> Analysis:
    analysis, meter = clip.made()
    return with_light(
        analysis, meter.readings, meter.samples, params or LightParams(), panorama
    )


UP = np.array([0.0, 0, 1])


def test_a_marker_turned_by_hand_tells_the_direction_in_every_frame() -> None:
    clip = Clip(bias=0.03)
    done = run(clip)
    report = done.summary["light"]
    assert (
        report["verdict"] == "measured"
        and report["frame"] == "camera"
        and report["rank"] == 4
    )
    for k, f in enumerate(done.facts):
        assert (
            f.light is not None
            and f.camera_from_world is not None
            and len(f.light.lights) == 1
        )
        towards = f.camera_from_world.rotation.T @ LAMP  # world axes
        assert np.degrees(angle_between(f.light.lights[0].unit, towards)) < 1.5
        assert f.light.radiance(UP) == pytest.approx(clip.exact(k, f, UP), rel=0.02)
        assert np.abs(np.array(f.bias_rgb) - clip.bias).max() < 5e-4
    assert (
        np.degrees(angle_between(np.array(report["lights"][0]["direction"]), LAMP))
        < 1.5
    )
    json.dumps(report, allow_nan=False)


def test_a_bias_that_may_be_none_is_not_added_to_what_is_drawn() -> None:
    done = run(Clip(frames=20, bias=0.001))
    low, high = np.array(done.summary["light"]["bias_ci95"]).T
    assert (
        (low < 0).all()
        and (high > 0.001).all()
        and all(f.bias_rgb == (0, 0, 0) for f in done.facts)
    )


def test_a_tint_that_one_channel_shows_by_chance_is_no_haze() -> None:
    def used(*intervals: tuple[float, float]) -> list[float]:
        bias = np.array([(low + high) / 2 for low, high in intervals])
        found = SimpleNamespace(
            bias=bias, bias_95=np.array(intervals), determined=np.ones(3, bool)
        )
        return list(_certain_bias(found))  # type: ignore[arg-type]

    none = (-0.02, 0.02)
    assert used((0.001, 0.021), none, none) == [
        0,
        0,
        0,
    ]  # of three at 95 %, one leaves out 0 every seventh time
    assert used((0.004, 0.024), none, none) == [0.014, 0, 0]
    assert used((-0.024, -0.004), (0.01, 0.03), none) == [-0.014, 0.02, 0]


def test_a_marker_at_rest_tells_no_direction_but_brightness_and_colour() -> None:
    done = run(Clip(static="marker"))
    report = done.summary["light"]
    assert (
        report["verdict"] == "refused"
        and report["source"] == "environment"
        and report["frame"] == "marker"
    )
    assert (
        "one normal" in report["reason"]
        and "surroundings" in report["reason"]
        and report["normals_seen"] == 1
    )
    assert any("--light" in notice for notice in done.notices)
    expected = AMBIENT + DIRECT * (np.array([0.3, 0.4, 0.86]) @ UP)
    for f in done.facts:
        assert f.light is not None and not f.light.lights
        assert f.light.radiance(UP) == pytest.approx(expected, rel=0.01)


def test_a_real_shadow_on_the_print_is_told_to_the_stage() -> None:
    analysis, meter = Clip().made()
    for k, key, patches in meter.readings[10:15]:
        patches.mean[[0, 2, 4, 6]] = (
            0.4 * (patches.mean[[0, 2, 4, 6]] - 0.004) + 0.004
        )  # the left half
        assert key == KEY and k in range(10, 15)
        cells = np.ones((8, 8))
        cells[:, :4] = 0.4
        meter.readings[k] = Reading(k, KEY, replace(patches, cells=cells))
    asked = []

    def place_m() -> np.ndarray:
        asked.append(1)
        return np.array([0.03, 0.0])  # on the lit half

    done = with_light(
        analysis, meter.readings, meter.samples, LightParams(), place_m=place_m
    )
    assert asked == [1]
    assert (
        done.summary["light"]["verdict"] == "measured"
        and done.summary["light"]["frames_with_real_shadow"] == 5
    )
    shadow = done.facts[12].plane_shadow
    assert (
        shadow is not None
        and shadow.box_m == (-0.05, -0.05, 0.05, 0.05)
        and np.array(shadow.ratio)
        == pytest.approx(np.array([[0.4, 1], [0.4, 1]]), abs=0.02)
    )
    assert done.facts[20].plane_shadow is None
    edge = done.summary["light"]["shadow_edge"]
    assert edge["verdict"] == "likely" and abs(abs(edge["azimuth_deg"]) - 180) < 5
    json.dumps(done.summary["light"], allow_nan=False)


def test_a_real_shadow_is_told_where_no_lamp_is_known_and_darkens_what_stands_in_it() -> (
    None
):
    seen = []
    for x in (-0.04, 0.04):
        clip = Clip(static="marker")
        analysis, meter = clip.made()
        for k in range(20, 40):
            patches = meter.readings[k].cells
            patches.mean[[0, 2, 4, 6]] *= 0.4
            cells = np.repeat(np.repeat([[0.4, 1.0]], 4, 1), 8, 0)
            meter.readings[k] = Reading(k, KEY, replace(patches, cells=cells))
        done = with_light(
            analysis,
            meter.readings,
            (),
            LightParams(),
            place_m=lambda x=x: np.array([x, 0.0]),  # type: ignore[misc]
        )
        assert done.summary["light"]["verdict"] == "refused"
        assert done.summary["light"]["frames_with_real_shadow"] == 20
        assert [f.plane_shadow is not None for f in done.facts].count(True) == 20
        lights = [f.light for f in done.facts]
        bright = [np.mean(li.radiance(UP)) for li in lights if li is not None]
        seen.append(np.mean(bright[25:35]) / np.mean(bright[5:15]))
    assert seen == pytest.approx([0.4, 1.0], abs=0.04)


def test_a_shot_that_lies_in_shadow_whole_has_a_light() -> None:
    analysis, meter = Clip().made()
    facts = [f.with_(shot=int(f.index >= 40)) for f in analysis.facts]
    for k in range(40, 60):
        cells = np.repeat(np.repeat([[0.4, 1.0]], 4, 1), 8, 0)
        meter.readings[k] = Reading(
            k, KEY, replace(meter.readings[k].cells, cells=cells)
        )
    done = with_light(
        replace(analysis, facts=tuple(facts)), meter.readings, (), LightParams()
    )
    assert all(f.light is not None for f in done.facts)


def test_nothing_that_rests_means_no_direction() -> None:
    clip = Clip()
    analysis, meter = clip.made()
    moving = with_light(
        replace(analysis, static="both"), meter.readings, meter.samples, LightParams()
    )
    assert (
        moving.summary["light"]["verdict"] == "refused"
        and "both move" in moving.summary["light"]["reason"]
    )


def test_exposure_that_jumps_is_followed_at_once_and_not_smeared() -> None:
    gain = [1.0] * 30 + [0.5] * 30
    clip = Clip(gain=gain, static="camera")
    done = run(clip)
    for k in (28, 29, 30, 31):
        f = done.facts[k]
        assert f.light is not None
        assert f.light.radiance(UP) == pytest.approx(clip.exact(k, f, UP), rel=0.04)


def test_bridged_frames_have_the_light_between_and_absent_ones_none() -> None:
    clip = Clip(status={20: INTERPOLATED, 21: INTERPOLATED, 59: ABSENT})
    done = run(clip)
    assert done.facts[59].light is None
    f = done.facts[20]
    assert f.light is not None and f.light.radiance(UP) == pytest.approx(
        clip.exact(20, f, UP), rel=0.03
    )


def test_a_given_direction_is_assumed_and_as_bright_as_the_marker() -> None:
    done = run(Clip(static="marker"), LightParams(given=(90.0, 30.0)))
    report = done.summary["light"]
    assert report["verdict"] == "assumed" and report["source"] == "given"
    light = done.facts[10].light
    assert light is not None
    assert light.lights[0].unit == pytest.approx([0, np.cos(np.radians(30)), 0.5])
    assert light.radiance(UP) == pytest.approx(
        AMBIENT + DIRECT * (np.array([0.3, 0.4, 0.86]) @ UP), rel=0.01
    )


def test_a_given_direction_rests_in_the_room_of_a_camera_at_rest() -> None:
    done = run(Clip(), LightParams(given=(0.0, 40.0)))
    first, later = done.facts[0], done.facts[20]
    towards = [
        f.camera_from_world.rotation @ f.light.lights[0].unit for f in (first, later)
    ]  # type: ignore[union-attr]
    assert towards[0] == pytest.approx(towards[1]) and first.light != later.light
    assert first.light.lights[0].unit == pytest.approx(
        [np.cos(np.radians(40)), 0, np.sin(np.radians(40))]
    )  # type: ignore[union-attr]


def test_a_stated_colour_is_kept_and_the_rest_is_ambient() -> None:
    done = run(Clip(static="marker"), LightParams(given=(0.0, 90.0, 0.3, 0.2, 0.1)))
    light = done.facts[5].light
    assert light is not None and light.lights[0].rgb == pytest.approx(
        (0.3, 0.2, 0.1), rel=0.02
    )
    assert light.radiance(UP) == pytest.approx(
        AMBIENT + DIRECT * (np.array([0.3, 0.4, 0.86]) @ UP), rel=0.01
    )


def test_a_panorama_gives_its_lamp_and_its_sky() -> None:
    dome = np.full((64, 128, 3), 0.2)
    dome[14:18, 30:34] = (
        60.0  # elevation 45 degrees, azimuth 90: 32 of 128 columns from the left is +y
    )
    done = run(Clip(static="marker"), LightParams(), dome)
    light = done.facts[0].light
    assert (
        light is not None
        and light.source == "environment file"
        and len(light.lights) == 1
    )
    assert np.degrees(angle_between(light.lights[0].unit, np.array([0, 1, 1.0]))) < 2
    assert light.radiance(UP) == pytest.approx(
        AMBIENT + DIRECT * (np.array([0.3, 0.4, 0.86]) @ UP), rel=0.01
    )


def test_no_reading_at_all_still_gives_a_light() -> None:
    analysis, _ = Clip(frames=5).made()
    done = with_light(analysis, (), (), LightParams())
    report = done.summary["light"]
    assert (
        report["verdict"] == "refused"
        and report["source"] == "ambient"
        and done.facts[0].light is not None
    )
    json.dumps(report, allow_nan=False)


def test_a_black_clip_is_finite() -> None:
    analysis, meter = Clip(frames=8).made()
    black = [
        Reading(k, key, Patches(p.mean * 0, p.variance, p.count, p.clipped + 1))
        for k, key, p in meter.readings
    ]
    meter.readings = black
    done = with_light(analysis, meter.readings, meter.samples, LightParams())
    for f in done.facts:
        assert f.light is not None and np.isfinite(f.light.radiance(UP)).all()
    assert done.summary["light"]["clipped_fraction"] == pytest.approx(1)
    json.dumps(done.summary["light"], allow_nan=False)


def test_the_meter_reads_every_frame_and_looks_around_now_and_then() -> None:
    class Grey:
        rect = Rect.of(64, 48)

        def linear(self, rect: Rect) -> np.ndarray:
            y, x = np.mgrid[rect.y0 : rect.y1, rect.x0 : rect.x1]
            return np.repeat(((x + y) / 120).astype(np.float32)[..., None], 3, -1)

        def reduced(self, width: int) -> np.ndarray:
            return self.linear(self.rect)

    seen = [
        Detection(
            KEY, np.array([[8.0, 8], [40, 9], [39, 41], [7, 40]]), 0.1, 0.6, False
        )
    ]
    whole, taker = (
        LightReader(AnalysisJob((MARKER,), clip_camera())),
        SnapshotTaker(6),
    )
    for k in range(6):
        frame = AnalysisFrame(k, k * 0.3, np.zeros((48, 64), np.uint8), Grey())
        whole.step(frame, [Sighting(k, ANY, 0.0, s) for s in seen])
        taker.step(frame)
    assert len(whole.rows) == 6 and len(taker.rows) == 3  # looks every .5 s


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"given": (10.0,)}, "AZ,EL"), ({"given": (10.0, 100.0)}, "elevation"),
        ({"given": (0.0, 45.0, -1.0, 1.0, 1.0)}, "colour"), ({"ink": 0.9}, "below light.paper"),
    ],
)  # fmt: skip
def test_settings_out_of_bounds_are_named(changes: dict, says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        LightParams(**changes)


def test_light_on_the_command_line() -> None:
    assert LightParams(given="45,60").given == (45, 60)  # type: ignore[arg-type]
    assert LightParams(given="45, 60, 1, .9, .8").given == (45, 60, 1, 0.9, 0.8)  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="AZ,EL"):
        LightParams(given="45")  # type: ignore[arg-type]
