"""Marker map, choice of path, cuts, presence, background, visibility and the facts file."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.detect import Detection, Record
from arfx.analyse.markers.search import ANY, Sighting
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose.at_rest import (
    BackgroundFlow,
    FlowSample,
    decide_static,
    epipolar_distance,
)
from arfx.analyse.pose.marker_map import MAX_FRAMES, arrays
from arfx.analyse.pose.path import choose_path, move_costs
from arfx.analyse.pose.shots import dissimilarity, find_cuts, thumbnail, unlikeness
from arfx.analyse.pose.solve import solve_poses
from arfx.analyse.pose.visibility import (
    jitter_px,
    opacities,
    visible_intervals,
    with_model,
    without_flickers,
)
from arfx.core.facts import FrameFacts, read_facts, write_facts
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_angle_rad, rotation_from_rotvec
from arfx.core.rect import EMPTY
from arfx.errors import InputError
from tests.scenes import scene
from tests.unit.analyse.synthetic import background, camera, records, tilted

CAM = camera(640, 480, 800.0)
A, B, C = (MarkerSpec("36h11", i, 0.1) for i in (1, 2, 3))
LAYOUT = {
    A: Pose.identity(),
    B: Pose(
        rotation_from_rotvec(np.array([0.1, 0.5, 0.2])), np.array([0.25, 0.03, 0.05])
    ),
    C: Pose(
        rotation_from_rotvec(np.array([-0.4, 0.1, -0.3])), np.array([0.1, 0.2, -0.04])
    ),
}
N = 60
T = np.arange(N) / 30
ORBIT = [
    tilted([0.4 * np.sin(a), 0.4 * np.cos(a), 0.1 * a], [-0.1 + 0.05 * a, 0.05, 1.4])
    for a in T * 3
]
PARAMS = AnalyseParams(static="camera")
# a print somewhere outside of the picture
FAR = Sighting(0, ANY, 0.0, Detection("far", np.full((4, 2), 9e3), 0.1, 0.6, False))


def test_unknown_layout_is_mapped_from_pairs_seen_together() -> None:
    def visible(k: int, m: MarkerSpec) -> bool:
        return {A: k < 25 or k > 50, B: 10 < k < 45, C: k >= 35}[m]

    rec = records(CAM, ORBIT, T, LAYOUT, 0.1, visible=visible)
    a = solve_poses(rec, [A, B, C], CAM, PARAMS, None, [])
    for m, truth in LAYOUT.items():
        got = a.world_from_marker[m.key]
        assert np.linalg.norm(got.translation_m - truth.translation_m) < 2e-3
        assert np.degrees(rotation_angle_rad(got, truth)) < 0.5
    assert a.summary["frames_measured"] == N and a.summary["map"]["condition"] < 1e9
    off = [
        np.linalg.norm(f.camera_from_world.translation_m - p.translation_m)
        for f, p in zip(a.facts, ORBIT, strict=True)
    ]  # type: ignore[union-attr]
    assert max(off) < 0.01  # also while the world's own marker is out of sight


def test_marker_never_seen_with_others_is_left_out_and_named() -> None:
    rec = records(
        CAM, ORBIT, T, LAYOUT, 0.1, visible=lambda k, m: (m is C) == (k > 30)
    )
    a = solve_poses(rec, [A, B, C], CAM, PARAMS, None, [])
    assert set(a.world_from_marker) == {A.key, B.key} and any(
        C.key in n for n in a.notices
    )
    assert {f.status for f in a.facts[31:]} == {"absent"}


def test_a_marker_seen_with_others_in_one_frame_of_a_long_clip_is_mapped() -> None:
    """No frame that is taken from the clip evenly may be that one."""
    n = 2 * MAX_FRAMES + 20
    path = [ORBIT[k % N] for k in range(n)]
    taken = np.linspace(0, n - 1, MAX_FRAMES).round()
    rare = next(k for k in range(100, n) if k not in taken)
    seen = records(
        CAM,
        path,
        np.arange(n) / 30,
        LAYOUT,
        0.1,
        visible=lambda k, m: m is not C or k == rare,
    )
    got = solve_poses(seen, [A, B, C], CAM, PARAMS, None, []).world_from_marker[C.key]
    assert np.linalg.norm(got.translation_m - LAYOUT[C].translation_m) < 5e-3


def test_given_map_is_taken_and_a_contradicting_print_is_not_used() -> None:
    rec = records(CAM, ORBIT, T, LAYOUT, 0.05)
    wrong = rec[20].detections[2]
    seen = (
        *rec[20].detections[:2],
        Detection(
            wrong.key,
            wrong.corners_px + np.array([90, -60]),
            wrong.sigma_px,
            0.8,
            False,
        ),
    )
    rec[20] = Record(20, rec[20].time_s, seen, rec[20].thumbnail)
    a = solve_poses(
        rec, [A, B, C], CAM, PARAMS, {m.key: p for m, p in LAYOUT.items()}, []
    )
    assert a.summary["map"]["given"] and a.summary["dropped"] == 1
    assert (
        np.degrees(rotation_angle_rad(a.facts[20].camera_from_world, ORBIT[20])) < 0.3
    )  # type: ignore[arg-type]


def test_a_camera_that_does_not_fit_the_clip_is_a_notice() -> None:
    near = [replace(pose, translation_m=np.array([0, 0, 0.3])) for pose in ORBIT]
    rec = records(CAM, near, T, {A: LAYOUT[A]}, 0.1)
    squashed = replace(CAM, matrix=np.diag([1, 1.4, 1]) @ CAM.matrix)
    told = [
        [
            n
            for n in solve_poses(rec, [A], c, PARAMS, None, []).notices
            if "calibration" in n
        ]
        for c in (CAM, squashed)
    ]
    assert told[0] == [] and len(told[1]) == 1


def test_what_corners_are_misplaced_by_is_not_averaged_away() -> None:
    """A hand over a side moves the corners of many frames alike; beside these it may lie
    there untold, in gaps as well.
    """

    def stated_mm(first: int, last: int) -> np.ndarray:
        rec = records(
            CAM,
            [ORBIT[0]] * N,
            T,
            {A: LAYOUT[A]},
            0.05,
            visible=lambda k, m: k not in (30, 31),
        )
        for k in {*range(first, last)} - {30, 31}:
            rec[k] = rec[k]._replace(
                detections=(rec[k].detections[0]._replace(misplaced_px=0.4),)
            )
        facts = solve_poses(rec, [A], CAM, PARAMS, None, []).facts
        return np.array(
            [1e3 * np.sqrt(np.trace(f.pose_covariance[3:, 3:])) for f in facts]
        )  # type: ignore[index]

    clear, some, many = stated_mm(0, 0), stated_mm(29, 33), stated_mm(20, 40)
    assert (many[20:40] > 0.8 * some[29]).all(), (
        "twenty frames that are off alike say no more than a few"
    )
    assert (many[[30, 31]] > 10 * clear[[30, 31]]).all(), "nor does a bridged one"
    assert (
        many[19] > 3 * clear[19]
        and np.allclose(many[:10], clear[:10], rtol=0.1)
        and np.allclose(many[50:], clear[50:], rtol=0.1)
    )


def chosen(
    poses: Sequence[Sequence[Pose]],
    costs: Sequence[Sequence[float]],
    times_s: Sequence[float] | np.ndarray,
) -> list[int]:
    """Which of each frame's poses, all frames of one shot."""
    count = [*map(len, poses)]
    index = np.repeat(np.arange(len(poses)), count)
    flat = arrays([p for frame in poses for p in frame])
    shot = np.zeros(len(poses))
    path = choose_path(*flat, np.concatenate(costs), index, np.array(times_s), shot)
    return [i - sum(count[:k]) for k, i in enumerate(path)]


