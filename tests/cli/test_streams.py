"""Standard streams that are closed, full, or whose reader has left: no traceback, and the
job is done all the same.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import av
import pytest

from tests.cli.conftest import Material

pytestmark = pytest.mark.process
ARFX = [sys.executable, "-m", "arfx_cli"]
LENS = ["lens", "--focal", "50mm", "--fnumber", "2", "--distance", "2m", "--json"]


def shell(
    command: str, arguments: list[str], folder: Path
) -> subprocess.CompletedProcess[str]:
    """command : of a shell, with "$@" in place of arfx and its arguments"""
    return subprocess.run(
        ["sh", "-c", command, "sh", *ARFX, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_a_job_without_any_stream(material: Material, tmp_path: Path) -> None:
    """Red without a place-holder: the clip is opened as file 0, the output as file 2, and
    libraries' messages go into it.
    """
    done = shell(
        'exec "$@" <&- >&- 2>&-',
        material.arguments("-o", "out.mp4", "--end", "0.3", "--json"),
        tmp_path,
    )
    assert done.returncode == 0
    with av.open(str(tmp_path / "out.mp4")) as c:
        assert sum(1 for _ in c.decode(video=0)) == 10


def test_a_job_whose_messages_nobody_reads_on(
    material: Material, tmp_path: Path
) -> None:
    p = subprocess.Popen(
        [*ARFX, *material.arguments("-o", "out.mp4", "--end", "1")],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert p.stderr is not None and p.stderr.readline()
    p.stderr.close()  # | head -1
    assert p.wait(300) == 0 and (tmp_path / "out.mp4").exists()


def test_a_result_whose_reader_has_left_is_no_error(tmp_path: Path) -> None:
    done = shell('{ "$@"; echo $? >&2; } | true', LENS, tmp_path)
    assert done.stderr == "0\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_standard_output_is_an_error(tmp_path: Path) -> None:
    done = shell('exec "$@" > /dev/full', LENS, tmp_path)
    assert done.returncode == 5 and done.stderr.startswith(
        "error: standard output: No space left on device\nhelp: "
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_standard_error_is_none(tmp_path: Path) -> None:
    done = shell('exec "$@" 2> /dev/full', ["lens"], tmp_path)
    assert (done.returncode, done.stdout) == (
        2,
        "",
    ), "the code of what was wrong with the command"


def test_processes_that_are_started_import_nothing_from_the_working_folder(
    tmp_path: Path,
) -> None:
    """Red without PYTHONSAFEPATH: `python -c`, as which workers start, imports random.py of
    a folder of clips.
    """
    (tmp_path / "planted.py").touch()
    code = (
        "import subprocess, sys, types\ndef main():\n"
        " sys.exit(subprocess.call([sys.executable, '-c', 'import"
        " planted']))\nsys.modules['arfx_cli.main'] = types.ModuleType('main');"
        " sys.modules['arfx_cli.main'].main = main\nfrom arfx_cli.__main__ import"
        " start\nstart()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1 and "No module named 'planted'" in done.stderr
