"""Whole-clip poses against the truth: no flips, no lag, rock-steady at rest, nothing across
a cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from arfx.analyse.job import Analysis
from arfx.analyse.markers.detect import Record
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose import smooth
from arfx.analyse.pose.chain import Chain
from arfx.analyse.pose.planar import Observed
from arfx.analyse.pose.sightings import Sightings
from arfx.analyse.pose.smooth import GROUP, LEAST, SHAKE, SIDEWAYS
from arfx.analyse.pose.solve import solve_poses
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_angle_rad
from tests.unit.analyse.synthetic import THUMBNAIL, camera, records, tilted

M = MarkerSpec("36h11", 3, 0.16)
CAM = camera()
N = 100
T = np.arange(N) / 30
_SHAKE, _SIDEWAYS = GROUP.index(SHAKE), GROUP.index(SIDEWAYS)


def away(side_px: float) -> float:
    return CAM.fx * M.size_m / side_px


def analysed(rec: Sequence[Record], cam: Camera = CAM, **params: float) -> Analysis:
    return solve_poses(
        rec, [M], cam, AnalyseParams(static="camera", **params), None, []
    )  # type: ignore[arg-type]


def pose_errors(
    facts: Sequence[FrameFacts], truth: Sequence[Pose], raw: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Degrees and millimetres per frame."""
    got = [f.raw_camera_from_world if raw else f.camera_from_world for f in facts]
    deg = [
        np.degrees(rotation_angle_rad(p, q))
        for p, q in zip(got, truth, strict=True)
        if p is not None
    ]
    mm = [
        1e3 * np.linalg.norm(p.translation_m - q.translation_m)
        for p, q in zip(got, truth, strict=True)
        if p is not None
    ]
    return np.array(deg), np.array(mm)


def rms(v: np.ndarray) -> float:
    return float(np.sqrt((v * v).mean()))


def swing(a: float, turn: float, side: float, up: float) -> Pose:
    """A marker waved about, angles and places as sines of time; turn, side, up : rad/s."""
    tilt = [0.4 + 0.3 * np.sin(turn * a), 0.3 * np.cos(turn * a), 0]
    return tilted(tilt, [0.2 * np.sin(side * a), 0.1 * np.cos(up * a), away(80)])


def start_late(a: float) -> Pose:
    s = np.sin(9 * max(a - 1.7, 0))
    return tilted([0.4 + 0.4 * s, 0.1, 0], [0.25 * s, 0, away(80)])


MOVING = {
    "swing": [swing(a, 6.3, 4, 5) for a in T],
    "fast": [swing(a, 19, 12, 15) for a in T],
    "roll": [tilted([0.5, 0.1, 1.5 * a], [-0.3 + 0.1 * a, 0, away(80)]) for a in T],
    "rest, then fast": [start_late(a) for a in T],
}


@pytest.mark.parametrize("name", MOVING)
def test_moving_markers_come_out_truer_than_single_frames_and_in_time(
    name: str,
) -> None:
    truth = MOVING[name]
    facts = analysed(records(CAM, truth, T, {M: Pose.identity()}, 0.05)).facts
    deg_raw, mm_raw = pose_errors(facts, truth, raw=True)
    deg, mm = pose_errors(facts, truth, raw=False)
    assert rms(deg) < rms(deg_raw) and rms(mm) < rms(mm_raw)
    point = np.array([0.05, 0.05, 0.1])
    want = np.array([p.apply(point) for p in truth])
    got = np.array(
        [
            f.camera_from_world.apply(point)
            for f in facts
            if f.camera_from_world is not None
        ]
    )
    speed = np.gradient(want, axis=0)
    lag_frames = -((got - want) * speed).sum() / (speed**2).sum()
    assert abs(lag_frames) < 0.1
    assert (
        np.abs(got - want).max(0) < 0.02 * np.ptp(want, axis=0).max()
    ).all()  # peaks are not cut off


def shaken(seed: int) -> list[Pose]:
    """A camera that a hand turns about itself before a marker at rest, as sums of sines
    around 4 Hz, .2 degrees.
    """
    rng = np.random.default_rng(seed)
    rate, phase = (
        8 * np.pi * rng.uniform(0.4, 1.6, (2, 6)),
        rng.uniform(0, 2 * np.pi, (2, 6)),
    )
    turn = [np.radians(0.2) * np.sin(rate * t + phase).sum(1) / np.sqrt(3) for t in T]
    return [
        Pose.from_rotvec(np.append(v, 0), np.zeros(3))
        @ tilted([0.5, 0.2, 0], [0.1, 0.05, away(80)])
        for v in turn
    ]


