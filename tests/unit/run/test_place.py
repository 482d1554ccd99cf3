"""Where a job writes: never onto anything that it reads, and on no place that is not its own."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.config.load import load
from arfx.errors import (
    ArfxError,
    ConfigError,
    InputError,
    NothingToDoError,
    RenderError,
)
from arfx.run.folder import MARK, JobFolder
from arfx.run.inputs import Inputs, open_inputs
from arfx.run.lock import locked
from arfx.run.parameters import parameters
from arfx.run.place import PAGE_START, Places, files_read
from tests.clips import MARKER, write_camera, write_clip

KEY = "0123456789abcdef"
READ = [
    "clip.mp4", "camera.yaml", "map.toml", "poses.txt", "errors.json", "sky.hdr", "model.obj", "model.mtl", "wood.png",
    "job.toml", "depth/000000.png", "depth/000001.png", "poster.png",
]  # fmt: skip
OBJ = (
    "mtllib model.mtl\nusemtl wood\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt"
    " 0 1\n"
    + "".join(
        f"f {a}/1 {b}/2 {c}/3\n"
        for a, b, c in ((1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4))
    )
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of every kind that a job can read."""
    d = tmp_path_factory.mktemp("read")
    write_clip(d / "clip.mp4", 2)
    write_camera(d / "camera.yaml")
    place = 'position = ["0m", "0m", "0m"]'
    (d / "map.toml").write_text(
        f'[[marker]]\nspec = "{MARKER}"\n{place}\n[[marker]]\nspec ='
        f' "poster.png"\n{place}\n'
    )
    cv2.imwrite(
        str(d / "poster.png"),
        np.random.default_rng(0).integers(0, 256, (200, 240, 3), np.uint8),
    )
    (d / "poses.txt").write_text("0 0 0 0 0 0 1\n" * 2)
    (d / "errors.json").write_text('{"errors": {}, "source": "a test"}')
    cv2.imwrite(str(d / "sky.hdr"), np.ones((8, 16, 3), np.float32))
    (d / "model.obj").write_text(OBJ)
    (d / "model.mtl").write_text("newmtl wood\nmap_Kd wood.png\n")
    cv2.imwrite(str(d / "wood.png"), np.full((4, 4, 3), 90, np.uint8))
    (d / "depth").mkdir()
    for n in range(2):
        cv2.imwrite(
            str(d / "depth" / f"{n:06d}.png"), np.full((240, 320), 400, np.uint16)
        )
    (d / "job.toml").write_text(f"""
input = {{clip = "clip.mp4", camera = "camera.yaml", marker_map = "map.toml", poses = "poses.txt", depth = "depth"}}
marker = [{{spec = "{MARKER}"}}]
pattern = [{{spec = "poster.png:10cm"}}]
model = {{file = "model.obj", fit = "5cm"}}
pipeline = {{tradeoff = "errors.json"}}
light = {{environment = "sky.hdr"}}
""")
    return d


@pytest.fixture
def read(made: Path, tmp_path: Path) -> Iterator[Path]:
    """They, in a folder of the test's own; afterwards each must be what it was."""
    d = tmp_path / "read"
    shutil.copytree(made, d)
    yield d
    for name in READ:
        assert digest(d / name) == digest(made / name), f"{name} was changed"
    assert sorted(
        p.relative_to(d).as_posix() for p in d.rglob("*") if p.is_file()
    ) == sorted(READ)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def inputs(read: Path, out: Path) -> Inputs:
    return open_inputs(
        load(read / "job.toml", {"output": {"path": str(out)}}, parameters())
    )


def places(
    read: Path, out: Path, job: Path | None = None, report: Path | None = None
) -> Places:
    return Places(inputs(read, out), job, report, overwrite=True)


def snapshot(folder: Path) -> dict[str, object]:
    return {
        p.relative_to(folder).as_posix(): (
            p.is_symlink(),
            p.is_file() and p.read_bytes(),
        )
        for p in folder.rglob("*")
    }


