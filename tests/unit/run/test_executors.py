"""Workers do not outlive what uses their results, and work again where more is to be done."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import psutil
import pytest

from arfx.core import interrupt
from arfx.errors import RenderError
from arfx.run import executors, job
from arfx.run.executors import Processes, Task
from arfx.run.folder import JobFolder
from arfx.run.job import Options
from arfx.run.schedule import FrameRange
from tests.scenes import scene

pytestmark = pytest.mark.process


def tasks(folder: Path, count: int = 2) -> list[Task]:
    return [(str(folder), "key", k, k, "target") for k in range(count)]


def tell(
    folder: str,
    key: str,
    first: int,
    last: int,
    target: str,
    tick: Callable[[], None],
) -> dict[str, Any]:
    """Who works here, and in what; not before both have a task."""
    tick()
    Path(folder, f"{os.getpid()}").touch()
    while len([*Path(folder).iterdir()]) < 2:
        threading.Event().wait(0.01)
    variables = {name: os.environ.get(name) for name in executors.ONE_THREAD}
    opened = "arfx.stages.raster.gl_context" in sys.modules
    return {
        "first": first,
        "pid": os.getpid(),
        "parent": os.getppid(),
        "variables": variables,
        "opened": opened,
    }


def fail(
    folder: str,
    key: str,
    first: int,
    last: int,
    target: str,
    tick: Callable[[], None],
) -> dict[str, Any]:
    """The second fails when the first is at work; the first would go on for ever."""
    tick()
    Path(folder, f"{first}-{os.getpid()}").touch()
    while first == 0 or not [*Path(folder).glob("0-*")]:
        threading.Event().wait(0.01)
    if last == 1:
        raise RenderError("a stage failed", "why")
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def ended(pids: set[int]) -> bool:
    psutil.wait_procs(
        [psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)], timeout=60
    )
    return not any(psutil.pid_exists(pid) for pid in pids)


def test_the_same_processes_work_again_and_end_with_the_job(tmp_path: Path) -> None:
    """Red with processes of its own for each part of a job."""
    before, told = dict(os.environ), list[int]()
    with contextlib.closing(Processes()) as processes:
        results = list(processes.run(tasks(tmp_path), 2, told.append, tell))
        again = list(processes.run(tasks(tmp_path, 5), 2, told.append, tell))
        pids = {r["pid"] for r in results}
        assert sorted(r["first"] for r in again) == [0, 1, 2, 3, 4] and told[-1] <= 5
        assert (
            len(pids) == 2
            and {r["pid"] for r in again} <= pids
            and all(map(psutil.pid_exists, pids))
        )
    assert ended(pids)
    assert not any(r["opened"] for r in results) and {
        v for r in results for v in r["variables"].values()
    } == {"1"}
    assert dict(os.environ) == before
    if sys.platform == "linux":
        (server,) = {r["parent"] for r in (*results, *again)}
        assert psutil.Process(server).num_threads() == 1, (
            "a thread does not survive a fork"
        )


@pytest.mark.parametrize(
    ("last", "message"), [(1, "a stage failed"), (2, "a worker process was killed")]
)
def test_an_error_in_one_process_stops_all(
    tmp_path: Path, last: int, message: str
) -> None:
    given = [(str(tmp_path), "key", k, last, "target") for k in range(2)]
    with (
        contextlib.closing(Processes()) as processes,
        pytest.raises(RenderError, match=message) as raised,
    ):
        list(processes.run(given, 2, lambda _: None, fail))
    assert raised.value.hint
    assert ended({int(path.name[2:]) for path in tmp_path.iterdir()})


def test_an_error_beside_the_workers_stops_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Red where the generator is left to the collector of garbage: Python's end waited for
    workers with whole chunks to do.
    """
    stopped = []

    def run(*_: Any, **__: Any) -> Iterator[dict[str, Any]]:
        try:
            yield {"first": 0, "key": "a", "file": "x", "seconds": {}}
        finally:
            stopped.append(True)

    def full(*_: Any, **__: Any) -> None:
        raise OSError("full")

    monkeypatch.setattr(job, "chunk_suffix", lambda _: ".nut")
    planned: Any = SimpleNamespace(
        folder=JobFolder(tmp_path), inputs=SimpleNamespace(output=None, camera=scene().camera), facts=[], key="", chunks=[FrameRange(0, 1), FrameRange(2, 3)], log=SimpleNamespace(note=full),
    )  # fmt: skip
    processes: Any = SimpleNamespace(run=run)
    with pytest.raises(
        OSError
    ) as kept:  # holds the traceback, and with it the generator
        job._render(
            planned,
            Options(workers=2, processes=processes),
        )
    assert stopped and kept


def test_a_worker_looks_for_garbage_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing what a job needs makes 300,000 objects that stay: looking through them was
    a tenth of a worker's start.
    """
    monkeypatch.setattr(interrupt, "in_worker", lambda: None)
    before, threads = gc.get_threshold(), cv2.getNumThreads()
    try:
        ours, its = multiprocessing.Pipe()
        ours.close()  # as when the parent has ended
        executors._serve(its)
        assert gc.get_threshold()[0] > 300_000
    finally:
        gc.set_threshold(*before)
        cv2.setNumThreads(threads)
