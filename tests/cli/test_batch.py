"""`arfx batch` as a user runs it: several clips, one of them broken, tables, what is
resumed and what is refused.
"""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from arfx.run import job as job_module
from tests.cli.conftest import Material, Run, at_a_moment
from tests.clips import MARKER, write_clip

FRAMES = 12
NAMES = [
    ".arfx-batch.jsonl",
    "batch.html",
    "batch.json",
    "one.mp4",
    "three.mp4",
]  # of a batch whose third clip is broken


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("short") / "clip.mp4", FRAMES)


@pytest.fixture
def shots(short: Path, tmp_path: Path) -> Path:
    """one.mp4 and three.mp4 whole, two.mp4 cut short, and files that are no clips."""
    folder = tmp_path / "shots"
    folder.mkdir()
    for name in ("one.mp4", "three.mp4", ".hidden.mp4"):
        shutil.copy(short, folder / name)
    (folder / "two.mp4").write_bytes(short.read_bytes()[:2000])
    for name in ("notes.txt", "camera.yaml", "one.mp4.md5", "list.csv"):
        (folder / name).write_text("no clip")
    return folder


def command(material: Material, *more: str) -> list[str]:
    options = [
        "--camera",
        str(material.camera),
        "--marker",
        str(MARKER),
        "--model",
        str(material.model),
        "--fit",
        "8cm",
    ]
    return ["batch", *options, *more]


def test_one_that_fails_does_not_stop_the_others(
    material: Material, arfx: Run, shots: Path, tmp_path: Path
) -> None:
    arguments = command(
        material, "shots", "-o", "out/{stem}.mp4", "--report", "report"
    )
    r = arfx(*arguments, "--json")
    assert r.code == 6, r.err
    assert r.json["failed"] == 1
    rows = {Path(job["clip"]).name: job for job in r.json["jobs"]}
    assert [(name, job["exit_code"]) for name, job in rows.items()] == [
        ("one.mp4", 0),
        ("three.mp4", 0),
        ("two.mp4", 3),
    ]
    assert all(
        set(job) == {"clip", "output", "exit_code", "message", "seconds", "report"}
        for job in rows.values()
    )
    assert (
        "\n" not in rows["two.mp4"]["message"]
        and "two.mp4" in rows["two.mp4"]["message"]
    )
    assert json.loads((tmp_path / "report/batch.json").read_text()) == r.json
    assert (
        "2 of 3 shots/three.mp4: render" in r.err
        and "3 of 3 shots/two.mp4: error:" in r.err
    )
    made = sorted(
        str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").iterdir()
    )
    assert made == [
        ".arfx-batch.jsonl",
        "one.mp4",
        "three.mp4",
    ], "no job folder, no empty folder is left"
    page = (tmp_path / "report/batch.html").read_text()
    assert (
        'href="one/report.html"' in page
        and 'href="../out/one.mp4"' in page
        and page.count('class="thumbnail"') == 2
    )
    assert (tmp_path / "report/one/report.html").exists() and rows["one.mp4"][
        "report"
    ] == "report/one/report.html"

    again = arfx(*arguments)
    assert (
        again.code == 2
        and "2 of 3 outputs exist already" in again.err
        and "--resume" in again.err
    )
    before = (tmp_path / "out/one.mp4").stat().st_mtime_ns
    shutil.copy(shots / "one.mp4", shots / "two.mp4")
    resumed = arfx(*arguments, "--resume", "--json")
    assert resumed.code == 0, resumed.err
    assert [job["message"] for job in resumed.json["jobs"]] == [
        f"{FRAMES} frames, done before"
    ] * 2 + [f"{FRAMES} frames"]
    assert resumed.json["jobs"][0] == {
        **rows["one.mp4"],
        "message": f"{FRAMES} frames, done before",
    } | {"seconds": resumed.json["jobs"][0]["seconds"]}
    assert (tmp_path / "out/one.mp4").stat().st_mtime_ns == before

    changed = arfx(*arguments, "--resume", "--fit", "7cm", "--json")
    assert changed.code == 6 and changed.json["failed"] == 3
    assert (
        "under other settings" in changed.json["jobs"][0]["message"]
        and "--overwrite" in changed.json["jobs"][0]["message"]
    )
    (tmp_path / "out/three.mp4").write_bytes(b"somebody else's")
    foreign = arfx(*arguments, "--resume", "--json")
    assert [job["exit_code"] for job in foreign.json["jobs"]] == [
        0,
        2,
        0,
    ] and "exists" in foreign.json["jobs"][1]["message"]
    assert (tmp_path / "out/three.mp4").read_bytes() == b"somebody else's"


