"""A job folder that was damaged: --resume makes the damaged piece anew, or says in one
message what is wrong.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from arfx.analyse.tables import from_bytes
from arfx.config.load import load
from arfx.core.facts import read_facts
from arfx.errors import ArfxError, ConfigError, InputError, JobInterruptedError
from arfx.measure.report import report_of_job
from arfx.run import schedule
from arfx.run.folder import JobFolder
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.run.planned import MAPS
from tests.clips import MARKER, write_camera, write_clip, write_model

FRAMES, CHUNK = 8, 4  # two chunks: the first is kept, the second left to do


@pytest.fixture(scope="module", autouse=True)
def short_chunks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "SHORTEST", CHUNK)
        yield


def config(d: Path, out: Path, stages: tuple[str, ...] = ("lightmap",)):  # type: ignore[no-untyped-def]
    return load(None, {
        "input": {"clip": str(d / "clip.mp4"), "camera": str(d / "camera.yaml")}, "marker": [{"spec": str(MARKER)}],
        "model": {"file": str(d / "model.glb"), "fit": "4cm"}, "output": {"path": str(out)},
        "pipeline": {"stages": list(stages), "quality": "draft"},
    }, parameters())  # fmt: skip


def run(
    d: Path,
    out: Path,
    folder: Path,
    stop: Callable[[str, int], bool] = lambda *_: False,
    resume: bool = True,
) -> dict:
    def progress(phase: str, done: int, _: int | None) -> None:
        if stop(phase, done):
            raise KeyboardInterrupt

    options = Options(folder, resume=resume, progress=progress, notice=lambda _: None)
    return process(config(d, out), options)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip; `job`: its job stopped in the second chunk; `early`: stopped in the analysis;
    `finished`; `sha`: of the output.
    """
    d = tmp_path_factory.mktemp("damaged")
    write_clip(d / "clip.mp4", FRAMES)
    write_camera(d / "camera.yaml")
    write_model(d / "model.glb")
    run(d, d / "whole.mp4", d / "finished", resume=False)
    with pytest.raises(JobInterruptedError):
        run(
            d,
            d / "out.mp4",
            d / "job",
            lambda phase, n: phase == "render" and n > CHUNK,
            resume=False,
        )
    assert len(list((d / "job" / "chunks").glob("*.nut"))) == 1
    with pytest.raises(JobInterruptedError):
        told = (
            itertools.count()
        )  # of all frames twice: when the last is analysed, and when they are joined
        run(
            d,
            d / "out.mp4",
            d / "early",
            lambda phase, n: phase == "analyse" and n == FRAMES and next(told) > 0,
            resume=False,
        )
    assert len(list((d / "early" / "stretches").iterdir())) == 1
    return d


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def changed_number(data: bytes) -> bytes:
    """Still of the same form: a digit in the middle is another one."""
    at = next(
        i for i in range(len(data) // 2, len(data)) if data[i : i + 1].isdigit()
    )
    return data[:at] + (b"7" if data[at : at + 1] != b"7" else b"3") + data[at + 1 :]


WAYS: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda b: b"",
    "cut": lambda b: b[: len(b) // 2],
    "digit": changed_number,
    "other": lambda b: b'{"key": 1, "job_key": [], "files": 3}\n' * 3,
    "bytes": lambda b: b"\xff\xfe\x00" + b[3:],
    "deep": lambda b: b"[" * 100_000,
}
FILES = [
    "inputs.json", "frames.json", "facts.jsonl", "plan.jsonl", "plan_summary.json", "seal.json", "timings.jsonl", "report.json",
    "chunks/*.nut", "previews/*.bmp", "job.toml",
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "way"),
    [
        *((name, "digit") for name in FILES),
        ("environment.maps", "cut"),
        *(("all", way) for way in WAYS),
    ],
)
def test_a_damaged_piece_is_made_anew(
    done: Path, tmp_path: Path, name: str, way: str
) -> None:
    job, out = tmp_path / "job", done / "out.mp4"
    shutil.copytree(done / "job", job)
    for each in FILES[:-1] if name == "all" else [name]:
        path = next(job.glob(each), job / each)
        path.write_bytes(
            WAYS[way](path.read_bytes() if path.exists() else b"x1" * 99)
        )
    report = run(done, out, job)
    assert (
        sha(out) == sha(done / "whole.mp4") and report["output"]["frames"] == FRAMES
    )
    out.unlink()


