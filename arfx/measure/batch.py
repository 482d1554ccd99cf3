"""A batch as a whole: its jobs run, batch.json and a page that links their reports."""

import base64
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
from numpy import ndarray

from arfx.core import interrupt
from arfx.core.guard import Guard
from arfx.core.numerics import finite
from arfx.core.waiting import wait_for
from arfx.measure.report import report_of_job, write_json
from arfx.media.output import names_sequence
from arfx.run.batch import Row, Started, plan_all, process_all, total_of
from arfx.run.batch_jobs import BatchJob, check_batch, home_of
from arfx.run.folder import write
from arfx.run.job import Options
from arfx.run.pages import render
from arfx.run.place import PAGE_START, files_locked, files_named

FILES = {"batch.json": b'{\n "jobs": [', "batch.html": PAGE_START.encode()}
THUMBNAILS = 200  # of the first jobs: each takes some milliseconds and 8 kB
_WIDTH_PX = 240
_PICTURE = re.compile(rb'<img class="out"[^>]* src="data:image/jpeg;base64,([^"]+)"')


def run_batch(
    jobs: Sequence[BatchJob],
    options: Options,
    started: Started,
    ended: Callable[[int, Row], None],
) -> dict[str, Any]:
    """Run all jobs; batch.json and batch.html are written into the folder of reports, else
    that of the outputs, when all have ended or the batch is interrupted.

    options : as of `process_all`;  started, ended : called for each job, from 0
    Returns {"jobs": [...], "failed": N}. Raises ConfigError and InputError before any work,
    JobInterruptedError."""
    kept = not (options.resume or options.overwrite)
    wait_for("check", lambda: check_batch(jobs, kept), options.progress)
    home = options.report or home_of(jobs)
    guard = Guard(
        {read for job in jobs for read in files_named(job.config)},
        options.overwrite or options.resume,
    )
    rows: list[Row] = []
    with files_locked(guard, home, FILES, "--report"):
        try:
            for k, row in enumerate(
                process_all(jobs, options, report_of_job, started)
            ):
                rows.append(row)
                ended(k, row)
            interrupt.commit(6 if any(row["exit_code"] for row in rows) else 0)
        finally:
            document = _document(rows)
            write_json(home / "batch.json", document)
            write(home / "batch.html", page(rows, len(jobs), home))
    return document


def plan_batch(
    jobs: Sequence[BatchJob],
    options: Options,
    started: Started,
    ended: Callable[[int, Row], None],
) -> dict[str, Any]:
    """{"jobs": [... with "plan"], "failed": N, "predicted": {s, low_s, high_s} of all or
    null}; nothing is written.
    """
    wait_for("check", lambda: check_batch(jobs, kept=False), options.progress)
    rows: list[Row] = []
    for row in plan_all(jobs, options, started):
        ended(len(rows), row)
        rows.append(row)
    return _document(rows) | {"predicted": total_of(rows)}


def _document(rows: Sequence[Row]) -> dict[str, Any]:
    failed = sum(row["exit_code"] != 0 for row in rows)
    document: dict[str, Any] = finite({"jobs": list(rows), "failed": failed})
    return document


def page(rows: Sequence[Row], count: int, home: Path) -> str:
    """batch.html. count : jobs of the batch, of which some may not have been begun;  home :
    the folder that links start from
    """

    def link(path: str) -> str:
        if names_sequence(Path(path)):
            path = str(Path(path).parent)
        try:
            return quote(
                os.fsencode(os.path.relpath(path, home).replace(os.sep, "/"))
            )
        except ValueError:  # on another drive
            return Path(path).absolute().as_uri()

    begun = [row["report"] for row in rows if row["report"]][:THUMBNAILS]
    return render(
        "measure/batch.html",
        rows=rows,
        count=count,
        home=os.path.abspath(home),  # noqa: PTH100 - without ".."
        thumbnails=[
            _thumbnail(row["report"]) if row["report"] in begun else None
            for row in rows
        ],
        file_name=lambda path: Path(path).name,
        link=link,
    )


def _thumbnail(report: str) -> ndarray | None:
    """The middle output picture of a job's report, small, RGB; None where there is none."""
    try:
        found = _PICTURE.findall(Path(report).read_bytes())
        data = np.frombuffer(base64.b64decode(found[len(found) // 2]), np.uint8)
        whole = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB)
        assert whole is not None
        size = (_WIDTH_PX, max(round(whole.shape[0] * _WIDTH_PX / whole.shape[1]), 1))
        return cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    except (OSError, ValueError, IndexError, AssertionError, cv2.error):
        return None