def test_a_table_with_settings_of_its_own(
    material: Material, arfx: Run, short: Path, tmp_path: Path
) -> None:
    """Names with spaces and beyond ASCII, paths from the manifest's folder, and each job
    its own settings.
    """
    folder = tmp_path / "a job ü"
    (folder / "clips").mkdir(parents=True)
    shutil.copy(short, folder / "clips" / "день 1.mp4")
    (folder / "m.csv").write_text(
        "clip,output,end,light.most_lights\nclips/день 1.mp4,,0.1,1\nclips/день"
        " 1.mp4,other/x y.mkv,0.2,\n",
        encoding="utf-8",
    )
    r = arfx(
        *command(
            material,
            str(folder / "m.csv"),
            "-o",
            "out/{parent} {stem}.mp4",
            "--json",
            "--job",
            "jobs",
        )
    )
    assert r.code == 0, r.err
    first, second = r.json["jobs"]
    assert (
        first["output"] == "out/clips день 1.mp4"
        and (tmp_path / first["output"]).exists()
    ), "-o counts from here"
    assert (
        Path(second["output"]) == folder / "other/x y.mkv"
        and Path(second["output"]).exists()
    )
    assert (first["message"], second["message"]) == ("4 frames", "7 frames")
    kept = sorted(
        str(p.parent.relative_to(tmp_path / "jobs"))
        for p in (tmp_path / "jobs").rglob("job.toml")
    )
    assert kept == ["a job ü/other/x y", "out/clips день 1"]
    text = (tmp_path / "jobs/out/clips день 1/job.toml").read_text(encoding="utf-8")
    assert "most_lights = 1" in text


def test_a_plan_of_all(
    material: Material, arfx: Run, shots: Path, tmp_path: Path
) -> None:
    arguments = command(material, "shots/*", "-o", "out/{stem}/%04d.png", "--dry-run")
    r = arfx(*arguments, "--json")
    assert r.code == 6 and r.json["failed"] == 1, r.err
    plans = [job["plan"] for job in r.json["jobs"] if job["exit_code"] == 0]
    assert [p["frames"] for p in plans] == [FRAMES] * 2 and {
        s["name"] for s in plans[0]["stages"]
    } >= {"raster", "composite"}
    assert r.json["predicted"]["s"] == pytest.approx(
        sum(p["predicted"]["wall"]["s"] for p in plans)
    )
    assert not (tmp_path / "out").exists() and sorted(
        p.name for p in tmp_path.iterdir()
    ) == ["shots"]
    table = arfx(*arguments, "-q").out
    assert "nine times in ten" in table and "all" in table and "exit 3" in table