def test_path_is_the_cheapest_of_all() -> None:
    rng = np.random.default_rng(5)
    poses = [
        [
            tilted(rng.normal(0, 0.4, 3), [0, 0, 1 + 0.1 * rng.normal()])
            for _ in range(2 + k % 2)
        ]
        for k in range(6)
    ]
    costs = [list(rng.uniform(0, 30, len(p))) for p in poses]
    times = np.cumsum(rng.uniform(0.01, 0.1, 6)).tolist()

    def price(path: tuple[int, ...]) -> float:
        total = sum(costs[k][i] for k, i in enumerate(path))
        for k in range(5):
            a, b = poses[k][path[k]], poses[k + 1][path[k + 1]]
            arrays = (
                v[None]
                for v in (a.rotation, a.translation_m, b.rotation, b.translation_m)
            )
            total += move_costs(*arrays, times[k + 1] - times[k])[0]
        return float(total)

    best = min(itertools.product(*(range(len(p)) for p in poses)), key=price)
    assert tuple(chosen(poses, costs, times)) == best


def test_path_stays_in_one_valley_against_small_misfits() -> None:
    rng = np.random.default_rng(0)
    this, other = tilted([0.3, 0, 0], [0, 0, 1]), tilted([-0.3, 0, 0], [0, 0, 1])
    costs = [[1.0, float(rng.choice([0.2, 1.5]))] for _ in range(20)]
    costs[0] = [0.0, 60.0]
    assert chosen([[this, other]] * 20, costs, T[:20]) == [0] * 20
    costs[1:] = [[1.0, 1.5]] * 9 + [
        [60.0, 0.0]
    ] * 10  # a real change, with evidence, is followed
    assert chosen([[this, other]] * 20, costs, T[:20]) == [0] * 10 + [1] * 10


