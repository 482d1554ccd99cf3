"""The lens of real footage: a phone's deep focus is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.core.marker import MarkerSpec
from arfx.media.cameras import load_camera
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from tests.observed import Observed

CLIPS = (
    Path(__file__).parents[3]
    / "shared"
    / "data"
    / "marker_clips"
    / "wpilibsuite-allwpilib"
)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not CLIPS.is_dir(),
        reason="the real clips are not beside the project (shared/data)",
    ),
]


def test_a_deep_focus_tells_no_lens() -> None:
    """Its print lies at 1.4 m, tilted; all its sides are as sharp as one another."""
    info = probe(CLIPS / "fieldvideo_long.mp4")
    camera = load_camera(CLIPS / "camera.json").scaled_to(info.width, info.height)
    analyser = Observed(
        AnalysisJob((MarkerSpec.parse("36h11:3:165.1mm"),), camera), {"lens"}
    )
    with ClipReader(info) as reader:
        for frame in reader.frames():
            if frame.index == 40:
                break
            analyser.step(AnalysisFrame(frame.index, frame.time_s, frame.luma()))
    fit = analyser.finish().summary["footage_lens"]
    assert not fit["known"] and "does not grow" in fit["reason"]
