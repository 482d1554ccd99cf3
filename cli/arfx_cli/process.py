"""`arfx process`: the main job."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from arfx_cli.console import Progress, emit_json, message_options, note, overwrite_option, say, say_job
from arfx_cli.job_options import job_config, job_options


@click.command(params=job_options())
@overwrite_option
@message_options
def command(
    report_dir: Path | None, job_dir: Path | None, resume: bool, workers: int | None, overwrite: bool, as_json: bool, **given: Any
) -> None:
    """Put a virtual model onto the marker of CLIP.

    Frame times, audio, rotation and colour tags are kept; pixels that nothing virtual touches stay as they are.

    \b
    Example:
      arfx process clip.mp4 --camera camera.yaml --marker 36h11:3:165mm \\
        --model duck.glb --fit 15cm -o out.mp4 --report report"""
    from arfx.measure.report import report_of_job
    from arfx.run.job import Options, process

    config = job_config(given)
    finish = None if report_dir is None else partial(report_of_job, folder=report_dir)
    with Progress() as progress:
        report = process(config, Options(job_dir, resume, overwrite, workers, report_dir, finish, progress, note))
    say_job(report)
    if report_dir is not None:
        say(f"report: {report_dir / 'report.html'}")
    if as_json:
        emit_json(report)