def test_cut_is_found_flash_and_pan_are_not() -> None:
    one, two = (
        np.clip(background(320, 180, s) * 255, 0, 255).astype(np.uint8)
        for s in (1, 2)
    )
    shift = [np.roll(one, 2 * k, 1) for k in range(10)]
    flash = np.clip(shift[4].astype(int) * 2 + 40, 0, 255).astype(np.uint8)
    white = np.full_like(one, 255)

    def cuts(clip: list[np.ndarray], followed: bool = False) -> list[int]:
        thumbnails = [thumbnail(f) for f in clip]
        return find_cuts(
            unlikeness(thumbnails, 1),
            unlikeness(thumbnails, 2),
            [followed] * len(clip),
        )

    assert cuts([*shift, *[two] * 5]) == [10]
    assert cuts([*shift, *[two] * 5], followed=True) == []
    assert cuts([*shift[:4], flash, *shift[5:]]) == []
    assert cuts([*shift[:4], white, *shift[5:]]) == []
    assert cuts([np.roll(one, 60 * k, 1) for k in range(12)]) == []  # a whip pan
    assert dissimilarity(one, np.clip(one * 0.5 + 30, 0, 255).astype(np.uint8)) < 0.02


def test_the_midst_of_a_quick_move_is_no_cut() -> None:
    # as measured: a camera swung about, in a second
    before = [
        0.0,
        0.48,
        0.44,
        0.2,
        0.1,
        0.4,
        0.55,
        0.57,
        0.44,
        0.17,
        0.04,
        0.03,
        0.04,
        0.12,
    ]
    last = [
        0.0,
        0.0,
        0.73,
        0.58,
        0.3,
        0.52,
        0.68,
        0.74,
        0.77,
        0.69,
        0.29,
        0.09,
        0.09,
        0.23,
    ]
    assert find_cuts(before, last, [False] * len(before)) == []
    before[7], last[8] = 1.0, 1.0  # the same with a cut in it
    before[6] = before[8] = 0.3
    assert find_cuts(before, last, [False] * len(before)) == [7]
    still = [0.0, *[0.01] * 12]
    assert find_cuts(
        [*still[:5], 0.9, 0.8, *still[7:]],
        [*still[:5], 0.9, 0.7, 0.8, *still[8:]],
        [False] * 13,
    ) == [5, 6]


def test_a_flicker_is_no_presence() -> None:
    measured = np.zeros(40, bool)
    measured[[0, 12, 13, 25, 26, 27, 39]] = True
    shot = np.zeros(40, int)
    every = visible_intervals(measured, shot, np.arange(40) / 10, 0.3)
    assert without_flickers(every, measured, shot) == [(0, 1), (25, 28), (39, 40)]
    shot[12:] = 1  # now it begins a shot: what came before is unknown
    assert (12, 14) in without_flickers(
        visible_intervals(measured, shot, np.arange(40) / 10, 0.3), measured, shot
    )


