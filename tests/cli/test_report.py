"""The report of a real job, from `process --report` and from its job folder."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Material, Run


@pytest.fixture(scope="module")
def job(material: Material, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with out.mp4, its job folder `job` and the report that `process` wrote, `rep`."""
    import subprocess
    import sys

    folder = tmp_path_factory.mktemp("reported")
    arguments = material.arguments(
        "-o", "out.mp4", "--job", "job", "--report", "rep", "--end", "0.6s"
    )
    done = subprocess.run(
        [sys.executable, "-m", "arfx_cli", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_process_writes_both_files(job: Path) -> None:
    report = json.loads((job / "rep" / "report.json").read_text())
    fields = {
        "input": {
            "path",
            "frames",
            "seconds",
            "width",
            "height",
            "fps",
            "vfr",
            "rotation",
            "audio",
        },
        "output": {"path", "frames", "seconds", "bytes"},
        "pose": {
            "frames_measured",
            "frames_interpolated",
            "frames_absent",
            "reprojection_px",
            "jitter_px",
            "flips_resolved",
        },
        "light": {
            "source",
            "frame",
            "normals_seen",
            "rank",
            "condition",
            "gain",
            "bias",
            "ambient_rgb",
            "lights",
            "verdict",
            "reason",
            "spans",
            "frames_shaded",
        },
        "timing": {
            "decode_s",
            "analyse_s",
            "render_s",
            "encode_s",
            "wall_s",
            "frames_per_s",
            "peak_rss_mb",
        },
    }
    for section, names in fields.items():
        assert names <= set(report[section]), section
    span = {"start_s", "end_s", "verdict", "lights", "ambient_rgb", "reason"}
    assert report["light"]["spans"] and all(
        span <= set(s) for s in report["light"]["spans"]
    )
    stage = {
        "name",
        "levels",
        "frames_run",
        "frames_skipped",
        "area_fraction",
        "predicted_s",
        "measured_s",
        "reasons",
    }
    assert all(stage <= set(s) for s in report["stages"]) and report["stages"]
    assert all(
        {"check", "value", "limit", "verdict", "action"} <= set(h)
        for h in report["health"]
    )
    page = (job / "rep" / "report.html").read_text()
    assert (
        "clip.mp4" in page
        and 'class="slider"' in page
        and len(re.findall(r'class="out"', page)) >= 2
    )
    assert not re.search(r'(?:src|href)="(?!data:)', page)


def test_the_job_folder_gives_the_same_report_again(job: Path, arfx: Run) -> None:
    r = arfx("report", str(job / "job"), "-o", str(job / "again"), "--json")
    assert r.code == 0, r.err
    assert r.json == json.loads((job / "rep" / "report.json").read_text())
    assert (job / "again" / "report.html").read_text() == (
        job / "rep" / "report.html"
    ).read_text()


def test_it_lands_beside_the_job_and_is_not_replaced_unasked(
    job: Path, arfx: Run
) -> None:
    assert arfx("report", str(job / "job")).code == 0
    assert (job / "job.report" / "report.html").exists()
    r = arfx("report", str(job / "job"))
    assert r.code == 2 and "--overwrite" in r.err
    assert arfx("report", str(job / "job"), "--overwrite").code == 0


def test_what_is_no_finished_job_is_one_message(
    job: Path, arfx: Run, tmp_path: Path
) -> None:
    assert arfx("report", "nowhere").code == 3
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "job.toml").write_text("")
    r = arfx("report", "half")
    assert (
        r.code == 3
        and "--resume" in r.err
        and "Traceback" not in r.err
        and not (tmp_path / "half.report").exists()
    )
    (tmp_path / "half" / "report.json").write_bytes(
        (job / "job" / "report.json").read_bytes()
    )
    r = arfx("report", "half")
    assert r.code == 3 and "damaged" in r.err and "Traceback" not in r.err


@pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="this system has no named pipes"
)
@pytest.mark.parametrize("name", ["report.json", "facts.jsonl", "inputs.json"])
def test_a_pipe_in_a_jobs_folder_is_not_waited_for(
    job: Path, arfx: Run, tmp_path: Path, name: str
) -> None:
    shutil.copytree(job / "job", tmp_path / "copy")
    (tmp_path / "copy" / name).unlink()
    os.mkfifo(tmp_path / "copy" / name)
    r = arfx("report", "copy", "-o", "again")
    assert r.code == 3 and name in r.err and not (tmp_path / "again").exists()