def refused(at: Places, root: Path, says: str) -> None:
    before = snapshot(root)
    with pytest.raises(ConfigError, match=says), at.held(resume=False):
        pytest.fail("it was let in")
    assert snapshot(root) == before, "something was touched"


def test_every_file_that_a_job_reads_is_known(read: Path, tmp_path: Path) -> None:
    known = {p.resolve() for _, p in files_read(inputs(read, tmp_path / "o.mp4"))}
    assert known == {(read / name).resolve() for name in [*READ, "depth"]}


def test_a_model_of_the_same_name_in_another_folder_is_another(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in (tmp_path / "a", tmp_path / "b"):
        shutil.copytree(made, place)
        monkeypatch.chdir(place)
        known = {
            path.resolve()
            for _, path in files_read(inputs(Path(), tmp_path / "o.mp4"))
        }
        assert (place / "wood.png").resolve() in known


@pytest.mark.parametrize("name", READ)
@pytest.mark.parametrize("link", [os.link, os.symlink], ids=["hard", "soft"])
def test_no_written_file_is_an_input(
    read: Path, tmp_path: Path, name: str, link: Callable[[Path, Path], None]
) -> None:
    places_of = {
        "out.mp4": lambda p: places(read, p),
        "frames/000004.png": lambda p: places(read, p.with_name("%06d.png")),
        "frames/times.txt": lambda p: places(read, p.with_name("%04d.exr")),
        "rep/report.json": lambda p: places(
            read, tmp_path / "o.mp4", report=p.parent
        ),
        "rep/report.html": lambda p: places(
            read, tmp_path / "o.mp4", report=p.parent
        ),
        "job/timings.jsonl": lambda p: places(read, tmp_path / "o.mp4", job=p.parent),
    }
    for place, made_of in places_of.items():
        path = tmp_path / place
        path.parent.mkdir(exist_ok=True)
        link(read / name, path)
        (tmp_path / "job").mkdir(exist_ok=True)
        (tmp_path / "job" / "job.toml").write_text(MARK)
        refused(
            made_of(path), tmp_path, "also an input|could be lost|not a job folder"
        )
        path.unlink()


def test_outputs_onto_inputs_by_their_own_names(read: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    refused(places(read, read / "clip.mp4"), tmp_path, "also an input \\(clip\\)")
    refused(
        places(read, read / "depth" / "%06d.png"),
        tmp_path,
        "also an input \\(depth\\)",
    )
    refused(
        places(read, read / "depth" / "%06d.exr"),
        tmp_path,
        "also an input \\(depth\\)",
    )
    for job in (read, read / "depth", tmp_path, read / "clip.mp4"):
        refused(
            places(read, out, job=job),
            tmp_path,
            "could be lost|is a file|lies in the job folder",
        )
    refused(places(read, out, report=read / "clip.mp4"), tmp_path, "is a file")
    with places(read, read / "other%d.png", report=read).held(resume=False):
        pass


@pytest.mark.parametrize(
    ("out", "job", "report", "says"),
    [
        ("job/out.mp4", "job", None, "lies in the job folder"),
        ("job/chunks/out.mp4", "job", None, "lies in the job folder"),
        ("job/%06d.png", "job", None, "lies in the job folder"),
        ("out.mp4", "job", "job", "lies in the job folder"),
        ("out.mp4", None, "out.mp4.job", "lies in the job folder"),
        ("out.mp4", None, "out.mp4.job/report", "lies in the job folder"),
        ("out.mp4", "out.mp4.job/sub", None, "lies in the job folder"),
        ("no/such/out.mp4", None, None, "does not exist"),
        ("no/such/%06d.png", None, None, "does not exist"),
        ("x" * 252 + ".mp4", None, None, "too long"),
        ("x" * 248 + ".mp4", None, None, "too long"),
        ("%0" + "99d" + "x" * 160 + ".png", None, None, "too long"),
        ("out.mp4", "x" * 300, None, "too long"),
        ("out.mp4", None, "x" * 300, "too long"),
        ("out.mp4", "/".join(["d" * 100] * 39), None, "too long"),
    ],
)
def test_places_that_cannot_be_a_jobs(
    read: Path,
    tmp_path: Path,
    out: str,
    job: str | None,
    report: str | None,
    says: str,
) -> None:
    (tmp_path / "job" / "chunks").mkdir(parents=True)
    at = places(
        read, tmp_path / out, job and tmp_path / job, report and tmp_path / report
    )  # type: ignore[arg-type]
    refused(at, tmp_path, says)


@pytest.mark.parametrize(
    "held",
    [
        "notes.txt", "clip.mp4", "chunks/clip.mp4", "chunks/notes/a.txt", "previews/holiday.bmp", "previews/000001.bmp",
        "report.json", "facts.jsonl", "job.toml", "timings.jsonl.part", "joined.part/holiday.jpg", "0001.png", "lock",
        f"chunks/000000-000029.{KEY}.{KEY}/letter.txt",
    ],
)  # fmt: skip
@pytest.mark.parametrize("where", ["job", "out.mp4.job"])
def test_a_folder_that_is_no_jobs_is_left_alone(
    read: Path, tmp_path: Path, held: str, where: str
) -> None:
    """Names as a job writes them, too: nothing there says that a job did."""
    (tmp_path / where / held).parent.mkdir(parents=True)
    (tmp_path / where / held).write_text("mine")
    refused(
        places(read, tmp_path / "out.mp4", job=tmp_path / "job"),
        tmp_path,
        "not a job folder",
    )


@pytest.mark.parametrize(
    "held",
    [
        "notes.txt",
        "chunks/clip.mp4",
        "chunks/000000-000029.nut",
        "previews/a.bmp",
        "x/y.txt",
    ],
)
def test_what_is_in_a_jobs_folder_and_not_of_it_is_left_alone(
    read: Path, tmp_path: Path, held: str
) -> None:
    job = tmp_path / "job"
    (job / held).parent.mkdir(parents=True)
    (job / "job.toml").write_text(MARK)
    (job / held).write_text("mine")
    refused(places(read, tmp_path / "out.mp4", job=job), tmp_path, "not a job folder")


def test_links_in_a_jobs_folder_are_not_followed(read: Path, tmp_path: Path) -> None:
    job = tmp_path / "job"
    job.mkdir()
    (job / "job.toml").write_text(MARK)
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / f"000000-000029.{KEY}.nut").write_text("mine")
    (job / "chunks").symlink_to(tmp_path / "videos")
    refused(places(read, tmp_path / "out.mp4", job=job), tmp_path, "not a job folder")


@pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="this system has no pipes with names"
)
def test_a_pipe_in_place_of_the_job_file_is_not_waited_for(tmp_path: Path) -> None:
    job = JobFolder(tmp_path)
    os.mkfifo(job.job)
    with pytest.raises(ConfigError, match=r"job\.toml"):
        job.check_foreign_files()


