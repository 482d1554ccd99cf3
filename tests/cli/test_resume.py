"""The times that a resumed job reports: those of all the work in its output, whichever
process did it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from arfx.config.load import load
from arfx.config.sections import JobConfig
from arfx.errors import ConfigError, JobInterruptedError, RenderError
from arfx.measure.report import report_of_job
from arfx.media import join
from arfx.run import stretches
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.run.times import WorkLog
from tests.cli.conftest import FRAMES, Material, Run
from tests.clips import MARKER, write_clip

Progress = Callable[[str, int, int | None], None]


def quiet(*_: object) -> None:
    return None


def job(material: Material, tmp_path: Path) -> JobConfig:
    document = {
        "input": {"clip": str(material.clip), "camera": str(material.camera)}, "marker": [{"spec": str(MARKER)}],
        "model": {"file": str(material.model), "fit": "8cm"}, "output": {"path": str(tmp_path / "out.mp4")},
    }  # fmt: skip
    return load(None, document, parameters())


def interrupted(
    config: JobConfig, folder: Path, phase: str, frame: int
) -> list[dict[str, Any]]:
    """Runs the job until `frame` of `phase`; the rows that it leaves in timings.jsonl."""

    def stop(at: str, done: int, _: int | None) -> None:
        if at == phase and done >= frame:
            raise KeyboardInterrupt

    with pytest.raises(JobInterruptedError):
        process(config, Options(folder, progress=stop, notice=quiet))
    timings = folder / "timings.jsonl"
    return (
        [json.loads(line) for line in timings.read_text().splitlines()]
        if timings.exists()
        else []
    )


@pytest.mark.parametrize("name", ["out.mkv", "frames/%06d.png"])
def test_a_job_that_ended_after_its_output_was_in_place_is_resumed(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    config = job(material, tmp_path)
    config = config.model_copy(
        update={"output": config.output.model_copy(update={"path": tmp_path / name})}
    )

    def fail(*_: object) -> None:
        raise RenderError("the disk is full")

    with monkeypatch.context() as m, pytest.raises(RenderError):
        m.setattr("arfx.run.job.build_report", fail)
        process(config, Options(notice=quiet))
    made = sorted(p for p in (tmp_path / name).parent.iterdir() if p.is_file())
    before = [p.read_bytes() for p in made]
    with pytest.raises(ConfigError, match="exists"):
        process(config, Options(notice=quiet))
    process(config, Options(resume=True, notice=quiet))
    assert made and [p.read_bytes() for p in made] == before
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".job"]


def test_a_resumed_job_replaces_no_output_that_is_not_its_own(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = job(material, tmp_path), tmp_path / "out.mp4"
    with monkeypatch.context() as m, pytest.raises(RenderError):
        m.setattr(
            "arfx.run.job.build_report",
            lambda *_: (_ for _ in ()).throw(RenderError("the disk is full")),
        )
        process(config, Options(notice=quiet))
    out.write_bytes(b"somebody else's")
    with pytest.raises(ConfigError, match="exists"):
        process(config, Options(resume=True, notice=quiet))
    assert out.read_bytes() == b"somebody else's"


def test_a_job_that_ended_within_its_report_is_resumed(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, report = job(material, tmp_path), tmp_path / "report"

    def finish(folder: Path) -> None:
        report_of_job(folder, report)
        (report / "report.html").unlink()
        raise RenderError("the disk is full")

    with pytest.raises(RenderError):
        process(config, Options(report=report, finish=finish, notice=quiet))
    options = Options(
        report=report,
        resume=True,
        finish=lambda folder: report_of_job(folder, report),
        notice=quiet,
    )
    process(config, options)
    assert (report / "report.html").exists()


def test_what_appears_while_the_output_is_joined_is_not_replaced(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = job(material, tmp_path), tmp_path / "out.mp4"

    def remux(*given: Any) -> Any:
        out.write_bytes(b"somebody else's")
        return remuxed(*given)

    remuxed = join._remux
    monkeypatch.setattr(join, "_remux", remux)
    with pytest.raises(ConfigError, match="exists"):
        process(config, Options(notice=quiet))
    assert (
        out.read_bytes() == b"somebody else's"
        and [p.name for p in tmp_path.iterdir() if "part" in p.name] == []
    )


def write_rows(folder: Path, rows: list[dict[str, Any]], end: str = "") -> None:
    (folder / "timings.jsonl").write_text(
        "".join(json.dumps(row) + "\n" for row in rows) + end
    )


def test_times_of_kept_chunks_and_of_the_kept_analysis_count(
    material: Material, tmp_path: Path
) -> None:
    config, folder = job(material, tmp_path), tmp_path / "job"
    rows = interrupted(config, folder, "render", 20)
    assert [(r["work"], r.get("first")) for r in rows] == [
        ("stretch", 0),
        ("analysis", None),
        ("chunk", 0),
    ]
    rows = rows[1:]
    rows[0]["seconds"] = {"decode": 100.0, "analyse": 200.0}
    rows[1]["stages"]["raster"], rows[1]["seconds"]["encode"] = 1000.0, 400.0
    rows[1]["walls"] = dict.fromkeys(rows[1]["walls"], 5000.0)
    rows[1]["rss_mb"] = 7e6
    other = {**rows[1], "key": "of another setting"}  # made, but not in the output
    write_rows(
        folder, [rows[0], other, rows[1]], '{"work": "chunk", "ke'
    )  # and a line that a kill cut short
    report = process(config, Options(folder, resume=True, notice=quiet))
    timing = report["timing"]
    assert (
        timing["resumed"] is True
        and timing["processes"] == 2
        and timing["frames_untimed"] == 0
    )
    assert timing["analyse_s"] == 200 and 100 < timing["decode_s"] < 200
    assert 1000 < timing["render_s"] < 1500 and 400 < timing["encode_s"] < 600
    assert 5000 < timing["wall_s"] < 5500 and timing["frames_per_s"] == pytest.approx(
        FRAMES / timing["wall_s"]
    )
    assert timing["peak_rss_mb"] == 7e6
    raster = next(s for s in report["stages"] if s["name"] == "raster")
    assert 1000 < raster["measured_s"] < 1500


def test_time_of_the_stretches_that_are_there_counts(
    material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stretches, "LEAST_FRAMES", 20)
    clip = write_clip(
        tmp_path / "keys.mov", 60, codec="mjpeg", pixel_format="yuvj420p"
    )
    config, folder = job(replace(material, clip=clip), tmp_path), tmp_path / "job"
    rows = interrupted(config, folder, "analyse", 50)
    assert [(r["work"], r["first"], r["last"]) for r in rows] == [
        ("stretch", 0, 19),
        ("stretch", 20, 39),
    ]
    rows[0]["seconds"] = {"decode": 49.0, "analyse": 1000.0}
    rows[1]["walls"] = dict.fromkeys(rows[1]["walls"], 3000.0)
    other = {**rows[0], "key": "of another setting"}  # made, but not of this analysis
    write_rows(folder, [*rows, other])
    timing = process(config, Options(folder, resume=True, notice=quiet))["timing"]
    assert (
        timing["resumed"]
        and timing["processes"] == 2
        and timing["analyse_s"] > 1000
        and timing["decode_s"] > 49
    )
    assert (
        timing["decode_s"] + timing["analyse_s"] < 1300
        and 3000 < timing["wall_s"] < 3500
    )


def test_a_kept_chunk_whose_time_nobody_noted_is_said(
    material: Material, tmp_path: Path
) -> None:
    config, folder = job(material, tmp_path), tmp_path / "job"
    rows = interrupted(config, folder, "render", 20)
    write_rows(folder, rows[:1])
    assert (
        process(config, Options(folder, resume=True, notice=quiet))["timing"][
            "frames_untimed"
        ]
        == 15
    )


def test_a_job_that_starts_afresh_counts_its_own_time_alone(
    material: Material, tmp_path: Path, arfx: Run
) -> None:
    config, folder = job(material, tmp_path), tmp_path / "job"
    rows = interrupted(config, folder, "render", 20)
    rows[2]["stages"]["raster"] = 1000.0
    write_rows(folder, rows)
    timing = process(config, Options(folder, overwrite=True, notice=quiet))["timing"]
    assert (
        timing["resumed"] is False
        and timing["processes"] == 1
        and timing["render_s"] < 500
    )
    (tmp_path / "out.mp4").unlink()
    r = arfx(
        *material.arguments(
            "-o", str(tmp_path / "out.mp4"), "--job", "job", "--resume"
        )
    )
    assert r.code == 0 and "resumed" in r.err, r.err


def test_a_line_cut_short_does_not_spoil_the_next(tmp_path: Path) -> None:
    path = tmp_path / "timings.jsonl"
    path.write_text('{"work": "chunk", "key": "a", "sec')
    log = WorkLog(path)
    log.note("chunk", "b", {"decode": 1.0})
    assert [row.key for row in log.rows()] == ["b"]