def test_presence_and_fades() -> None:
    measured = np.array([1, 1, 0, 1, 0, 0, 0, 0, 1, 1, 1, 1], bool)
    shot = np.zeros(12, int)
    times = np.arange(12) * 0.1
    assert visible_intervals(measured, shot, times, 0.25) == [(0, 4), (8, 12)]
    assert visible_intervals(measured, shot, times, 0.6) == [(0, 12)]
    shot[3:] = 1
    assert visible_intervals(measured, shot, times, 0.6) == [(0, 2), (3, 12)]
    o = opacities([(0, 4), (8, 12)], np.zeros(12, int), 0.25 * times)
    np.testing.assert_allclose(o * 6, [4, 3, 2, 1, 0, 0, 0, 0, 1, 2, 3, 4])
    assert (opacities([(0, 2), (3, 12)], shot, 0.25 * times)[3:] == 1).all()
    few = opacities([(0, 4), (8, 12)], np.zeros(12, int), times)
    np.testing.assert_allclose(few[:4], [1, 1, 1, 2 / 3])  # .15 s, whatever the rate


def static_clip(kind: str) -> str:
    """A textured wall and a marker before it; kind says what stands still."""
    wall, wall_m = (
        background(900, 700, 3) * 255,
        1.25 if kind == "marker, orbited" else 2.0,
    )
    poses, flow = {}, BackgroundFlow(30)
    h0 = np.array(
        [[900 / 2.4, 0, 450], [0, 900 / 2.4, 350], [0, 0, 1.0]]
    )  # metres on the wall to texture px
    for k in range(40):
        a = k / 30
        turn = rotation_from_rotvec(
            np.array([0.05 * np.sin(2 * a), 0.08 * np.sin(3 * a), 0.02 * a])
        )
        moving = Pose(
            turn, np.array([0.1 * np.sin(2 * a), 0.05 * a, 0.05 * np.sin(a)])
        )
        camera_from_room = Pose.identity() if kind == "camera" else moving
        if (
            kind == "marker, orbited"
        ):  # by 7 degrees in a third of a second, .14 m aside
            turn = rotation_from_rotvec(np.array([0.0, 0.36 * (a - 0.6), 0.0]))
            camera_from_room = Pose(
                turn, np.array([0, 0, 1.2]) - turn @ np.array([0, 0, 1.2])
            )
        room_from_marker = tilted([0.3, 0.1, 0], [0.1, 0.05, 1.2])
        if not kind.startswith("marker"):
            room_from_marker = tilted(
                [0.3 + 0.5 * np.sin(4 * a), 0.1, 0],
                [0.1 + 0.2 * np.sin(5 * a), 0.05, 1.2],
            )
        poses[k] = camera_from_room @ room_from_marker
        plane = np.column_stack(
            [
                camera_from_room.rotation[:, :2],
                camera_from_room.apply(np.array([0, 0, wall_m])),
            ]
        )
        image = cv2.warpPerspective(
            wall,
            CAM.matrix @ plane @ np.linalg.inv(h0),
            (640, 480),
            borderMode=cv2.BORDER_REFLECT,
        )
        luma = np.clip(image, 0, 255).astype(np.uint8)
        flow.step(AnalysisFrame(k, a, luma), [FAR])
    assert flow.rows
    return decide_static(flow.rows, poses, CAM)


@pytest.mark.parametrize("kind", ["camera", "marker", "marker, orbited", "both"])
def test_static_is_told_from_the_background(kind: str) -> None:
    assert static_clip(kind) == kind.split(",")[0]


def test_epipolar_distance_is_zero_on_points_of_a_rigid_world() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.3, -0.3, 1.5], [0.3, 0.3, 6], (50, 3))
    move = Pose(
        rotation_from_rotvec(np.array([0.03, -0.02, 0.1])),
        np.array([0.08, 0.01, 0.02]),
    )
    a, b = CAM.project(points), CAM.project(move.apply(points))
    assert (
        800 * epipolar_distance(CAM.normalised(a), CAM.normalised(b), move, 0.5).max()
        < 1e-6
    )
    assert (
        800
        * np.median(
            epipolar_distance(
                CAM.normalised(a), CAM.normalised(b + np.array([0, 12])), move, 0.5
            )
        )
        > 5
    )
    assert np.isinf(
        epipolar_distance(np.full((1, 2), np.nan), np.zeros((1, 2)), move, 0.5)
    ).all()


