"""Which clips a batch has."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx.config.load import load
from arfx.errors import ConfigError, InputError
from arfx.run.batch_jobs import BatchJob, batch_jobs, clips_at, home_of, names_of
from arfx.run.folder import MARK
from arfx.run.parameters import parameters


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


def jobs(*inputs: object, pattern: str | None = "out/{stem}.mp4") -> list[BatchJob]:
    return batch_jobs(
        [str(i) for i in inputs],
        lambda files: load(files, {}, parameters()),
        None if pattern is None else Path(pattern),
    )


def test_a_folder_stands_for_its_videos(tmp_path: Path) -> None:
    touch(
        tmp_path,
        "b.MOV",
        "a.mp4",
        "c.mkv",
        ".a.mp4",
        "._b.MOV",
        "a.mp4.txt",
        "x.png",
        "sub/d.mp4",
        "e.mp4/f.mp4",
    )
    assert [p.name for p in clips_at(str(tmp_path))] == ["a.mp4", "b.MOV", "c.mkv"]
    assert [p.name for p in clips_at(f"{tmp_path}/**/*.mp4")] == [
        "a.mp4",
        "f.mp4",
        "d.mp4",
    ]
    touch(tmp_path, "one[1].mp4", "one1.mp4")
    assert clips_at(str(tmp_path / "one[1].mp4")) == [tmp_path / "one[1].mp4"], (
        "a name that is there is no pattern"
    )


def test_chunks_of_an_unfinished_job_are_no_clips(tmp_path: Path) -> None:
    touch(tmp_path, "a.mp4", "a.mkv.job/chunks/000000-000029.0.nut")
    (tmp_path / "a.mkv.job/job.toml").write_text(MARK)
    assert [p.name for p in clips_at(f"{tmp_path}/**/*")] == ["a.mp4"]


def test_a_clip_named_twice_is_one(tmp_path: Path) -> None:
    touch(tmp_path, "a.mp4", "b.mp4")
    assert [
        j.clip.name for j in jobs(tmp_path / "b.mp4", tmp_path, f"{tmp_path}/*")
    ] == [
        "b.mp4",
        "a.mp4",
    ]


def test_an_output_of_its_own_comes_before_the_pattern(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("clip,output\na.mp4,x/{stem}.mkv\nb.mp4,\n")
    assert [j.output for j in jobs(tmp_path / "m.csv")] == [
        tmp_path / "x/a.mkv",
        Path("out/b.mp4"),
    ]
    with pytest.raises(ConfigError, match="no output is named"):
        jobs(tmp_path / "m.csv", pattern=None)


def test_nothing_found_is_one_message(tmp_path: Path) -> None:
    touch(tmp_path, "notes.txt")
    with pytest.raises(InputError, match="no clip is in"):
        jobs(tmp_path)


def test_names_of_reports_are_distinct(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text(
        "clip,output\na,o/a.mp4\na,o/a.mkv\na,o/p/c.mp4\na,o/f/%04d.png\n"
    )
    found = jobs(tmp_path / "m.csv")
    assert home_of(found) == tmp_path / "o"
    assert [str(names_of(found)[j]) for j in found] == ["a.mp4", "a.mkv", "p/c", "f"]


def test_the_folder_of_all_outputs_does_not_change_with_the_clips(
    tmp_path: Path,
) -> None:
    """Red with the outputs' own folders: of one clip it would be out/a."""
    touch(tmp_path, "a.mp4", "b.mp4")
    pattern = str(tmp_path / "out/{stem}/x.mp4")
    assert (
        home_of(jobs(tmp_path / "a.mp4", pattern=pattern))
        == home_of(jobs(tmp_path, pattern=pattern))
        == tmp_path / "out"
    )
    images = str(tmp_path / "out/{stem}/%04d.png")
    assert home_of(jobs(tmp_path / "a.mp4", pattern=images)) == tmp_path / "out"


def test_a_folder_that_links_to_itself_gives_each_clip_once(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").touch()
    (tmp_path / "loop").symlink_to(".")
    assert (
        clips_at(f"{tmp_path}/**/*.mp4")
        == [tmp_path / "a.mp4"]
        == clips_at(str(tmp_path))
    )
