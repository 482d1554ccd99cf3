"""Where the analysis looks, and that it finds what a whole-frame search of every frame finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.detect import Candidate, MarkerDetector
from arfx.analyse.markers.tracker import LOSS_SEARCH_FRAMES, CodedPrints
from arfx.analyse.params import AnalyseParams
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.errors import ArfxError, NothingToDoError
from tests.observed import Observed
from tests.unit.analyse.synthetic import background, camera, picture, tilted

CAM = camera(960, 540, 900.0)
BACK = background(960, 540)
M, OTHER = MarkerSpec("36h11", 3, 0.1), MarkerSpec("36h11", 7, 0.1)
Z = 900 * 0.1 / 70


def at(x_px: float, y_px: float, turn: float = 0.2) -> Pose:
    return tilted(
        [turn, 0.1, 0], [(x_px - CAM.cx) / 900 * Z, (y_px - CAM.cy) / 900 * Z, Z]
    )


def frame(
    *markers: tuple[MarkerSpec, Pose], seed: int = 0, **how: object
) -> np.ndarray:
    return picture(CAM, markers, BACK, seed=seed, **how)  # type: ignore[arg-type]


def test_part_gives_the_corners_of_the_whole() -> None:
    image = frame((M, at(300, 200)), (OTHER, at(600, 350)))
    whole = {c.key: c.quad_px for c in MarkerDetector(["36h11"]).search(image)}
    part = MarkerDetector(["36h11"]).search(image, Rect(200, 120, 400, 300))
    assert [c.key for c in part] == [M.key] and np.array_equal(
        part[0].quad_px, whole[M.key]
    )
    reduced = {
        c.key: c.quad_px for c in MarkerDetector(["36h11"]).search(image, None, 2)
    }
    assert (
        reduced.keys() == whole.keys()
        and np.abs(reduced[M.key] - whole[M.key]).max() < 5
    )


class Counted:
    """A tracker. searched_px : pixels that the detector was given in the last frame
    whole : all of it was searched"""

    def __init__(self, *keys: str) -> None:
        self.tracker, self.searched_px, self._frames = CodedPrints(keys), 0, 0
        search = self.tracker.detector.search

        def counted(
            luma: np.ndarray, rect: Rect | None = None, factor: int = 1, **more: float
        ) -> list[Candidate]:
            self.whole |= rect is None and factor == 1
            picture = Rect.of(*luma.shape[::-1])
            self.searched_px += picture.clip(rect or picture).area // factor**2
            return search(luma, rect, factor, **more)

        self.tracker.detector.search = counted  # type: ignore[method-assign]

    def step(
        self, time_s: float, luma: np.ndarray, following: Any = None
    ) -> list[Candidate]:
        self.searched_px, self.whole = 0, False
        shown = AnalysisFrame(self._frames, time_s, luma, None, following)
        self._frames += 1
        seen, self.twice = self.tracker.search(shown)
        return seen


def test_tracked_marker_costs_a_part_and_a_lost_one_is_searched_whole() -> None:
    tracker = Counted(M.key)
    whole = []
    for k in range(12):
        found = tracker.step(k / 30, frame((M, at(300 + 8 * k, 200)), seed=k))
        assert [c.key for c in found] == [M.key]
        whole.append(tracker.whole)
        if k:
            assert tracker.searched_px < 960 * 540 / 10
    assert sum(whole) == 1
    jump = tracker.step(
        12 / 30, frame((M, at(800, 430)))
    )  # out of its part: the same frame is searched whole
    assert tracker.whole and len(jump) == 1
    empty = []
    for k in range(60):
        tracker.step((13 + k) / 30, frame(seed=k))
        empty.append((tracker.whole, tracker.searched_px))
    assert 5 <= sum(whole for whole, _ in empty) <= 5 + 3
    assert all(whole for whole, _ in empty[:5])  # then once a second
    assert all(px <= 960 * 540 / 3 for whole, px in empty if not whole)
    back = tracker.step(73 / 30, frame((M, at(500, 300))))
    assert len(back) == 1 and not tracker.whole  # found on the reduced image
    assert (
        np.abs(back[0].quad_px - CAM.project(at(500, 300).apply(M.corners_m))).max()
        < 4
    )


def test_while_nothing_is_in_view_every_second_frame_is_looked_at_and_a_marker_is_found_where_it_comes() -> (
    None
):
    clip = [
        frame((M, at(300, 200)), seed=k)
        if k in (0, 1) or k >= came
        else frame(seed=k)
        for came in (22,)
        for k in range(27)
    ]

    def seen(tracker: Counted, ahead: bool) -> list[tuple[bool, int]]:
        found = []
        for k in range(len(clip)):
            following = (
                (lambda k=k: clip[k + 1]) if ahead and k + 1 < len(clip) else None
            )  # type: ignore[misc]
            got = tracker.step(k / 30, clip[k], following)
            found.append((bool(got), tracker.searched_px))
        return found

    every, ahead = seen(Counted(M.key), False), seen(Counted(M.key), True)
    assert (
        [s for s, _ in ahead]
        == [s for s, _ in every]
        == [k < 2 or k >= 22 for k in range(27)]
    )
    gone = slice(2 + LOSS_SEARCH_FRAMES, 21)
    assert all(px > 0 for _, px in every[gone])
    assert sum(px for _, px in ahead[gone]) < 0.7 * sum(px for _, px in every[gone])


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
        tracker = Counted(*keys)
        for k in range(8):
            image = clip_frame(k, side_px, second=k < 4)
            found = tracker.step(k / 30, image)
            whole = {
                c.key: c.quad_px for c in detector.search(image) if c.key in keys
            }
            assert {c.key for c in found} == whole.keys()
            assert all(np.array_equal(c.quad_px, whole[c.key]) for c in found)
            if k and parts:
                assert tracker.searched_px < 0.4 * image.size and not tracker.whole
            if k > 4 and not parts:
                assert (
                    tracker.whole and tracker.searched_px == image.size
                )  # one is missing, or all are tiny


def test_two_prints_of_one_id_are_told_apart_by_where_the_marker_was() -> None:
    """A smaller one that leaps is found by a search of the whole frame, and followed though
    the larger one is found too; anew, the larger one is taken."""
    big = (M, tilted([0.1, 0, 0], [-0.15, -0.05, Z * 0.8]))
    before, after = at(700, 350), at(600, 420)
    both = frame((M, after), big)
    tracker = Counted(M.key)
    assert len(tracker.step(0.0, frame((M, before)))) == 1
    for search, followed in ((tracker, True), (Counted(M.key), False)):
        (found,) = search.step(0.04, both)
        assert search.whole and search.twice == [M.key]
        away = found.quad_px.mean(0) - CAM.project(after.apply(M.corners_m)).mean(0)
        assert (np.linalg.norm(away) < 3) == followed


def run(analyser: Observed, first: int, end: int) -> None:
    for k in range(first, end):
        markers = (
            [(M, at(300 + 6 * k, 200, 0.2 + 0.02 * k))] if k not in (6, 7) else []
        )
        analyser.step(AnalysisFrame(k, k / 15, frame(*markers, seed=k)))


def test_two_stretches_are_one_clip() -> None:
    whole, first, second, both = (Observed(AnalysisJob((M,), CAM)) for _ in range(4))
    run(whole, 0, 16)
    run(first, 0, 9)
    run(second, 9, 16)
    for part in (first, second):
        both.add(part.tables())
    a, b = whole.finish(), both.finish()
    assert [f.to_json() for f in a.facts] == [f.to_json() for f in b.facts]
    assert (
        a.summary["frames_interpolated"] == 2 and a.summary["frames_measured"] == 14
    )
    truth = at(300 + 6 * 12, 200, 0.2 + 0.02 * 12)
    assert (
        np.linalg.norm(
            a.facts[12].camera_from_world.translation_m - truth.translation_m
        )
        < 2e-3
    )  # type: ignore[union-attr]
    assert (
        a.facts[12].reprojection_px is not None and a.facts[12].reprojection_px < 0.1
    )


def test_no_configured_marker_says_what_is_there_instead() -> None:
    a = Observed(AnalysisJob((OTHER,), CAM))
    for k in range(4):
        a.step(AnalysisFrame(k, k / 30, frame((M, at(300, 200)), seed=k)))
    with pytest.raises(NothingToDoError, match=r"36h11:7.*36h11:3"):
        a.finish()
    b = Observed(AnalysisJob((MarkerSpec("5X5_50", 2, 0.1),), CAM))
    for k in range(4):
        b.step(AnalysisFrame(k, k / 30, frame((M, at(300, 200)), seed=k)))
    with pytest.raises(
        NothingToDoError, match=r"tried: 5X5_50; seen instead: 36h11:3"
    ):
        b.finish()
    photo = Observed(AnalysisJob((MarkerSpec("5X5_50", 2, 0.1),), CAM))
    photo.step(AnalysisFrame(0, 0.0, frame((M, at(300, 200)))))
    with pytest.raises(NothingToDoError, match=r"seen instead: 36h11:3 \(1 of 1"):
        photo.finish()
    c = Observed(AnalysisJob((M,), CAM))
    c.step(AnalysisFrame(0, 0.0, frame()))
    with pytest.raises(NothingToDoError, match="no marker of any dictionary") as e:
        c.finish()
    assert e.value.exit_code == 4


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValidationError, match="static"):
        AnalyseParams(static="both")  # type: ignore[arg-type]
    a = Observed(AnalysisJob((M,), CAM))
    with pytest.raises(ArfxError, match="aspect"):
        a.step(AnalysisFrame(0, 0.0, np.zeros((540, 540), np.uint8)))


def test_camera_of_another_size_is_scaled() -> None:
    poses = []
    own = camera(960, 540, 900.0)
    for cam in (own.scaled_to(1920, 1080), own):
        a = Observed(AnalysisJob((M,), cam))
        for k in range(4):
            a.step(AnalysisFrame(k, k / 30, frame((M, at(400, 300)))))
        poses.append(a.finish().facts[0].camera_from_world)
    a, b = poses
    assert a is not None and b is not None
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-9)


@pytest.mark.parametrize("change", ["distortion", "size"])
def test_markers_that_no_pose_fits_are_nothing_to_work_on(change: str) -> None:
    cam = {
        "distortion": Camera(960, 540, CAM.matrix, np.array([1e9, 0, 0, 0])),
    }.get(change, CAM)
    marker = MarkerSpec("36h11", 3, 1e-300 if change == "size" else 0.1)
    a = Observed(AnalysisJob((marker,), cam), {"light"})
    for k in range(6):
        a.step(AnalysisFrame(k, k / 15, frame((M, at(300 + 6 * k, 200)), seed=k)))
    with (
        np.errstate(all="ignore"),
        pytest.raises(NothingToDoError, match="in 6 of 6 frames, but no pose fits"),
    ):
        a.finish()
