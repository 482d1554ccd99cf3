"""Workers do not outlive what uses their results."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from arfx.core import interrupt
from arfx.run import executors, job
from arfx.run.folder import JobFolder
from arfx.run.job import Options
from arfx.run.schedule import Chunk
from tests.scenes import scene


def test_an_error_beside_the_workers_stops_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Red where the generator is left to the collector of garbage: Python's end waited for workers with whole chunks to do."""
    stopped = []

    def run(*_: Any, **__: Any) -> Iterator[dict[str, Any]]:
        try:
            yield {"first": 0, "file": "x", "seconds": {}}
        finally:
            stopped.append(True)

    def full(*_: Any, **__: Any) -> None:
        raise OSError("full")

    monkeypatch.setattr(job, "run_processes", run)
    monkeypatch.setattr(job, "chunk_suffix", lambda _: ".nut")
    planned: Any = SimpleNamespace(
        folder=JobFolder(tmp_path), inputs=SimpleNamespace(output=None), facts=[], key="", log=SimpleNamespace(note=full),
        scene=scene(),
    )  # fmt: skip
    with pytest.raises(OSError) as kept:  # holds the traceback, and with it the generator
        job._render(planned, [Chunk(0, 1, "a"), Chunk(2, 3, "b")], Options(workers=2))
    assert stopped and kept


def test_a_worker_looks_for_garbage_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing what a job needs makes 300,000 objects that stay: looking through them was a tenth of a worker's start."""
    monkeypatch.setattr(interrupt, "in_worker", lambda: None)
    before, threads = gc.get_threshold(), cv2.getNumThreads()
    try:
        executors._start(None)
        assert gc.get_threshold()[0] > 300_000
    finally:
        gc.set_threshold(*before)
        cv2.setNumThreads(threads)