@pytest.fixture
def densities(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Of the shots that are smoothed (7,) of the axes, medians, one of each attempt."""
    found: list[np.ndarray] = []
    over_time = smooth._density_over_time

    def kept(chain: Chain, shot: np.ndarray) -> np.ndarray:
        density = over_time(chain, shot)
        found.append(np.median(density, axis=0))
        return density

    monkeypatch.setattr(smooth, "_density_over_time", kept)
    return found


@pytest.mark.parametrize("noise_px", [0.03, 0.15])
def test_a_hands_shake_is_told_from_where_the_marker_is(
    noise_px: float, densities: list[np.ndarray]
) -> None:
    """Its tilt tells turning ten times worse: smoothed on its own it keeps three quarters
    of the single frames' error.
    """
    errors = []
    for seed in range(3):
        truth = shaken(seed)
        a = analysed(records(CAM, truth, T, {M: Pose.identity()}, noise_px, seed))
        errors.append(
            [rms(pose_errors(a.facts, truth, raw)[0]) for raw in (True, False)]
        )
        assert any(q[_SHAKE] > 10 * q[_SIDEWAYS] for q in densities)
        densities.clear()
    single, smoothed = np.median(errors, axis=0)
    assert smoothed < 0.5 * single


def test_a_marker_that_is_carried_is_no_shake(densities: list[np.ndarray]) -> None:
    truth = [
        tilted(
            [0.5, 0.2, 0],
            [0.1 + 0.02 * np.sin(9 * t), 0.05 + 0.02 * np.cos(7 * t), away(80)],
        )
        for t in T
    ]
    a = analysed(records(CAM, truth, T, {M: Pose.identity()}, 0.05))
    assert [q[_SHAKE] for q in densities] == pytest.approx([LEAST] * len(densities))
    assert (
        rms(pose_errors(a.facts, truth, raw=False)[0])
        < rms(pose_errors(a.facts, truth, raw=True)[0]) / 4
    )


def test_shake_is_the_camera_turned_about_itself() -> None:
    from arfx.analyse.pose.smooth import _position, _shake

    centre = np.array([0.02, 0.01, 0.0])
    pose = tilted([0.2, 0.1, 0], [0.3, -0.2, 1.1])

    def axes(p: Pose) -> np.ndarray:
        turn = (p @ pose.inverse()).rotvec
        return np.concatenate(
            [turn, _position(p.rotation[None], p.translation_m[None], centre)[1][0]]
        )

    step = 1e-5
    moved = (
        np.stack(
            [
                axes(Pose.from_rotvec(step * e, np.zeros(3)) @ pose) - axes(pose)
                for e in np.eye(3)[:2]
            ],
            -1,
        )
        / step
    )
    place = _position(pose.rotation[None], pose.translation_m[None], centre)[1]
    np.testing.assert_allclose(_shake(place)[0], moved, atol=1e-4)


def test_rest_is_smoothed_as_rest_in_a_clip_that_also_moves() -> None:
    n, still = 160, 100
    times = np.arange(n) / 30
    truth = [start_late(max(t - times[still], 0) + 1.7) for t in times]
    facts = analysed(records(CAM, truth, times, {M: Pose.identity()}, 0.1)).facts
    part = slice(10, still - 30)
    deg_raw, _ = pose_errors(facts[part], truth[part], raw=True)
    deg, _ = pose_errors(facts[part], truth[part], raw=False)
    assert rms(deg) < rms(deg_raw) / 3


def test_links_between_turned_frames_are_the_derivative() -> None:
    from arfx.analyse.pose.smooth import _apply_step, _Path

    poses = [
        tilted([0.2, 0.1, 0], [0.1, 0, 1.0]),
        tilted([0.45, -0.1, 0.2], [0.15, 0.05, 1.1]),
    ]
    rotation, translation = (
        np.stack([p.rotation for p in poses]),
        np.stack([p.translation_m for p in poses]),
    )
    centre, dt = np.array([0.02, 0.01, 0.0]), np.array([0.04])
    rng = np.random.default_rng(0)
    step = rng.normal(0, 1e-4, (2, 6))

    blank = [np.zeros((2, 4, *shape)) for shape in ((3,), (2,), (2, 2), ())]

    def shift(r: np.ndarray, t: np.ndarray) -> np.ndarray:
        here = _Path(r, t, Observed(*blank), dt, centre).chain
        return here.offset[0, :6]  # Log of the turn and the change of place

    links = _Path(rotation, translation, Observed(*blank), dt, centre).chain.links[
        0, :6
    ]
    predicted = (
        shift(rotation, translation)
        + links[:, :6] @ step[0]
        + links[:, 12:18] @ step[1]
    )
    error = np.abs(
        shift(*_apply_step(rotation, translation, step, centre)) - predicted
    ).max()
    assert (
        error < 0.02 * np.abs(step).max()
    )  # the series is cut after the first order in the turn, here .4 rad


@pytest.mark.parametrize("noise_px", [0.05, 0.3])
def test_marker_at_rest_stands_still(noise_px: float) -> None:
    truth = [tilted([0.5, 0.1, 0], [0.1, 0.05, away(80)])] * N
    facts = analysed(records(CAM, truth, T, {M: Pose.identity()}, noise_px)).facts
    deg_raw, mm_raw = pose_errors(facts, truth, raw=True)
    deg, mm = pose_errors(facts, truth, raw=False)
    assert rms(deg) < rms(deg_raw) / 4 and rms(mm) < rms(mm_raw) / 4
    point = np.array([0.05, 0.05, 0.1])
    trembling = [np.diff([CAM.project(p.apply(point)) for p in path], 2, axis=0).std() for path in (
        [f.raw_camera_from_world for f in facts], [f.camera_from_world for f in facts])]  # type: ignore[union-attr]  # fmt: skip
    assert trembling[1] < trembling[0] / 30


@pytest.mark.parametrize("tilt", [0.0, 0.09])
def test_frontal_40_px_marker_never_flips(tilt: float) -> None:
    truth = [tilted([tilt, tilt / 3, 0], [0.1, 0.05, away(40)])] * N
    seen = records(CAM, truth, T, {M: Pose.identity()}, 0.3)
    a, alone = analysed(seen), Sightings(seen, (M,), CAM).prints.poses
    best = [
        np.degrees(rotation_angle_rad(Pose(turn, shift), truth[0]))
        for turn, shift in zip(
            alone.rotation[:, 0, 0], alone.translation[:, 0, 0], strict=True
        )
    ]
    assert (
        sum(b > 10 for b in best) > N / 10
    )  # the clip is as hard as it is meant to be
    deg, _ = pose_errors(a.facts, truth, raw=False)
    assert deg.max() < 5.0
    assert a.summary["flips_resolved"] > 0


def test_covariance_tells_the_error() -> None:
    truth = MOVING["swing"]
    squares = []
    for seed in range(3):
        for f, p in zip(
            analysed(records(CAM, truth, T, {M: Pose.identity()}, 0.1, seed)).facts,
            truth,
            strict=True,
        ):
            assert f.camera_from_world is not None and f.pose_covariance is not None
            error = f.camera_from_world @ p.inverse()
            e = np.concatenate([error.rotvec, error.translation_m])
            scale = 1 / np.sqrt(np.diag(f.pose_covariance))
            c = f.pose_covariance * scale[:, None] * scale
            squares.append(float((e * scale) @ np.linalg.solve(c, e * scale)))
    assert (
        2.0 < np.median(squares) < 12.0
    )  # chi squared with six degrees of freedom has median 5.3


def test_cut_is_not_smoothed_over_and_times_may_be_uneven() -> None:
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.01, 0.06, N))
    truth = [
        tilted([0.5, 0, 0.3 * t], [0.1 * t - 0.1, 0, away(80)]) for t in times[:50]
    ]
    truth += [
        tilted([-0.4, 0.2, 1.0], [0.05, 0.1 * np.sin(t), away(60)])
        for t in times[50:]
    ]
    rec = records(CAM, truth, times, {M: Pose.identity()}, 0.05)
    other = rng.integers(0, 256, THUMBNAIL.shape, np.uint8)
    rec[50:] = [r._replace(thumbnail=other) for r in rec[50:]]
    a = analysed(rec)
    assert (
        a.summary["cuts"] == [50] and [f.shot for f in a.facts] == [0] * 50 + [1] * 50
    )
    deg, mm = pose_errors(a.facts, truth, raw=False)
    assert deg.max() < 1.5 and mm.max() < 5 and min(f.opacity for f in a.facts) == 1.0


def test_gaps_are_bridged_longer_ones_fade_and_strength_zero_changes_nothing() -> (
    None
):
    truth: list[Pose | None] = list(MOVING["swing"])
    for k in (*range(30, 36), *range(60, 85)):
        truth[k] = None
    rec = records(CAM, truth, T, {M: Pose.identity()}, 0.05)
    a = analysed(rec)
    status = [f.status for f in a.facts]
    assert status[29:37] == ["measured", *["interpolated"] * 6, "measured"] and set(
        status[60:85]
    ) == {"absent"}
    bridged = [
        np.degrees(
            rotation_angle_rad(a.facts[k].camera_from_world, MOVING["swing"][k])
        )
        for k in range(30, 36)
    ]  # type: ignore[arg-type]
    assert max(bridged) < 4.0
    opacity = np.array([f.opacity for f in a.facts])
    assert (
        (opacity[:54] == 1).all()
        and (np.diff(opacity[55:61]) < 0).all()
        and (np.diff(opacity[84:90]) > 0).all()
    )
    assert opacity[90:].min() == 1 and all(
        f.camera_from_world is None for f in a.facts[60:85]
    )
    plain = analysed(rec, smoothing=0.0).facts
    assert all(
        f.camera_from_world == f.raw_camera_from_world
        for f in plain
        if f.status == "measured"
    )


@pytest.mark.filterwarnings("error")
def test_almost_no_smoothing_is_silent() -> None:
    rec = records(CAM, list(MOVING["swing"])[:8], T[:8], {M: Pose.identity()}, 0.05)
    assert all(
        f.camera_from_world is not None for f in analysed(rec, smoothing=1e-320).facts
    )


@pytest.mark.parametrize("gap_s", [30.0, 1e3, 1e7])
def test_gaps_of_minutes_and_months_between_frames_leave_poses_as_true(
    gap_s: float,
) -> None:
    times = T.copy()
    for k in range(1, N, 7):
        times[k:] += gap_s
    truth = MOVING["swing"]
    got = analysed(records(CAM, truth, times, {M: Pose.identity()}, 0.2))
    turn, shift = pose_errors(got.facts, truth, raw=False)
    before_turn, before_shift = pose_errors(got.facts, truth, raw=True)
    assert (
        len(turn) == N
        and rms(turn) < 1.2 * rms(before_turn)
        and rms(shift) < 1.2 * rms(before_shift)
    )


def test_a_long_shot_is_smoothed_piece_by_piece(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So that memory does not grow with it; no seam stands out of the noise."""
    times = np.arange(500) / 30
    truth = [swing(a, 2.0, 1.5, 1.0) for a in times]
    rec = records(CAM, truth, times, {M: Pose.identity()}, 0.1)
    whole = analysed(rec).facts
    sizes = []
    one_piece = smooth._smooth_piece

    def counted(rotation: np.ndarray, *more: Any) -> Any:
        sizes.append(len(rotation))
        return one_piece(rotation, *more)

    monkeypatch.setattr(smooth, "_smooth_piece", counted)
    monkeypatch.setattr(smooth, "_PIECE", 250)
    monkeypatch.setattr(smooth, "_BESIDE", 100)
    monkeypatch.setattr(smooth, "_FADE", 50)
    pieces = analysed(rec).facts
    assert sizes == [350, 350]
    found, again, true = (
        np.array([p.translation_m for p in poses if p is not None])
        for poses in (
            [f.camera_from_world for f in whole],
            [f.camera_from_world for f in pieces],
            truth,
        )
    )
    error = rms(found - true)
    seams = np.diff(again - found, axis=0)[249]
    assert np.abs(seams).max() < error and rms(again - true) < 1.2 * error


def test_a_gap_longer_than_a_piece_is_bridged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, frames in (("_PIECE", 200), ("_BESIDE", 60), ("_FADE", 30)):
        monkeypatch.setattr(smooth, name, frames)
    n = 1000
    points = np.tile(M.corners_m, (n, 1, 1))
    turn = np.tile(np.diag([1.0, -1, -1]), (n, 1, 1))
    shift = np.tile([0, 0, 0.5], (n, 1))
    ideal = points[..., :2] * [1, -1] / 0.5
    weight = np.full((n, 4), 100.0)
    weight[100:900] = 0
    seen = Observed(points, ideal, np.tile(800 * np.eye(2), (n, 4, 1, 1)), weight)
    times = np.arange(n) / 30
    rotation, translation, covariance = smooth.smooth_poses(turn, shift, seen, times)
    np.testing.assert_allclose(translation, shift, atol=1e-6)
    np.testing.assert_allclose(rotation, turn, atol=1e-6)
    spread = np.sqrt(covariance[:, 0, 0])
    assert spread[500] == pytest.approx(1.0) and spread[50] < 0.01
    assert np.abs(np.diff(spread)).max() < 0.1, "it is known less and less"