def test_a_damaged_list_of_what_was_put_in_place_counts_as_none(
    tmp_path: Path,
) -> None:
    job = JobFolder(tmp_path)
    for text in ("", "[[1, 2, Infinity]]", "[[1, 2]]", "3", '[["a", 2, 3]]'):
        job.placed.write_text(text)
        assert (1, 2, 3) not in job.outputs()
    job.placed.write_text("[[1, 2, 3]]")
    assert job.outputs() == {(1, 2, 3)}


def test_what_a_job_wrote_is_cleared_and_nothing_else(tmp_path: Path) -> None:
    job = JobFolder(tmp_path / "job")
    images = (
        f"chunks/12-34-000030-000059.{KEY}.part/000031.png",
        f"chunks/000000-000029.{KEY}.{KEY}/times.txt",
    )
    for name in (
        "inputs.json", "facts.jsonl", "environment.maps", "report.json", f"chunks/000000-000029.{KEY}.{KEY}.nut", *images,
        "previews/000001.bmp", ".arfx-12-0a1b2c3d.part", "joined.part", "seal.json", "placed.json",
        f"stretches/000000-000124.{KEY}", "stretches/.arfx-12-0a1b2c3d.part",
    ):  # fmt: skip
        (job.path / name).parent.mkdir(parents=True, exist_ok=True)
        (job.path / name).write_text("x")
    job.job.write_text(MARK)
    job.check_foreign_files()
    job.clear("chunks")
    assert not job.chunks.exists() and job.facts.exists()
    (job.path / "late.txt").write_text("came while the job ran")
    job.clear()
    assert [p.name for p in job.path.iterdir()] == ["late.txt"]


