"""The door for files from outside: what it lets in and what it says to the rest."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from arfx.core.opener import (
    LIMITS,
    MIB,
    ffmpeg_url,
    folder_entries,
    parse_json,
    parse_toml,
    read_bytes,
    read_text,
    regular,
)
from arfx.errors import InputError
from arfx.media.cameras import load_camera
from arfx.media.depth_maps import open_depth


def test_devices_pipes_sockets_and_folders_are_refused_unopened(
    tmp_path: Path,
) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as s:
        here = Path.cwd()
        os.chdir(tmp_path)  # a socket's path is short
        try:
            s.bind("sock")
        finally:
            os.chdir(here)
    (tmp_path / "link").symlink_to("/dev/zero")
    for name in ("pipe", "sock", "link"):
        with pytest.raises(InputError, match="not a regular file"):
            read_bytes(tmp_path / name, "camera file")
    with pytest.raises(InputError, match="is a folder"):
        regular(tmp_path, "clip")
    with pytest.raises(InputError, match="no such file"):
        regular(tmp_path / "none", "clip")
    with pytest.raises(InputError, match="cannot be read"):
        regular("a\0b", "clip")


def test_a_file_above_its_kinds_limit_is_refused_without_reading_it(
    tmp_path: Path,
) -> None:
    with (tmp_path / "a.yaml").open("wb") as f:
        f.truncate(int(LIMITS["camera file"] * MIB) + 1)
    with pytest.raises(InputError, match=r"more than 0\.25 MiB"):
        read_bytes(tmp_path / "a.yaml", "camera file")


def test_text_comes_without_byte_order_mark_and_only_as_utf_8(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfone\r\ntwo")
    assert read_text(tmp_path / "a", "job file") == "one\ntwo"
    (tmp_path / "a").write_bytes(b"ab\xff")
    with pytest.raises(InputError, match="byte 2 is not UTF-8"):
        read_text(tmp_path / "a", "job file")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = " + "1" * 5000, "64 bits"),
        ("x = " + "1" * 30, "64 bits"),
        ("x = " + "[" * 3000, "deeper"),
        ("x = " + "[" * 100 + "]" * 100, "deeper"),
        (".".join(["a"] * 100_000) + " = 1", "64 parts"),
        ("x = 1\nx = 2", "overwrite"),
        ("x" * 900_000, "Expected"),
    ],
)
def test_toml_that_would_overflow_says_so(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_toml(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1" * 5000, "64 bits"),
        ("[" * 100_000, "deeper"),
        ('{"a":' * 100 + "1" + "}" * 100, "deeper"),
        ("[NaN]", "NaN"),
        ("{", "Expecting"),
    ],
)
def test_json_that_would_overflow_says_so(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_json(text)


def test_plain_toml_and_json_are_read() -> None:
    assert parse_toml("a.b = [1, 2.5]") == {"a": {"b": [1, 2.5]}}
    assert parse_json('{"a": [1, -2.5e3, null]}') == {"a": [1, -2500.0, None]}


def test_ffmpeg_is_told_names_not_protocols() -> None:
    assert ffmpeg_url("12:30.mp4") == "file:12:30.mp4"


def test_every_limit_is_documented() -> None:
    text = (Path(__file__).parents[3] / "docs" / "limits.md").read_text()
    for kind, mib in LIMITS.items():
        words = kind.removesuffix(" part")
        assert any(
            words in line and (f"{mib:g} MiB" in line or mib == 1 << 24)
            for line in text.splitlines()
        ), kind


@pytest.mark.parametrize(
    "name", ["n" * 300, "a\0b", "nowhere", "n" * 300 + ".yaml#cam1"]
)
def test_a_name_that_cannot_be_looked_up_is_one_message(
    tmp_path: Path, name: str
) -> None:
    for opened in (load_camera, open_depth):
        with pytest.raises(InputError, match=r"camera file|depth"):
            opened(tmp_path / name)


def test_a_folder_is_listed_without_what_is_hidden_or_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b.png", "a.png", "._a.png"):
        (tmp_path / name).touch()
    assert [p.name for p in folder_entries(tmp_path)] == ["a.png", "b.png"]

    def refused(path: Path) -> list[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refused)
    with pytest.raises(
        InputError, match=r"folder .* cannot be read: Permission denied"
    ):
        folder_entries(tmp_path)


def test_memory_is_asked_for_by_the_files_size(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    (tmp_path / "a.json").write_bytes(b"1" * 3000)
    with Path("/proc/self/statm").open() as f:
        used = int(f.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 64 * MIB, before[1]))
    try:
        assert len(read_bytes(tmp_path / "a.json", "report")) == 3000
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert read_bytes("/proc/self/stat", "report"), "which says that it holds nothing"
