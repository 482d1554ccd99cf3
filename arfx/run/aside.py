"""A job planned without a place of its own: nothing of it is left."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from arfx.config.sections import JobConfig
from arfx.plan.explain import summarise
from arfx.run.cluster.start import planned_workers
from arfx.run.folder import JobFolder
from arfx.run.inputs import Inputs, open_inputs
from arfx.run.job import Options, plan_job
from arfx.run.model_size import model_size
from arfx.run.place import Places
from arfx.run.planned import Job


@contextmanager
def planned_aside(
    config: JobConfig,
    options: Options,
    check: Callable[[Inputs], None] | None = None,
    placed: bool = True,
) -> Iterator[Job]:
    """The job that `process` would run, analysed and planned. Its folder is gone afterwards.

    options : of these its progress, notices and workers count;  check : called with all
    that was opened, before any work
    placed : the output's folder has to be there"""
    with tempfile.TemporaryDirectory(prefix="arfx-") as scratch:
        named = config.output.path is not None
        if not named:  # only where it would go is open; mkv holds what any clip has
            config = config.model_copy(
                update={
                    "output": config.output.model_copy(
                        update={"path": Path("out.mkv")}
                    )
                }
            )
        inputs = open_inputs(config, options.progress)
        if named and placed:
            Places(inputs, None, None, overwrite=True).check_output()
        if check is not None:
            check(inputs)
        for notice in inputs.notices:
            options.notice(notice)
        folder = JobFolder(Path(scratch) / "job")
        folder.open(resume=False)
        workers = planned_workers(options.executor) or options.workers
        yield plan_job(
            inputs, folder, replace(options, workers=workers, executor=None)
        )


def plan_document(job: Job) -> dict[str, Any]:
    """{frames, stages [...], predicted_s of these, model's size, predicted {wall, phases,
    ...}, levels}
    """
    rows = summarise(job.plan.frames, job.stages, job.inputs.camera.rect.area)
    stages = [r["predicted_s"] for r in rows]
    total = None if any(p is None for p in stages) else sum(stages)
    document: dict[str, Any] = {
        "frames": len(job.plan.frames),
        "stages": rows,
        "predicted_s": total,
    }
    document |= {"model": model_size(job.scene, job.facts)}
    return document | {"predicted": job.plan.predicted, "levels": job.plan.levels}