def test_a_slow_drift_is_no_rest() -> None:
    at = np.random.default_rng(0).uniform(50, 400, (20, 2))
    poses = {0: tilted([0, 0, 0], [0, 0, 1.0]), 1: tilted([0, 0, 0], [0, 0, 1.0])}
    for drift, expected in ((0.1, "camera"), (1.0, "both")):
        sample = FlowSample(0, 1, 4, at, at + np.array([4 * drift, 0.0]))
        assert decide_static([sample], poses, CAM) == expected


def test_no_background_means_both() -> None:
    assert decide_static([], {}, CAM) == "both"


def test_model_box_covers_the_model_and_only_that() -> None:
    s = scene()
    inside = FrameFacts(
        0, 0.0, camera_from_world=tilted([0, 0, 0], [0, 0, 4.0]), opacity=1.0
    )
    behind = inside.with_(camera_from_world=tilted([0, 0, 0], [0, 0, -4.0]))
    aside = inside.with_(camera_from_world=tilted([0, 0, 0], [40, 0, 4.0]))
    boxes = with_model(
        [inside, behind, aside, inside.with_(camera_from_world=None)], s
    )
    px = s.camera.project(inside.camera_from_world.apply(s.model_points_m))  # type: ignore[union-attr]
    box = boxes[0].model_box
    assert box.x0 <= max(px[:, 0].min(), 0) and box.x1 >= min(
        px[:, 0].max(), s.camera.width - 1
    )
    assert box.x0 >= px[:, 0].min() - 3 and box.x1 <= px[:, 0].max() + 4
    z = inside.camera_from_world.apply(s.model_points_m)[:, 2]  # type: ignore[union-attr]
    assert boxes[0].depth_range_m == (pytest.approx(z.min()), pytest.approx(z.max()))
    assert [b.model_box for b in boxes[1:]] == [EMPTY] * 3


def test_jitter_is_the_second_difference_and_skips_breaks() -> None:
    place = [tilted([0, 0, 0], [x, 0, 1.0]) for x in (0, 0.01, 0.04, 0.05, 0.06)]
    facts = [FrameFacts(k, k / 30, 0, "measured", p, p) for k, p in enumerate(place)]
    rec = records(CAM, place, T[:5], {A: Pose.identity()}, 0.0)
    facts = [
        f.with_(markers=solve_poses(rec, [A], CAM, PARAMS, None, []).facts[k].markers)
        for k, f in enumerate(facts)
    ]
    corner = np.zeros((1, 3))
    relative = jitter_px(facts, corner, CAM, raw=True)
    assert np.isnan(relative[[0, -1]]).all() and np.isfinite(relative[1:-1]).all(), (
        "the ends have no second difference"
    )
    assert np.median(relative[1:-1]) < 1e-6
    resting = [f.with_(markers=facts[0].markers) for f in facts]
    moved = jitter_px(resting, corner, CAM, raw=True)[1:-1]
    assert np.median(moved) == pytest.approx(0.02 * 800)
    broken = [f.with_(shot=int(k > 1)) for k, f in enumerate(facts)]
    assert np.isfinite(jitter_px(broken, corner, CAM, raw=True)).sum() == 1


def test_facts_file_round_trip_and_refusals(tmp_path: Path) -> None:
    a = solve_poses(
        records(CAM, ORBIT, T, LAYOUT, 0.1), [A, B, C], CAM, PARAMS, None, []
    )
    path = tmp_path / "facts.jsonl"
    write_facts(path, a.facts)
    for f, g in zip(a.facts, read_facts(path), strict=True):
        for name in ("index", "time_s", "status", "opacity", "reprojection_px"):
            assert getattr(f, name) == getattr(g, name)
        np.testing.assert_allclose(
            f.camera_from_world.matrix, g.camera_from_world.matrix, atol=1e-14
        )  # type: ignore[union-attr]
    assert not list(tmp_path.glob("*.part"))
    rows = path.read_text().splitlines()
    path.write_text("\n".join(rows[:-3]))
    with pytest.raises(InputError, match="cut short"):
        read_facts(path)
    path.write_text("\n".join([rows[0], rows[1][:40]]))
    with pytest.raises(InputError, match=":2: not a frame"):
        read_facts(path)
    for other in ("{}", rows[0].replace('"version":5', '"version":3')):
        path.write_text("\n".join([other, *rows[1:]]))
        with pytest.raises(InputError, match="no facts file of version 5"):
            read_facts(path)
