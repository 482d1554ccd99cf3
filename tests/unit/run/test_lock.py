"""One process at a time in a folder, however the one before it ended."""

from __future__ import annotations

import errno
import fcntl
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from arfx.errors import ConfigError, RenderError
from arfx.run.lock import locked

HOLD = (
    "import sys, time; from pathlib import Path; from arfx.run.lock import locked\n"
    + "with locked(Path(sys.argv[1]), '-o'): print('held', flush=True); sys.stdin.read()"
)


def test_a_folder_is_held_by_one_and_free_when_that_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "out.mp4.job"
    p = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert p.stdout is not None and p.stdout.readline() == "held\n"
        before = {f.name: f.read_bytes() for f in folder.iterdir()}
        with (
            pytest.raises(
                ConfigError, match=f"in use by process {p.pid} on .*, since .*: -c"
            ),
            locked(folder, "-o"),
        ):
            pass
        assert {f.name: f.read_bytes() for f in folder.iterdir()} == before
    finally:
        p.kill()
        p.communicate()
    assert list(folder.iterdir()), "nobody cleared up"
    with locked(folder, "-o", temporary=True):
        pass
    assert not folder.exists()


@pytest.mark.parametrize("code", [None, errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_of_many_at_once_one_gets_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None
) -> None:
    """code : with which a disk says that it knows no locks"""
    if code is not None:

        def refuses(*_: object) -> None:
            raise OSError(code, "no locks")

        monkeypatch.setattr(fcntl, "flock", refuses)
    start, done = threading.Barrier(8), threading.Barrier(8)
    got: list[str] = []

    def try_it() -> None:
        start.wait()
        try:
            with locked(tmp_path / "job", "-o", temporary=True):
                got.append("in")
                done.wait()
        except ConfigError as e:
            got.append(e.message)
            done.wait()

    threads = [threading.Thread(target=try_it) for _ in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join(60)
    assert got.count("in") == 1 and sum("in use" in g for g in got) == 7, got
    assert not (tmp_path / "job").exists()


def test_what_was_in_the_folder_stays(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("keep")
    with locked(tmp_path, "--report", temporary=True):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    (tmp_path / "empty").mkdir()
    with locked(tmp_path / "empty", "--report"):
        pass
    assert (tmp_path / "empty").is_dir(), "it was there before"


def test_a_place_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "job"):
        with (
            pytest.raises(RenderError, match="cannot write into"),
            locked(folder, "-o"),
        ):
            pass
