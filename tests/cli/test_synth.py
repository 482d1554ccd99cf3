"""`arfx synth` and `arfx verify` through the command line, and the clip they make through
`arfx process`.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run

SCENE = """
description = "a print on a desk"
seed = 3
[clip]
width = 320
height = 180
[[shot]]
frames = 12
path = { kind = "orbit", radius_m = "38cm", azimuth_deg = [-105, -85], elevation_deg = [48, 52] }
[[plane]]
position_m = [0, 0, "-0.2mm"]
texture = { kind = "wood", colour = [0.2, 0.11, 0.06], second = [0.6, 0.42, 0.26] }
[[marker]]
spec = "36h11:3:100mm"
[model]
shape = "block"
fit = "6cm"
"""


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `arfx synth` makes it."""
    import os
    import subprocess
    import sys

    folder = tmp_path_factory.mktemp("synth")
    (folder / "scene.toml").write_text(SCENE)
    command = [
        sys.executable,
        "-m",
        "arfx_cli",
        "synth",
        "scene.toml",
        "-o",
        "out",
        "--json",
    ]
    p = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ},
        check=False,
        timeout=300,
    )
    assert p.returncode == 0, p.stderr
    (folder / "stdout.json").write_text(p.stdout)
    return folder


def test_the_folder_holds_all_a_job_needs_and_the_truth(made: Path) -> None:
    said = json.loads((made / "stdout.json").read_text())
    assert said["frames"] == 12 and said["world"] == "36h11:3"
    assert said["files"] == [
        "camera.yaml",
        "clip.mp4",
        "job.toml",
        "model.glb",
        "truth",
        "truth.jsonl",
    ]
    assert len((made / "out" / "truth.jsonl").read_text().splitlines()) == 13
    assert {p.name for p in (made / "out" / "truth").iterdir()} == {
        "depth",
        "mask",
        "flow",
    }


def test_the_made_folder_is_processed_as_it_is_and_from_anywhere(
    made: Path, arfx: Run, tmp_path: Path
) -> None:
    r = arfx(
        "process",
        "--config",
        str(made / "out" / "job.toml"),
        "-o",
        "out.mp4",
        "--json",
    )
    assert r.code == 0, r.err
    assert (
        r.json["pose"]["frames_measured"] == 12
        and r.json["pose"]["frames_absent"] == 0
    )
    assert (tmp_path / "out.mp4").exists()


def test_verify_reports_small_errors_and_no_flip(made: Path, arfx: Run) -> None:
    r = arfx("verify", str(made / "out"), "--json")
    assert r.code == 0, r.err
    figures = r.json["figures"]
    assert r.json["broken"] == []
    for who in ("single_frame", "raw", "arfx"):
        assert figures[who]["frames"] == 12 and figures[who]["flips"] == 0
        assert (
            0 < figures[who]["rotation_deg"]["median"] < 2
            and 0 < figures[who]["position_mm"]["median"] < 6
        )
    assert figures["presence"] == {
        "seen": 12,
        "missed": 0,
        "hidden": 0,
        "invented": 0,
        "bridged": 0,
        "unclear": 0,
    }


def test_verify_fails_when_a_bound_is_broken_and_leaves_the_folder_alone(
    made: Path, arfx: Run, tmp_path: Path
) -> None:
    import shutil

    folder = tmp_path / "bounded"
    shutil.copytree(made / "out", folder)
    (folder / "tolerance.toml").write_text(
        '[truth.max]\n"arfx.flips" = 0\n"arfx.rotation_deg.max" = 1e-6\n'
    )
    before = sorted(folder.rglob("*"))
    r = arfx("verify", str(folder))
    assert r.code == 5
    assert (
        "arfx.rotation_deg.max is" in r.err
        and "at most 1e-06" in r.err
        and "arfx.flips is" not in r.err
    )
    assert (
        "single frame, OpenCV (12)" in r.out and sorted(folder.rglob("*")) == before
    )


def test_an_existing_folder_is_kept_unless_told_otherwise(
    made: Path, arfx: Run
) -> None:
    stamp = (made / "out" / "clip.mp4").stat().st_mtime_ns
    r = arfx("synth", str(made / "scene.toml"), "-o", str(made / "out"))
    assert (
        r.code == 2
        and "--overwrite" in r.err
        and (made / "out" / "clip.mp4").stat().st_mtime_ns == stamp
    )


@pytest.mark.parametrize(
    ("text", "arguments", "code", "words"),
    [
        ("[clip]\nwidht = 3\n", (), 2, "scene.toml:2: clip.widht"),
        (SCENE, ("--truth", "depth,normals"), 2, "there is no 'normals'"),
        (None, (), 3, "scene scene.toml: no such file"),
    ],
)
def test_a_wrong_scene_says_what_and_where(
    arfx: Run,
    tmp_path: Path,
    text: str | None,
    arguments: tuple[str, ...],
    code: int,
    words: str,
) -> None:
    if text is not None:
        (tmp_path / "scene.toml").write_text(text)
    r = arfx("synth", "scene.toml", "-o", "out", *arguments)
    assert r.code == code and words in r.err and "Traceback" not in r.err
    assert not (tmp_path / "out").exists()


def test_verify_of_another_folder_says_what_it_needs(
    arfx: Run, tmp_path: Path
) -> None:
    r = arfx("verify", str(tmp_path))
    assert r.code == 3 and "truth.jsonl" in r.err
    scene = SCENE.replace(
        '[[marker]]\nspec = "36h11:3:100mm"',
        '[[marker]]\nspec = "36h11:3:100mm"\nconfigured = false',
    )
    (tmp_path / "scene.toml").write_text(scene.replace("frames = 12", "frames = 2"))
    r = arfx("verify", str(tmp_path))
    assert r.code == 4 and "no configured marker" in r.err
