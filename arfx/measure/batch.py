"""A batch as a whole: its jobs run, batch.json and a page that links their reports."""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np

from arfx.core import interrupt
from arfx.core.guard import Guard
from arfx.core.numerics import finite
from arfx.core.waiting import wait_for
from arfx.errors import RenderError
from arfx.measure.report import report_of_job
from arfx.measure.report_html import (
    Html,
    escaped,
    full_page,
    html_table,
    jpeg,
    number,
    section,
    tiles,
)
from arfx.media.output import names_sequence
from arfx.run.batch import Row, Started, plan_all, process_all, total_of
from arfx.run.batch_jobs import BatchJob, check_batch, home_of
from arfx.run.folder import write
from arfx.run.job import Options
from arfx.run.place import PAGE_START, files_locked, files_named

FILES = {"batch.json": b'{\n "jobs": [', "batch.html": PAGE_START.encode()}
THUMBNAILS = 200  # of the first jobs: each takes some milliseconds and 8 kB
_WIDTH_PX, _QUALITY = 240, 80
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
            for k, row in enumerate(process_all(jobs, options, report_of_job, started)):
                rows.append(row)
                ended(k, row)
            interrupt.commit(6 if any(row["exit_code"] for row in rows) else 0)
        finally:
            document = _document(rows)
            write(
                home / "batch.json", json.dumps(document, indent=1, allow_nan=False) + "\n"
            )
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
    rows = []
    for k, row in enumerate(plan_all(jobs, options, started)):
        rows.append(row)
        ended(k, row)
    return _document(rows) | {"predicted": total_of(rows)}


def _document(rows: Sequence[Row]) -> dict[str, Any]:
    document: dict[str, Any] = finite(
        {"jobs": list(rows), "failed": sum(row["exit_code"] != 0 for row in rows)}
    )
    return document


def page(rows: Sequence[Row], count: int, home: Path) -> str:
    """batch.html. count : jobs of the batch, of which some may not have been begun;  home :
    the folder that links start from
    """
    failed = [row for row in rows if row["exit_code"]]
    shown = [
        (f"{len(rows) - len(failed)} of {count}", "clips done"),
        (len(failed), "failed"),
        (f"{number(sum(row['seconds'] for row in rows))} s", "all jobs together"),
    ]
    if len(rows) < count:
        shown.insert(2, (count - len(rows), "not begun"))
    place = escaped(os.path.abspath(home))  # noqa: PTH100 - without ".."
    header = f'<header><h1>Batch</h1><p class="path">{place}</p>{tiles(shown)}</header>'
    items = "".join(
        f"<li><b>{escaped(Path(r['clip']).name)}</b>: {escaped(r['message'])}</li>"
        for r in failed
    )
    warning = items and f'<section class="warn"><h2>Failed</h2><ul>{items}</ul></section>'
    return full_page(
        f"{count} clips – arfx batch",
        [header, warning, section("Clips", _table(rows, home))],
    )


def _table(rows: Sequence[Row], home: Path) -> str:
    with_picture = {id(row) for row in [r for r in rows if r["report"]][:THUMBNAILS]}
    cells = []
    for row in rows:
        picture = Html(_thumbnail(Path(row["report"])) if id(row) in with_picture else "")
        result = Html(
            f'<span class="bad">exit {row["exit_code"]}</span>'
            if row["exit_code"]
            else '<span class="ok">done</span>'
        )
        report = _link(row["report"], home, "report") if row["report"] else "–"
        output = (
            row["output"] if row["exit_code"] else _link(row["output"], home, row["output"])
        )
        cells.append(
            (picture, row["clip"], result, f"{row['seconds']:.1f}", report, output)
        )
    return html_table(
        ("", "clip", "result", "seconds", "report", "output"), cells, frozenset({3})
    )


def _link(path: str, home: Path, text: str) -> Html:
    if names_sequence(Path(path)):
        path = str(Path(path).parent)
    try:
        address = quote(os.fsencode(os.path.relpath(path, home).replace(os.sep, "/")))
    except ValueError:  # on another drive
        address = Path(path).absolute().as_uri()
    return Html(f'<a href="{address}">{escaped(text)}</a>')


def _thumbnail(report: Path) -> str:
    """The middle output picture of a job's report, small; "" where there is none."""
    try:
        found = _PICTURE.findall(report.read_bytes())
        whole = cv2.imdecode(
            np.frombuffer(base64.b64decode(found[len(found) // 2]), np.uint8),
            cv2.IMREAD_COLOR,
        )
        if whole is None:
            return ""
        size = (_WIDTH_PX, max(round(whole.shape[0] * _WIDTH_PX / whole.shape[1]), 1))
        small = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
        return f'<img class="thumbnail" alt="" src="{jpeg(small[..., ::-1], _QUALITY)}">'
    except (OSError, ValueError, IndexError, cv2.error, RenderError):
        return ""