def test_maps_of_the_surroundings_are_kept_beside_the_facts_and_made_anew(
    done: Path, tmp_path: Path
) -> None:
    given, job = (
        config(done, tmp_path / "out.mp4", ("lightmap", "gi")),
        JobFolder(tmp_path / "job"),
    )
    process(given, Options(job.path, notice=lambda _: None))
    maps = from_bytes(job.environment.read_bytes())[MAPS]
    seen = [f.seen_environment for f in read_facts(job.facts)]
    assert {name for s in seen if s for name in s.maps} == set(maps) != set()
    assert job.facts.stat().st_size < 50_000 * FRAMES
    first, kept = sha(tmp_path / "out.mp4"), job.environment.read_bytes()
    job.environment.unlink()
    process(
        given, Options(job.path, resume=True, overwrite=True, notice=lambda _: None)
    )
    assert (sha(tmp_path / "out.mp4"), job.environment.read_bytes()) == (first, kept)


def test_a_folder_whose_job_file_lost_its_head_is_nobodys(
    done: Path, tmp_path: Path
) -> None:
    shutil.copytree(done / "job", tmp_path / "job")
    (tmp_path / "job" / "job.toml").write_text("")
    with pytest.raises(ConfigError, match="not a job folder"):
        run(done, done / "out.mp4", tmp_path / "job")
    assert (tmp_path / "job" / "facts.jsonl").exists()


def test_missing_pieces_are_made_anew(done: Path, tmp_path: Path) -> None:
    job, out = tmp_path / "job", done / "out.mp4"
    shutil.copytree(done / "job", job)
    for name in ("inputs.json", "facts.jsonl", "plan_summary.json", "timings.jsonl"):
        (job / name).unlink()
    shutil.rmtree(job / "previews")
    run(done, out, job)
    assert sha(out) == sha(done / "whole.mp4")
    out.unlink()


@pytest.mark.parametrize("way", ["cut", "digit", "other"])
def test_a_damaged_stretch_is_not_taken_up(
    done: Path, tmp_path: Path, way: str
) -> None:
    job, out = tmp_path / "job", done / "out.mp4"
    shutil.copytree(done / "early", job)
    (path,) = (job / "stretches").iterdir()
    path.write_bytes(WAYS[way](path.read_bytes()))
    run(done, out, job)
    assert sha(out) == sha(done / "whole.mp4")
    out.unlink()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "name", ["report.json", "facts.jsonl", "frames.json", "inputs.json", "job.toml"]
)
def test_the_report_of_a_damaged_job_is_a_report_or_a_message(
    done: Path, tmp_path: Path, name: str, way: str
) -> None:
    shutil.copytree(done / "finished", tmp_path / "job")
    path = tmp_path / "job" / name
    path.write_bytes(WAYS[way](path.read_bytes()))
    try:
        assert report_of_job(tmp_path / "job", tmp_path / "rep").exists()
    except ArfxError as e:
        assert (
            isinstance(e, InputError)
            and str(tmp_path / "job") in e.message
            and not (tmp_path / "rep").exists()
        )


def test_reports_whose_numbers_are_of_another_kind(
    done: Path, tmp_path: Path
) -> None:
    shutil.copytree(done / "finished", tmp_path / "job")
    path = tmp_path / "job" / "report.json"
    report = json.loads(path.read_text())
    for section, wrong in zip(
        report,
        itertools.cycle(("three", None, {"lights": 3, "levels": 1}, [7], 3)),
        strict=False,
    ):
        path.write_text(json.dumps({**report, section: wrong}))
        try:
            report_of_job(tmp_path / "job", tmp_path / "rep")
        except ArfxError as e:
            assert isinstance(e, InputError), (section, wrong, e)