@pytest.mark.process
@pytest.mark.usefixtures("ctrl_c")
def test_a_stopped_batch_says_what_is_done(
    material: Material,
    arfx: Run,
    shots: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(job: Any, *more: Any) -> Any:
        if job.inputs.info.path.name == "three.mp4":
            signal.raise_signal(signal.SIGTERM)
        return render(job, *more)

    render = job_module._render
    monkeypatch.setattr(job_module, "_render", stop)
    arguments = command(material, "shots", "-o", "out/{stem}.mp4", "--end", "0.1")
    r = arfx(*arguments)
    assert (
        r.code == 143
        and "stopped by SIGTERM at clip 2 of 3, shots/three.mp4" in r.err
        and "--resume" in r.err
    ), r.err
    document = json.loads((tmp_path / "out/batch.json").read_text())
    assert [job["exit_code"] for job in document["jobs"]] == [0, 143] and document[
        "failed"
    ] == 1
    page = (tmp_path / "out/batch.html").read_text()
    assert "1 of 3" in page and "not begun" in page
    assert (tmp_path / "out/one.mp4").exists() and (
        tmp_path / "out/three.mp4.job/seal.json"
    ).exists()
    monkeypatch.setattr(job_module, "_render", render)
    assert arfx(*arguments).code == 2
    resumed = arfx(*arguments, "--resume", "--json")
    assert resumed.code == 6 and [job["message"] for job in resumed.json["jobs"]][
        :2
    ] == [
        "4 frames, done before",
        "4 frames",
    ]
    assert "three.mp4: analyse" not in resumed.err, "the analysis was whole"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == NAMES


@pytest.mark.process
def test_a_killed_batch_does_the_rest(
    material: Material, arfx: Run, shots: Path, tmp_path: Path
) -> None:
    arguments = command(
        material, "shots", "-o", "out/{stem}.mp4", "--end", "0.1", "--workers", "1"
    )
    p = at_a_moment(tmp_path, "analyse", 8, signal.SIGKILL, arguments)
    assert (
        p.returncode == -signal.SIGKILL
        and (tmp_path / "out/one.mp4").exists()
        and not (tmp_path / "out/three.mp4").exists()
    )
    r = arfx(*arguments, "--resume", "--json")
    assert r.code == 6 and [job["message"] for job in r.json["jobs"]][:2] == [
        "4 frames, done before",
        "4 frames",
    ], r.err
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == NAMES


def test_what_is_wrong_is_refused_before_any_work(
    material: Material, arfx: Run, shots: Path, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    shutil.copy(shots / "one.mp4", tmp_path / "other/one.mp4")
    (tmp_path / "m.toml").write_text(
        "[[job]]\nclip = 'shots/one.mp4'\nfitt = '1cm'\n"
    )
    for arguments, parts in {
        ("empty", "-o", "out/{stem}.mp4"): ["no clip is in empty", ".mp4"],
        ("shots/*.avi", "-o", "out/{stem}.mp4"): ["no clip is in shots/*.avi"],
        ("shots",): ["no output is named", "{stem}"],
        ("shots", "-o", "out/x.mp4"): [
            "shots/one.mp4 and shots/three.mp4 go to one output",
            "{stem}",
        ],
        ("shots", "other", "-o", "out/{stem}.mp4"): [
            "shots/one.mp4 and other/one.mp4 go to one output",
            "{parent}",
        ],
        ("shots", "-o", "out/{stem}_%04d.png"): ["go to one output, out"],
        ("shots", "-o", "out/{clip}.mp4"): ["there is no field {clip}", "{parent}"],
        ("shots", "-o", "shots/{stem}.mp4"): ["shots/one.mp4 is also an input"],
        ("shots", "-o", "out/{stem}.gif"): ["unknown output format '.gif'"],
        ("shots", "-o", "out/{stem}.mp4", "--model", "none.glb"): [
            "model none.glb: no such file"
        ],
        ("shots", "-o", "out/{stem}.mp4", "--camera", "none.yaml"): [
            "none.yaml: no such file"
        ],
        ("shots", "-o", "out/{stem}.mp4", "--budget", "9s", "--fps", "3"): [
            "both choose levels"
        ],
        ("m.toml", "-o", "out/{stem}.mp4"): [
            "no setting 'fitt'",
            "m.toml:3",
            "did you mean 'fit'",
        ],
    }.items():
        r = arfx(*command(material, *arguments))
        assert r.code in (2, 3) and all(part in r.err for part in parts), (
            arguments,
            r.err,
        )
        assert "analyse" not in r.err and "Traceback" not in r.err
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "empty",
        "m.toml",
        "other",
        "shots",
    ]
    no_marker = arfx(
        "batch", "shots", "-o", "out/{stem}.mp4", "--model", str(material.model)
    )
    assert no_marker.code == 2 and no_marker.err.count("no marker is named") == 1, (
        "once, not for every clip"
    )


def test_outputs_beside_the_clips_are_no_clips(
    material: Material, arfx: Run, shots: Path, tmp_path: Path
) -> None:
    """Red without the record of what batches made: the outputs of the first run would be
    clips of the second.
    """
    (shots / "two.mp4").unlink()
    arguments = command(
        material, "shots", "-o", "shots/{stem}_ar.mp4", "--end", "0.1"
    )
    assert arfx(*arguments).code == 0
    r = arfx(*arguments, "--resume", "--json")
    assert r.code == 0 and [Path(job["clip"]).name for job in r.json["jobs"]] == [
        "one.mp4",
        "three.mp4",
    ]
    assert all("done before" in job["message"] for job in r.json["jobs"])


def test_every_option_of_process_is_there() -> None:
    from arfx_cli import batch, process

    def names(command: object) -> set[str]:
        return {parameter.name for parameter in command.params}  # type: ignore[attr-defined]

    assert names(process.command) - names(batch.command) == {"clip"}
    assert names(batch.command) - names(process.command) == {"inputs", "dry_run"}
