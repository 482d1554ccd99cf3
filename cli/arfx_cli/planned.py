"""A job planned in a folder that is thrown away: what commands need that explain or measure a job and render none."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arfx_cli.console import Progress, note
from arfx_cli.job_options import job_config

if TYPE_CHECKING:
    from arfx.run.inputs import Inputs
    from arfx.run.planned import Job


@contextmanager
def planned_aside(given: dict[str, Any], progress: Progress, check: Callable[[Inputs], None] | None = None) -> Iterator[Job]:
    """The job that `process` would run with these arguments, analysed and planned. Its folder is gone afterwards.

    check : called with all that was opened, before any work
    """
    from arfx.run.folder import JobFolder
    from arfx.run.inputs import open_inputs
    from arfx.run.job import Options, plan_job
    from arfx.run.place import Places

    with tempfile.TemporaryDirectory(prefix="arfx-") as scratch:
        config = job_config(given)
        named = config.output.path is not None
        if not named:  # only where it would go is open; mkv holds what any clip has
            config = config.model_copy(update={"output": config.output.model_copy(update={"path": Path("out.mkv")})})
        inputs = open_inputs(config)
        if named:
            Places(inputs, None, None, overwrite=True).check_output()
        if check is not None:
            check(inputs)
        for notice in inputs.notices:
            note(notice)
        folder = JobFolder(Path(scratch) / "job")
        folder.open(resume=False)
        yield plan_job(inputs, folder, Options(progress=progress, notice=note))
