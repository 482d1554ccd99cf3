"""Where the analysis looks, and that it finds what a whole-frame search of every frame finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from arfx.analyse.fold import AnalysisFrame, AnalysisJob
from arfx.analyse.folds import Analyser
from arfx.analyse.markers.detect import Candidate, MarkerDetector
from arfx.analyse.markers.fold import Markers
from arfx.analyse.markers.tracker import LOSS_SEARCH_FRAMES, Found, Tracker
from arfx.analyse.params import AnalyseParams
from arfx.core import codec
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.errors import ArfxError, ConfigError, InputError, NothingToDoError
from tests.unit.analyse.synthetic import background, camera, picture, tilted

CAM = camera(960, 540, 900.0)
BACK = background(960, 540)
M, OTHER = MarkerSpec("36h11", 3, 0.1), MarkerSpec("36h11", 7, 0.1)
Z = 900 * 0.1 / 70


def at(x_px: float, y_px: float, turn: float = 0.2) -> Pose:
    return tilted([turn, 0.1, 0], [(x_px - CAM.cx) / 900 * Z, (y_px - CAM.cy) / 900 * Z, Z])


def frame(*markers: tuple[MarkerSpec, Pose], seed: int = 0, **how: object) -> np.ndarray:
    return picture(CAM, markers, BACK, seed=seed, **how)  # type: ignore[arg-type]


def test_part_gives_the_corners_of_the_whole() -> None:
    image = frame((M, at(300, 200)), (OTHER, at(600, 350)))
    whole = {c.key: c.quad_px for c in MarkerDetector(["36h11"]).search(image)}
    part = MarkerDetector(["36h11"]).search(image, Rect(200, 120, 400, 300))
    assert [c.key for c in part] == [M.key] and np.array_equal(
        part[0].quad_px, whole[M.key]
    )
    reduced = {c.key: c.quad_px for c in MarkerDetector(["36h11"]).search(image, None, 2)}
    assert (
        reduced.keys() == whole.keys() and np.abs(reduced[M.key] - whole[M.key]).max() < 5
    )


class Counted(Tracker):
    """searched_px : pixels that the detector was given in the last step"""

    searched_px = 0

    def step(self, *frame: Any) -> Found:
        self.searched_px = 0
        search = MarkerDetector(self.detector.families, self.detector.min_side_px).search

        def counted(
            luma: np.ndarray, rect: Rect | None = None, factor: int = 1, **more: float
        ) -> list[Candidate]:
            self.searched_px += (luma.size if rect is None else rect.area) // factor**2
            return search(luma, rect, factor, **more)

        self.detector.search = counted  # type: ignore[method-assign]
        return super().step(*frame)


def test_tracked_marker_costs_a_part_and_a_lost_one_is_searched_whole() -> None:
    tracker = Counted([M.key], AnalyseParams())
    whole = []
    for k in range(12):
        found = tracker.step(k / 30, frame((M, at(300 + 8 * k, 200)), seed=k))
        assert [c.key for c in found.sightings] == [M.key]
        whole.append(found.whole)
        if k:
            assert tracker.searched_px < 960 * 540 / 10
    assert sum(whole) == 1
    jump = tracker.step(
        12 / 30, frame((M, at(800, 430)))
    )  # out of its part: the same frame is searched whole
    assert jump.whole and len(jump.sightings) == 1
    empty = [
        (tracker.step((13 + k) / 30, frame(seed=k)), tracker.searched_px) for k in range(60)
    ]
    assert 5 <= sum(f.whole for f, _ in empty) <= 5 + 3 and all(
        f.whole for f, _ in empty[:5]
    )  # then once a second
    assert all(px <= 960 * 540 / 3 for f, px in empty if not f.whole)
    back = tracker.step(73 / 30, frame((M, at(500, 300))))
    assert len(back.sightings) == 1 and not back.whole  # found on the reduced image
    assert (
        np.abs(
            back.sightings[0].quad_px - CAM.project(at(500, 300).apply(M.corners_m))
        ).max()
        < 4
    )


def test_while_nothing_is_in_view_every_second_frame_is_looked_at_and_a_marker_is_found_where_it_comes() -> (
    None
):
    clip = [
        frame((M, at(300, 200)), seed=k) if k in (0, 1) or k >= came else frame(seed=k)
        for came in (22,)
        for k in range(27)
    ]

    def seen(tracker: Counted, first: int, ahead: bool) -> list[tuple[bool, int]]:
        found = []
        for k in range(first, len(clip)):
            following = (lambda k=k: clip[k + 1]) if ahead and k + 1 < len(clip) else None  # type: ignore[misc]
            got = tracker.step(k / 30, clip[k], following)
            found.append((bool(got.sightings), tracker.searched_px))
        return found

    every, ahead = (
        seen(Counted([M.key], AnalyseParams()), 0, False),
        seen(Counted([M.key], AnalyseParams()), 0, True),
    )
    assert (
        [s for s, _ in ahead]
        == [s for s, _ in every]
        == [k < 2 or k >= 22 for k in range(27)]
    )
    gone = slice(2 + LOSS_SEARCH_FRAMES, 21)
    assert all(px > 0 for _, px in every[gone])
    assert sum(px for _, px in ahead[gone]) < 0.7 * sum(px for _, px in every[gone])
    for stop in (12, 13):  # a checkpoint at either of the two frames
        first, second = Tracker([M.key], AnalyseParams()), Counted([M.key], AnalyseParams())
        for k in range(stop):
            first.step(k / 30, clip[k], lambda k=k: clip[k + 1])  # type: ignore[misc]
        second.restore(codec.loads(codec.dumps(first.state())))
        assert seen(second, stop, True) == ahead[stop:]


def test_small_frames_are_searched_in_parts_while_all_is_seen_well() -> None:
    cam, back = camera(480, 270, 450.0), background(480, 270)
    detector = MarkerDetector(["36h11"])

    def clip_frame(k: int, side_px: float, second: bool) -> np.ndarray:
        z = 450 * 0.1 / side_px
        shown = [(M, tilted([0.3, 0.2, 0.1 * k], [(-80 + 6 * k) / 450 * z, 0, z]))]
        if second:
            shown.append((OTHER, tilted([0.1, 0.3, 0], [90 / 450 * z, 0.01, z])))
        return picture(cam, shown, back, seed=k)

    for side_px, keys, parts in (
        (70, [M.key], True),
        (18, [M.key], False),
        (70, [M.key, OTHER.key], False),
    ):
        tracker = Counted(keys, AnalyseParams())
        for k in range(8):
            image = clip_frame(k, side_px, second=k < 4)
            found = tracker.step(k / 30, image)
            whole = {c.key: c.quad_px for c in detector.search(image) if c.key in keys}
            assert {c.key for c in found.sightings} == whole.keys()
            assert all(np.array_equal(c.quad_px, whole[c.key]) for c in found.sightings)
            if k and parts:
                assert tracker.searched_px < 0.4 * image.size and not found.whole
            if k > 4 and not parts:
                assert (
                    found.whole and tracker.searched_px == image.size
                )  # one is missing, or all are tiny


def test_two_prints_of_one_id_are_told_apart_by_where_the_marker_was() -> None:
    tracker = Tracker([M.key], AnalyseParams())
    small = tilted([0.2, 0.1, 0], [0.2, 0.1, Z])
    tracker.step(0.0, frame((M, small)))
    big = tilted([0.1, 0, 0], [-0.15, -0.05, Z * 0.8])
    found = tracker.step(1 / 30, frame((M, small), (M, big)))
    assert len(found.sightings) == 1
    tracker.tracks[M.key].time_s = -9.0
    del tracker.tracks[M.key]
    both = tracker.step(
        3.0, frame((M, small), (M, big))
    )  # found anew: the larger, and the rival is known
    assert (
        len(both.duplicates) == 1 and both.sightings[0].side_px > both.duplicates[0].side_px
    )
    tracker.tracks[M.key].quad = both.duplicates[0].quad_px
    tracker.last_whole_s = -9.0
    again = tracker._choose(3.03, [*both.sightings, *both.duplicates], True)
    assert np.array_equal(again.sightings[0].quad_px, both.duplicates[0].quad_px)


def run(analyser: Analyser, first: int, end: int) -> None:
    for k in range(first, end):
        markers = [(M, at(300 + 6 * k, 200, 0.2 + 0.02 * k))] if k not in (6, 7) else []
        analyser.step(AnalysisFrame(k, k / 15, frame(*markers, seed=k)))


def test_two_stretches_are_one_clip() -> None:
    whole, first, second, both = (Analyser(AnalysisJob((M,), CAM)) for _ in range(4))
    run(whole, 0, 16)
    run(first, 0, 9)
    assert (
        first.end(
            AnalysisFrame(
                9, 9 / 15, frame((M, at(300 + 6 * 9, 200, 0.2 + 0.02 * 9)), seed=9)
            )
        )
        is None
    )
    run(second, 9, 16)
    for part in (first, second):
        both.join(part)
    a, b = whole.finish(), both.finish()
    assert [{**f.to_json(), "whole_frame_search": True} for f in a.facts] == [
        {**f.to_json(), "whole_frame_search": True} for f in b.facts
    ]
    assert a.summary["frames_interpolated"] == 2 and a.summary["frames_measured"] == 14
    truth = at(300 + 6 * 12, 200, 0.2 + 0.02 * 12)
    assert (
        np.linalg.norm(a.facts[12].camera_from_world.translation_m - truth.translation_m)
        < 2e-3
    )  # type: ignore[union-attr]
    assert a.facts[12].reprojection_px is not None and a.facts[12].reprojection_px < 0.1


def test_no_configured_marker_says_what_is_there_instead() -> None:
    a = Analyser(AnalysisJob((OTHER,), CAM))
    for k in range(4):
        a.step(AnalysisFrame(k, k / 30, frame((M, at(300, 200)), seed=k)))
    with pytest.raises(NothingToDoError, match=r"36h11:7.*36h11:3"):
        a.finish()
    b = Analyser(AnalysisJob((MarkerSpec("5X5_50", 2, 0.1),), CAM))
    for k in range(4):
        b.step(AnalysisFrame(k, k / 30, frame((M, at(300, 200)), seed=k)))
    with pytest.raises(
        NothingToDoError, match=r"tried: 5X5_50; other dictionaries saw: 36h11:3"
    ):
        b.finish()
    photo = Analyser(AnalysisJob((MarkerSpec("5X5_50", 2, 0.1),), CAM))
    photo.step(AnalysisFrame(0, 0.0, frame((M, at(300, 200)))))
    with pytest.raises(NothingToDoError, match=r"other dictionaries saw: 36h11:3 \(1 of 1"):
        photo.finish()
    c = Analyser(AnalysisJob((M,), CAM))
    c.step(AnalysisFrame(0, 0.0, frame()))
    with pytest.raises(NothingToDoError, match="no marker of any dictionary") as e:
        c.finish()
    assert e.value.exit_code == 4


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="twice"):
        Analyser(AnalysisJob((M, M), CAM))
    with pytest.raises(ConfigError):
        Analyser(AnalysisJob((), CAM))
    with pytest.raises(ConfigError, match="map holds none"):
        Analyser(AnalysisJob((M,), CAM, marker_map={"36h11:9": Pose.identity()}))
    with pytest.raises(ConfigError, match="static"):
        AnalyseParams(static="both")
    a = Analyser(AnalysisJob((M,), CAM))
    with pytest.raises(InputError, match="uint8"):
        a.step(AnalysisFrame(0, 0.0, np.zeros((540, 960))))
    with pytest.raises(ArfxError, match="aspect"):
        a.step(AnalysisFrame(0, 0.0, np.zeros((540, 540), np.uint8)))
    a.step(AnalysisFrame(0, 0.0, frame()))
    with pytest.raises(InputError, match="comes after"):
        a.step(AnalysisFrame(1, 0.0, frame()))
    with pytest.raises(InputError, match="frames before"):
        a.step(AnalysisFrame(2, 0.1, np.zeros((270, 480), np.uint8)))


def test_camera_of_another_size_is_scaled() -> None:
    a = Analyser(AnalysisJob((M,), camera(1920, 1080, 1800.0)))
    a.step(AnalysisFrame(0, 0.0, frame((M, at(400, 300)))))
    markers = a.folds["markers"]
    assert isinstance(markers, Markers) and (markers.camera.width, markers.camera.fx) == (
        960,
        900.0,
    )


@pytest.mark.parametrize("change", ["distortion", "size"])
def test_markers_that_no_pose_fits_are_nothing_to_work_on(change: str) -> None:
    cam = {
        "distortion": Camera(960, 540, CAM.matrix, np.array([1e9, 0, 0, 0])),
    }.get(change, CAM)
    marker = MarkerSpec("36h11", 3, 1e-300 if change == "size" else 0.1)
    a = Analyser(AnalysisJob((marker,), cam), {"light"})
    for k in range(6):
        a.step(AnalysisFrame(k, k / 15, frame((M, at(300 + 6 * k, 200)), seed=k)))
    with (
        np.errstate(all="ignore"),
        pytest.raises(NothingToDoError, match="in 6 of 6 frames, but no pose fits"),
    ):
        a.finish()


class Job:
    """Frames with two prints of one key: the first is followed from the start, the other,
    larger one comes later.
    """

    small, large = (MarkerSpec("36h11", 3, size) for size in (0.1, 0.14))

    def shown(self, k: int) -> AnalysisFrame:
        prints = [
            (self.small, at(200 + 4 * k, 180)),
            *([(self.large, at(640, 330))] if k >= 5 else []),
        ]
        return AnalysisFrame(k, k / 15, frame(*prints, seed=k))

    def stretch(self, first: int, end: int, lost: Any = None) -> tuple[Analyser, Any]:
        analyser = Analyser(AnalysisJob((M,), CAM))
        if lost is not None:
            analyser.go_on(lost)
        for k in range(first, end):
            analyser.step(self.shown(k))
        return analyser, analyser.end(self.shown(end))


def test_the_print_that_is_followed_is_followed_across_a_border() -> None:
    job = Job()
    nothing = job.stretch(0, 4)[1]
    assert nothing is None, (
        "nothing is lost where a search finds the print that is followed"
    )
    lost = job.stretch(0, 8)[1]
    assert lost is not None
    anew, followed = (
        job.stretch(8, 12)[0],
        job.stretch(8, 12, codec.loads(codec.dumps(lost)))[0],
    )
    x = [
        a.folds["markers"].records[0].detections[0].corners_px[:, 0].mean()
        for a in (anew, followed)
    ]  # type: ignore[attr-defined]
    assert abs(x[0] - 640) < 3 and abs(x[1] - 232) < 3
