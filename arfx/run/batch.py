"""Many jobs, one after another in this process: one that fails does not stop the others,
and what they share is loaded once.

Model, its voxels and what its shadow needs, prices and compiled code are kept by those who
load them."""

import contextlib
import json
import os
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from arfx.core import interrupt
from arfx.errors import (
    ConfigError,
    JobInterruptedError,
    counted,
    explained,
    on_one_line,
)
from arfx.run.aside import plan_document, planned_aside
from arfx.run.batch_jobs import BatchJob
from arfx.run.folder import JobFolder
from arfx.run.inputs import open_inputs
from arfx.run.job import Options, process
from arfx.run.keys import job_keys
from arfx.run.outputs_made import Made, OutputsMade
from arfx.run.place import default_folder, place

Row = dict[str, Any]
Started = Callable[[int, BatchJob], None]
PAGE = "report.html"


def total_of(rows: Sequence[Row]) -> dict[str, float] | None:
    """{s, low_s, high_s} of all plans together, without clips that failed; None where a
    plan has no time. A machine that is slower today is so for all."""
    walls = [row["plan"]["predicted"]["wall"] for row in rows if row.get("plan")]
    if None in walls:
        return None
    return {key: sum(wall[key] for wall in walls) for key in ("s", "low_s", "high_s")}


def run_each(
    jobs: Sequence[BatchJob],
    work: Callable[[BatchJob], Row],
    started: Started,
    how: str = "",
) -> Iterator[Row]:
    """Have the work of each done. Yields {clip, output, exit_code, message, seconds, report}
    of each when it has ended.

    work : gives what its row holds beside the usual;  started(k, job) : called before each,
    k from 0
    Raises JobInterruptedError, after the row of the job that was interrupted, with how it
    goes on."""
    with interrupt.catching((signal.SIGINT,)):
        for k, job in enumerate(jobs):
            began = time.perf_counter()
            row: Row = {
                "clip": str(job.clip),
                "output": str(job.output),
                "exit_code": 0,
                "message": "",
                "seconds": 0.0,
                "report": None,
            }
            stopped = False
            try:
                interrupt.resume()  # a signal that came while the last output was put in its place
                started(k, job)
                row |= work(job)
            except (KeyboardInterrupt, Exception) as e:
                stopped = interrupt.pending() or isinstance(
                    e, (KeyboardInterrupt, JobInterruptedError)
                )
                code, message = (
                    (interrupt.exit_code() or 130, interrupt.cause())
                    if stopped
                    else explained(e)
                )
                row |= {"exit_code": code, "message": on_one_line(message)}
                if os.environ.get("ARFX_DEBUG") == "1" and not stopped:
                    traceback.print_exc()
            row["seconds"] = row["seconds"] or time.perf_counter() - began
            yield row
            if stopped:
                error = JobInterruptedError(
                    f"{row['message']} at clip {k + 1} of {len(jobs)}, {job.clip}",
                    how,
                )
                error.exit_code = row["exit_code"]
                raise error


def process_one(
    job: BatchJob,
    name: Path,
    options: Options,
    finish: Callable[[Path, Path], object],
) -> Row:
    """Run a job.

    options : of every job; its folder and report are those in which this one's are `name`
    finish(job folder, report folder) : writes a report"""
    report = None if options.report is None else options.report / name
    page = None if report is None else str(report / PAGE)
    if (before := _made_before(job, options)) is not None:
        # of a process that was killed when all was done
        JobFolder(default_folder(job.output)).clear()
        return {
            "message": f"{counted(before.frames, 'frames')}, done before",
            "seconds": before.seconds,
            "report": page if page is not None and Path(page).exists() else None,
        }
    began = time.perf_counter()

    def finish_job(path: Path) -> None:
        folder = JobFolder(path)
        if report is not None:
            finish(path, report)
        frames = json.loads(folder.report.read_bytes())["output"]["frames"]
        seconds = time.perf_counter() - began
        _outputs(job).note(job.output, folder.sealed_key(), seconds, frames)

    own = None if options.folder is None else options.folder / name
    with _folders_for(job.output):
        done = process(
            job.config,
            replace(_of(job, options), folder=own, report=report, finish=finish_job),
        )
    return {
        "message": counted(done["output"]["frames"], "frames"),
        "report": page,
    }


def _outputs(job: BatchJob) -> OutputsMade:
    return OutputsMade(place(job.output).parent)


def _made_before(job: BatchJob, options: Options) -> Made | None:
    """What was made of the same clip under the same settings, and is there; None = nothing,
    or it may be made anew, or --resume does not ask. Raises ConfigError where something else
    is there."""
    found = _outputs(job).of(job.output) if options.resume else None
    if found is None or found.key == job_keys(open_inputs(job.config))[1]:
        return found
    if options.overwrite:
        return None
    raise ConfigError(
        f"{job.output} was made of another clip, under other settings or by another"
        " version",
        "--overwrite makes it anew",
    )


def plan_one(job: BatchJob, options: Options) -> Row:
    """A row with "plan", as of `plan_document`, or null where nothing would be done."""
    if _made_before(job, options) is not None:
        return {"message": "done before", "plan": None}
    with planned_aside(job.config, _of(job, options), placed=False) as planned:
        document = plan_document(planned)
    return {"message": counted(document["frames"], "frames"), "plan": document}


def _of(job: BatchJob, options: Options) -> Options:
    return replace(
        options, notice=lambda message: options.notice(f"{job.clip}: {message}")
    )


@contextlib.contextmanager
def _folders_for(output: Path) -> Iterator[None]:
    """The folder that an output lies in, made. One that is empty afterwards goes again."""
    folder = place(output).parent
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigError(
            f"output folder {folder} cannot be made: {e.strerror}",
            "name another with -o",
        ) from None
    try:
        yield
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
