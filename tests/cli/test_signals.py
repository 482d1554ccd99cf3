"""Ctrl-C, SIGTERM and kill at set moments of whole jobs: the exit code says whether the
output is complete, and none is left.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Material, Run, at_a_moment

pytestmark = [pytest.mark.process, pytest.mark.usefixtures("ctrl_c")]


def sending(
    number: int, then: Callable[..., Any], swallowed: bool = False
) -> Callable[..., Any]:
    def call(*args: Any, **named: Any) -> Any:
        with contextlib.suppress(*([BaseException] if swallowed else [])):
            signal.raise_signal(number)
        return then(*args, **named)

    return call


def test_ctrl_c_leaves_a_resumable_job(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    """At a terminal it goes to the workers too, here while they start: they say nothing,
    and are gone with the job.
    """
    p = at_a_moment(
        tmp_path,
        "render",
        2,
        signal.SIGINT,
        material.arguments("-o", "out.mp4", "--workers", "2"),
        group=True,
    )
    assert p.returncode == 130 and "Traceback" not in p.stderr, p.stderr
    assert (
        "error: interrupted; what is done is kept in" in p.stderr
        and "--resume" in p.stderr
    )
    assert (tmp_path / "out.mp4.job").is_dir() and not (tmp_path / "out.mp4").exists()
    assert arfx(*material.arguments("-o", "out.mp4", "--resume")).code == 0


def test_sigterm_leaves_a_resumable_job_and_no_worker(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    p = at_a_moment(
        tmp_path,
        "render",
        3,
        signal.SIGTERM,
        material.arguments("-o", "out.mp4", "--workers", "2"),
    )
    assert (
        p.returncode == 143
        and "error: stopped by SIGTERM; what is done is kept in" in p.stderr
    ), p.stderr
    assert not (tmp_path / "out.mp4").exists()
    assert arfx(*material.arguments("-o", "out.mp4", "--resume")).code == 0


def test_a_killed_job_leaves_no_worker(material: Material, tmp_path: Path) -> None:
    """Red without the watch on the parent: workers wait for ever, and hold standard error open."""
    p = at_a_moment(
        tmp_path,
        "render",
        3,
        signal.SIGKILL,
        material.arguments("-o", "out.mp4", "--workers", "2"),
    )
    assert p.returncode == -signal.SIGKILL


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
@pytest.mark.parametrize(
    "place", ["arfx.run.job.open_inputs", "arfx.media.join._remux"]
)
def test_a_signal_that_a_library_swallows_stops_the_job(
    material: Material,
    arfx: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
    number: int,
    code: int,
) -> None:
    module, name = place.rsplit(".", 1)
    real = getattr(__import__(module, fromlist=[name]), name)
    monkeypatch.setattr(place, sending(number, real, swallowed=True))
    r = arfx(*material.arguments("-o", "out.mp4", "--end", "0.1"))
    assert r.code == code and "--resume" in r.err, r.err
    assert not (tmp_path / "out.mp4").exists() and (tmp_path / "out.mp4.job").is_dir()
    monkeypatch.setattr(place, real)
    assert (
        arfx(*material.arguments("-o", "out.mp4", "--end", "0.1", "--resume")).code
        == 0
    )


def test_a_signal_that_a_library_turns_into_an_error_is_still_one(
    material: Material, arfx: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("partially initialised module") from None

    monkeypatch.setattr("arfx.run.job.open_inputs", fail)
    r = arfx(*material.arguments("-o", "out.mp4"))
    assert r.code == 143 and r.err == "stopped by SIGTERM\n"


@pytest.mark.parametrize(
    "place", ["arfx.run.job.build_report", "arfx_cli.process.say_job"]
)
def test_once_the_output_is_in_place_signals_change_nothing(
    material: Material,
    arfx: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
) -> None:
    module, name = place.rsplit(".", 1)
    monkeypatch.setattr(
        place,
        sending(signal.SIGINT, getattr(__import__(module, fromlist=[name]), name)),
    )
    r = arfx(*material.arguments("-o", "out.mp4", "--end", "0.1"))
    assert (
        r.code == 0
        and (tmp_path / "out.mp4").exists()
        and not (tmp_path / "out.mp4.job").exists()
    ), r.err


def test_a_signal_while_a_command_is_imported(
    arfx: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    import importlib

    monkeypatch.setattr(
        "arfx_cli.main.importlib.import_module",
        sending(signal.SIGINT, importlib.import_module, swallowed=True),
    )
    r = arfx("lens", "--focal", "50mm", "--fnumber", "2", "--distance", "2m")
    assert r.code == 130 and r.out == "" and r.err.strip() == "interrupted"


def test_a_signal_before_anything_is_imported() -> None:
    lines = [
        "import signal, sys",
        "from arfx_cli import __main__, streams",
        "make_safe = streams.make_safe",
    ]
    lines += [
        "streams.make_safe = lambda: (signal.raise_signal(signal.SIGTERM), make_safe())"
    ]
    lines += ["sys.argv = ['arfx', 'doctor']", "__main__.start()"]
    r = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (r.returncode, r.stdout, r.stderr) == (143, "", "stopped by SIGTERM\n")


def test_ctrl_c_is_heard_and_progress_told_while_a_model_is_read(
    material: Material, arfx: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    monkeypatch.setattr("arfx.run.inputs.job_model", lambda _: go_on.wait(20))
    monkeypatch.setattr("arfx.core.waiting._SOON_S", 1)
    threading.Timer(1.5, signal.raise_signal, [signal.SIGINT]).start()
    began = time.monotonic()
    r = arfx(*material.arguments("-o", "out.mp4"))
    go_on.set()
    assert (
        r.code == 130
        and "reading the model: 1 s" in r.err
        and time.monotonic() - began < 10
    ), r.err