@pytest.mark.parametrize(
    "error",
    [
        NothingToDoError("no marker"),
        ConfigError("no price"),
        InputError("no depth"),
        RenderError("full"),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_a_job_that_came_to_nothing_leaves_nothing(
    read: Path, tmp_path: Path, error: ArfxError, named: bool
) -> None:
    (tmp_path / "empty").mkdir()
    at = places(
        read,
        tmp_path / "out.mp4",
        tmp_path / "empty" if named else None,
        tmp_path / "rep",
    )
    with pytest.raises(type(error)), at.held(resume=False):
        (at.folder.path / "job.toml").write_text(MARK)
        at.folder.timings.write_text("{}")
        if not isinstance(error, RenderError):
            (at.folder.stretches / f"000000-000124.{KEY}").write_text(
                "leads to the same end"
            )
        raise error
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "empty",
        "read",
    ] and not list((tmp_path / "empty").iterdir())


def test_a_job_that_can_be_resumed_keeps_what_it_has(
    read: Path, tmp_path: Path
) -> None:
    at = places(read, tmp_path / "out.mp4")
    with pytest.raises(RenderError), at.held(resume=False):
        at.folder.job.write_text(MARK)
        kept = at.folder.stretches / f"000000-000124.{KEY}"
        kept.write_text("a stretch of the analysis")
        raise RenderError("the disk is full")
    assert kept.exists()
    with (
        pytest.raises(ConfigError, match="unfinished"),
        Places(inputs(read, tmp_path / "out.mp4"), None, None, False).held(False),
    ):
        pass
    with pytest.raises(ConfigError, match="budget"), at.held(resume=True):
        raise ConfigError("no such budget")
    with at.held(resume=True):
        assert kept.exists()
    assert not at.folder.path.exists()


def test_two_jobs_never_share_a_place(read: Path, tmp_path: Path) -> None:
    """One output, one job folder or one report for two of them: the second is told so, and
    touches nothing.
    """
    out, other, job, report = (
        tmp_path / n for n in ("out.mp4", "other.mp4", "job", "rep")
    )
    with places(read, out, job, report).held(resume=False):
        JobFolder(job).job.write_text(MARK)
        for second in (
            places(read, out), places(read, out, tmp_path / "job2"), places(read, other, job), places(read, other, None, report),
            places(read, other, tmp_path / "out.mp4.job"),
        ):  # fmt: skip
            refused(second, tmp_path, "in use by process")
            with (
                pytest.raises(ConfigError, match="in use by process"),
                second.held(resume=True),
            ):
                pass
        with places(read, other).held(resume=False):
            pass
    assert not (tmp_path / "out.mp4.job").exists() and job.exists()


def test_an_output_that_appears_meanwhile_is_not_replaced_unasked(
    read: Path, tmp_path: Path
) -> None:
    at = Places(inputs(read, tmp_path / "out.mp4"), None, None, overwrite=False)
    with pytest.raises(ConfigError, match="exists"), at.held(resume=False):
        (tmp_path / "out.mp4").write_text("somebody else's")
        at.check_output()


def test_reports_are_recognised(read: Path, tmp_path: Path) -> None:
    report = tmp_path / "rep"
    report.mkdir()
    (report / "report.html").write_text("<html>coverage of a test suite</html>")
    refused(
        places(read, tmp_path / "out.mp4", report=report),
        tmp_path,
        "not written by arfx",
    )
    (report / "report.html").write_text(PAGE_START + "…")
    (report / "report.json").write_text(
        json.dumps({"input": {"path": "clip.mp4"}}, indent=1)
    )
    with places(read, tmp_path / "out.mp4", report=report).held(resume=False):
        pass
    with locked(report, "-o"):
        refused(places(read, tmp_path / "out.mp4", report=report), tmp_path, "in use")
