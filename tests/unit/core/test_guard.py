"""The guard over written places: no input, nothing unasked, every name of a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from arfx.core.guard import Guard, atomic_write, check_file_name
from arfx.errors import ConfigError
from arfx.media.output import image_names

Alias = Callable[[Path, Path], object]


def symlink(path: Path, to: Path) -> None:
    path.symlink_to(to)


def hard_link(path: Path, to: Path) -> None:
    os.link(to, path)


def around(path: Path, to: Path) -> None:
    (to.parent / "sub").mkdir()
    path.unlink(missing_ok=True)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "clip.mp4"
    path.parent.mkdir()
    path.write_bytes(b"frames")
    return path


@pytest.mark.parametrize("alias", [symlink, hard_link])
@pytest.mark.parametrize("turned", [False, True], ids=["output", "input"])
def test_an_input_is_known_under_every_name(
    clip: Path, tmp_path: Path, alias: Alias, turned: bool
) -> None:
    other = tmp_path / "other.mp4"
    alias(other, clip)
    read, written = (other, clip) if turned else (clip, other)
    with pytest.raises(ConfigError, match=r"also an input \(clip\)"):
        Guard([("clip", read)], overwrite=True).file(written)
    assert clip.read_bytes() == b"frames"


def test_other_ways_to_write_a_path_are_the_same_file(
    clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(clip.parent)
    (clip.parent / "sub").mkdir()
    for name in (
        "clip.mp4",
        "./sub/../clip.mp4",
        str(clip),
        f"../{clip.parent.name}/clip.mp4",
    ):
        with pytest.raises(ConfigError, match="also an input"):
            Guard([("clip", Path("clip.mp4"))], overwrite=True).file(Path(name))


def test_a_file_known_by_its_identity_alone_is_the_same_file(
    clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that takes Clip.mp4 and clip.mp4 for one file."""
    stat = Path.stat
    monkeypatch.setattr(
        Path,
        "stat",
        lambda p, **k: stat(p.with_name(p.name.lower()) if p.suffix else p, **k),
    )
    with pytest.raises(ConfigError, match="also an input"):
        Guard([("clip", clip)], overwrite=True).file(clip.with_name("CLIP.MP4"))


def test_what_stands_there_is_replaced_only_when_asked(tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    Guard(()).file(out)
    out.symlink_to(
        tmp_path / "nowhere"
    )  # a link that leads to nothing is something too
    with pytest.raises(ConfigError, match="exists"):
        Guard(()).file(out)
    Guard((), True).file(out)
    (tmp_path / "folder.mp4").mkdir()
    os.mkfifo(tmp_path / "pipe.mp4")
    for name in ("folder.mp4", "pipe.mp4"):
        with pytest.raises(ConfigError, match="not a file"):
            Guard((), True).file(tmp_path / name)
    with pytest.raises(ConfigError, match="does not exist"):
        Guard((), True).file(tmp_path / "none" / "out.mp4")


def test_a_file_of_somebody_else_is_not_replaced_even_when_asked(
    tmp_path: Path,
) -> None:
    report = tmp_path / "report.html"
    report.write_text("<html>of other tests")
    with pytest.raises(ConfigError, match="not written by arfx"):
        Guard((), True).files(tmp_path, {"report.html": b"<!doctype html>"})
    report.write_text("<!doctype html> ours")
    Guard((), True).files(tmp_path, {"report.html": b"<!doctype html>"})


def test_images_never_fall_on_an_input(tmp_path: Path) -> None:
    named = image_names("%06d.png")
    texture = tmp_path / "000007.png"
    texture.touch()
    with pytest.raises(ConfigError, match="also an input \\(file of the model\\)"):
        Guard([("file of the model", texture)], True).images(tmp_path, ".png", named)
    Guard([("file of the model", tmp_path / "wood.png")], True).images(
        tmp_path, ".png", named
    )
    with pytest.raises(ConfigError, match="also an input \\(depth\\)"):
        Guard([("depth", tmp_path)], True).images(
            tmp_path, ".exr", image_names("%06d.exr")
        )
    with pytest.raises(ConfigError, match="exists"):
        Guard(()).images(tmp_path, ".png", named)


@pytest.mark.parametrize("name", ["times.txt", "old.png", "000001.png", "OLD.PNG"])
def test_images_replace_nothing_unasked(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(ConfigError, match=f"{name} exists"):
        Guard(()).images(tmp_path, ".png", image_names("%06d.png"))
    Guard((), True).images(tmp_path, ".png", image_names("%06d.png"))


def test_a_folder_of_our_own_holds_no_input(clip: Path, tmp_path: Path) -> None:
    for folder in (clip.parent, tmp_path):
        with pytest.raises(ConfigError, match="could be lost"):
            Guard([("clip", clip)], True).folder(folder, "--job")
    Guard([("clip", clip)], True).folder(tmp_path / "job", "--job")
    Guard([("clip", clip)], True).folder(
        tmp_path / "i", "--job"
    )  # the beginning of a name is not a folder


@pytest.mark.parametrize(
    "name",
    [
        "x" * 300 + ".mp4",
        "é" * 140 + ".mp4",
        "a\0b.mp4",
        "/".join(["d" * 200] * 30) + "/o.mp4",
    ],
)
def test_a_name_that_the_system_does_not_take_is_said(
    tmp_path: Path, name: str
) -> None:
    with pytest.raises(ConfigError, match=r"too long|cannot be a file's name") as e:
        check_file_name(tmp_path / name)
    assert len(str(e.value)) < 400


def test_aside_leaves_all_of_a_file_or_nothing(tmp_path: Path) -> None:
    out = tmp_path / ("n" * 250)
    with atomic_write(out) as part:
        part.write_text("whole")
    with pytest.raises(ZeroDivisionError), atomic_write(out) as part:
        part.write_text("half")
        1 / 0  # noqa: B018
    assert out.read_text() == "whole" and len(list(tmp_path.iterdir())) == 1


def test_names_of_images() -> None:
    named = image_names("a%%_%04d.png")
    assert named("a%_0001.png") and named("a%_12345.png")
    assert (
        not named("a%_1.png")
        and not named("a%_00001.png")
        and not named("a%%_0001.png")
        and not named("b_0001.png")
    )
    assert image_names("%4d.png")("  12.png")
    assert image_names("a%04d.png")("A0001.PNG"), "the same file on many disks"
