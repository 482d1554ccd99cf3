"""The main job on the real hand-held clip."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

DATA = Path(__file__).parents[2].parent / "shared" / "data"
CLIPS = DATA / "marker_clips" / "wpilibsuite-allwpilib"
DUCK = DATA / "models" / "mikedh-trimesh" / "Duck.glb"

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not CLIPS.is_dir(), reason="the real clips are not beside the project (shared/data)"),
]


def times(path: Path) -> list[float]:
    with av.open(str(path)) as c:
        s = c.streams.video[0]
        return sorted(float(p.pts * s.time_base) for p in c.demux(s) if p.size)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    d = tmp_path_factory.mktemp("real")
    args = [
        "process", str(CLIPS / "fieldvideo_long.mp4"), "--camera", str(CLIPS / "camera.json"), "--marker", "36h11:3:165.1mm",
        "--marker", "36h11:4:165.1mm", "--model", str(DUCK), "--fit", "15cm", "-o", str(d / "out.mp4"), "--json",
    ]  # fmt: skip
    p = subprocess.run([sys.executable, "-m", "arfx_cli", *args], capture_output=True, text=True, check=False)
    assert p.returncode == 0, p.stderr
    return json.loads(p.stdout), d / "out.mp4"


def test_every_frame_comes_out_at_its_time(job: tuple[dict, Path]) -> None:
    a, b = times(CLIPS / "fieldvideo_long.mp4"), times(job[1])
    assert len(a) == len(b) == 159
    np.testing.assert_allclose(a, b, atol=1e-9)


def test_the_pose_is_steady_and_still_fits(job: tuple[dict, Path]) -> None:
    pose = job[0]["pose"]
    assert pose["frames_measured"] == 159
    assert pose["reprojection_px"]["median"] < 0.5
    assert pose["jitter_before_smoothing_px"] >= 3.0 * pose["jitter_px"], "the object trembles far less against its marker"
    assert pose["reprojection_px"]["median"] <= 1.1 * pose["reprojection_px"]["before_smoothing"]["median"]


def test_the_two_tags_are_mapped_at_their_distance(job: tuple[dict, Path]) -> None:
    world = job[0]["pose"]["world_from_marker"]
    a, b = (np.array(world[k][3:]) for k in ("36h11:3", "36h11:4"))
    assert np.linalg.norm(a - b) == pytest.approx(0.531, abs=0.004)
