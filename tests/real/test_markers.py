"""The analysis on the real clips: the same sightings as whole-frame searches, the known
distance, less trembling.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.markers.detect import MarkerDetector
from arfx.analyse.pose.visibility import jitter_px
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from tests.observed import Observed

CLIPS = Path(__file__).parents[2].parent / "shared" / "data" / "marker_clips"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not CLIPS.is_dir(),
        reason="the real clips are not beside the project (shared/data)",
    ),
]
WALL = tuple(MarkerSpec("36h11", i, 0.1651) for i in (3, 4))
SHEET = tuple(MarkerSpec("4X4_50", i, 0.02) for i in range(12))


def frames(path: Path) -> Iterator[tuple[int, float, np.ndarray]]:
    """(number, time, luma of full range)"""
    with ClipReader(probe(path)) as reader:
        for f in reader.frames():
            yield (
                f.index,
                f.time_s,
                f.luma()
                if f.clip.full_range
                else f.picture.to_ndarray(format="gray"),
            )


def compared(
    path: Path, markers: tuple[MarkerSpec, ...], cam: Camera, every: int
) -> tuple[Observed, set, set, float]:
    """(analyser after the clip, sightings missed, sightings more, largest corner difference
    px), against a search of the whole of every n-th frame."""
    analyser, detector = (
        Observed(AnalysisJob(markers, cam)),
        MarkerDetector([markers[0].family]),
    )
    found = analyser.search._coded
    missed, more, worst = set(), set(), 0.0
    for k, t, luma in frames(path):
        analyser.step(AnalysisFrame(k, t, luma))
        if k % every:
            continue
        whole = {
            c.key: c.quad_px
            for c in detector.search(luma)
            if c.key in {m.key for m in markers}
        }
        got = {
            key: track.quad
            for key, track in found.tracks.items()
            if track.time_s == t
        }
        missed |= {(k, key) for key in whole.keys() - got.keys()}
        more |= {(k, key) for key in got.keys() - whole.keys()}
        worst = max(
            [
                worst,
                *(
                    float(np.abs(whole[key] - got[key]).max())
                    for key in whole.keys() & got.keys()
                ),
            ]
        )
    return analyser, missed, more, worst


@pytest.fixture(scope="module")
def wall() -> tuple[Observed, Analysis, set, set, float]:
    d = CLIPS / "wpilibsuite-allwpilib"
    j = json.loads((d / "camera.json").read_text())
    cam = Camera(1920, 1080, np.array(j["K"]).reshape(3, 3), np.array(j["dist"]))
    analyser, missed, more, worst = compared(d / "fieldvideo_long.mp4", WALL, cam, 4)
    return analyser, analyser.finish(), missed, more, worst


def test_tracked_search_equals_whole_frame_search(wall: tuple) -> None:
    _, analysis, missed, more, worst = wall
    assert not missed and not more and worst < 1e-3
    assert analysis.summary["frames_measured"] == 159
    assert all(len(f.markers) == 2 for f in analysis.facts)


def test_tag_to_tag_distance(wall: tuple) -> None:
    place = wall[1].world_from_marker["36h11:4"].translation_m
    assert np.linalg.norm(place) == pytest.approx(0.531, abs=0.004)


def test_object_trembles_less_against_the_picture_and_stays_on_the_marker(
    wall: tuple,
) -> None:
    """The footage's own shaking is in every second difference, and the object has to follow
    it: what smoothing can and must take away is the trembling relative to the picture."""
    analyser, analysis = wall[0], wall[1]
    box = np.array(
        [
            [x, y, z]
            for x in (-0.075, 0.075)
            for y in (-0.05, 0.05)
            for z in (0.0, 0.15)
        ]
    )
    raw, smooth = (
        jitter_px(analysis.facts, box, analyser.job.camera, r) for r in (True, False)
    )
    assert (
        np.nanmedian(smooth) < np.nanmedian(raw) / 3
        and np.nanmean(smooth**2) < np.nanmean(raw**2) / 9
    )
    r = analysis.summary["reprojection_px"]
    assert r["smoothed"]["median"] < 1.1 * r["raw"]["median"] < 0.35
    assert analysis.static == "marker" and analysis.summary["flips_resolved"] == 0


def test_small_dark_markers() -> None:
    path = CLIPS / "JunkyByte-deepcharuco" / "video_test.mp4"
    analyser, missed, more, worst = compared(path, SHEET, Camera.guess(320, 180), 3)
    assert not missed and not more and worst < 1e-3
    analysis = analyser.finish()
    assert (
        analysis.summary["frames_measured"] >= 371
        and len(analysis.world_from_marker) == 12
    )


def test_hand_held_tag() -> None:
    path = CLIPS / "SciKit-Surgery-snappysonic" / "aruco_tag.avi"
    analyser, missed, more, worst = compared(
        path, (MarkerSpec("4X4_50", 0, 0.05),), Camera.guess(640, 480), 1
    )
    assert not missed and not more and worst < 1e-3
    assert analyser.finish().summary["frames_measured"] == 10
