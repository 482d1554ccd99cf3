"""Whole jobs drawn by OpenGL, by EGL and by OSMesa: every way to run one, held against rays."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from arfx.config.load import load
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene
from tests.cli.opengl_jobs import FIRST, FRAMES, OTHERS, SCENES

ROOT = Path(__file__).parents[2]


def quiet(*_: object) -> None:
    return None


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short clip of each scene, and what rays make of it: NAME.rays.mkv."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in SCENES:
        whole = load_scene(ROOT / "sample_scenes" / name / "scene.toml")
        shot = whole.shot[0].model_copy(update={"frames": FRAMES})
        clip = whole.clip.model_copy(
            update={
                "width": whole.clip.width // 2,
                "height": whole.clip.height // 4 * 2,
            }
        )
        short = whole.model_copy(update={"shot": (shot,), "clip": clip})
        make_clip(short, folder / name, truth_pictures=False)
        document = {
            "output": {"path": str(folder / f"{name}.rays.mkv"), "codec": "ffv1"},
            "raster": {"backend": "rays"},
        }
        process(
            load(folder / name / "job.toml", document, parameters()),
            Options(progress=quiet, notice=quiet),
        )
    return folder


def clip_of(folder: Path) -> Path:
    (path,) = folder.glob("clip.*")
    return path


def frames_of(path: Path) -> np.ndarray:
    with ClipReader(probe(path)) as reader:
        return np.array([frame.rgb8() for frame in reader.frames()])


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("platform", ["egl", "osmesa"])
def test_every_way_to_run_a_job(
    platform: str, scenes: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    for name in SCENES:
        (tmp_path / name).symlink_to(scenes / name)
    p = subprocess.run(
        [sys.executable, "-m", "tests.cli.opengl_jobs", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "PYOPENGL_PLATFORM": platform}, timeout=1200,
    )  # fmt: skip
    assert p.returncode == 0, p.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    if results["opened"].startswith("no OpenGL context opens"):
        pytest.skip(results["opened"])
    request.node.user_properties.append(("OpenGL", results["opened"]))
    codes = {name: code for name, (code, _) in results["jobs"].items()}
    assert codes == dict.fromkeys(
        ("default", "1", "2", "resumed", *OTHERS, "tradeoff", "demo"), 0
    ), p.stderr
    assert all(
        drawn for name, (_, drawn) in results["jobs"].items() if name != "2"
    ), results["jobs"]
    assert "Exception ignored" not in p.stderr and "Traceback" not in p.stderr, (
        p.stderr
    )

    ways = {
        name: (tmp_path / f"{name}.mkv").read_bytes()
        for name in ("default", "1", "2", "resumed")
    }
    assert len(set(ways.values())) == 1, "not every way gives the same bytes"
    for name in SCENES:
        made, rays, clip = (
            frames_of(path).astype(int)
            for path in (
                tmp_path / f"{'default' if name == FIRST else name}.mkv", scenes / f"{name}.rays.mkv", clip_of(scenes / name)
            )
        )  # fmt: skip
        changed = (rays != clip).any(-1)
        difference = np.abs(made - rays).max(-1)[changed]
        assert changed.sum() > 2000, f"{name} shows nothing"
        # grey levels; they are 0.5 to 1 apart, and 11 to 15 where the object is moved by one pixel
        assert 0 < difference.mean() < 2, name
        assert (difference > 16).mean() < 0.03, name
