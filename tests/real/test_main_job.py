"""The main job on the real hand-held clip."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from arfx.config.load import load
from arfx.run.job import Options, process
from arfx.run.parameters import parameters

DATA = Path(__file__).parents[2].parent / "shared" / "data"
CLIPS = DATA / "marker_clips" / "wpilibsuite-allwpilib"
DUCK = DATA / "models" / "mikedh-trimesh" / "Duck.glb"

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not CLIPS.is_dir(),
        reason="the real clips are not beside the project (shared/data)",
    ),
]


def times(path: Path) -> list[float]:
    """Of each packet, as the file stores them."""
    with av.open(str(path)) as c:
        s = c.streams.video[0]
        return [float(p.pts * s.time_base) for p in c.demux(s) if p.size]


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """(its report, the output). Levels and what the encoder spends change neither times nor
    poses; its effort is the least at which frames are still stored out of their order."""
    output = tmp_path_factory.mktemp("real") / "out.mp4"
    document = {
        "input": {"clip": str(CLIPS / "fieldvideo_long.mp4"), "camera": str(CLIPS / "camera.json")},
        "marker": [{"spec": "36h11:3:165.1mm"}, {"spec": "36h11:4:165.1mm"}], "model": {"file": str(DUCK), "fit": "15cm"},
        "pipeline": {"quality": "draft"}, "output": {"path": str(output), "preset": "superfast", "crf": 45},
    }  # fmt: skip
    return (
        process(load(None, document, parameters()), Options(notice=lambda _: None)),
        output,
    )


def test_every_frame_comes_out_at_its_time(job: tuple[dict, Path]) -> None:
    a, b = (times(path) for path in (CLIPS / "fieldvideo_long.mp4", job[1]))
    assert b != sorted(b), (
        "an encoder that stores frames in their order has an easier task"
    )
    assert len(a) == len(b) == 159
    np.testing.assert_allclose(sorted(a), sorted(b), atol=1e-9)


def test_the_pose_is_steady_and_still_fits(job: tuple[dict, Path]) -> None:
    pose = job[0]["pose"]
    assert pose["frames_measured"] == 159
    assert pose["reprojection_px"]["median"] < 0.5
    assert pose["jitter_before_smoothing_px"] >= 3.0 * pose["jitter_px"], (
        "the object trembles far less against its marker"
    )
    assert (
        pose["reprojection_px"]["median"]
        <= 1.1 * pose["reprojection_px"]["before_smoothing"]["median"]
    )


def test_the_two_tags_are_mapped_at_their_distance(job: tuple[dict, Path]) -> None:
    world = job[0]["pose"]["world_from_marker"]
    a, b = (np.array(world[k][3:]) for k in ("36h11:3", "36h11:4"))
    assert np.linalg.norm(a - b) == pytest.approx(0.531, abs=0.004)
