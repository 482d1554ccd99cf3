"""`arfx tradeoff`: error and time of every level of every effect, on the user's own clip."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any

import click

from arfx_cli.console import Progress, arfx_command, print_table, say, wrote_json
from arfx_cli.job_options import job_config, job_options, run_options

if TYPE_CHECKING:
    from arfx.run.inputs import Inputs


@arfx_command("tradeoff", *job_options())
def command(frames: int, **given: Any) -> None:
    """Measure what accuracy costs on CLIP: every level of every effect against its
    reference, and whole pipelines.

    The arguments are those of `arfx process`; nothing is encoded. --report DIR gets
    tradeoff.json, which `--tradeoff` of `process` and `plan` reads for --max-error and
    --budget, and tradeoff.html with plots, pictures and error maps.

    \b
    Example:
      arfx tradeoff clip.mp4 --camera camera.yaml --marker 36h11:3:165mm --model duck.glb \\
        --fit 15cm --pipeline lightmap,dof --report costs"""
    from arfx.core.guard import Guard
    from arfx.core.numerics import finite
    from arfx.measure.tradeoff import measure
    from arfx.measure.tradeoff_html import document, write_tradeoff
    from arfx.run.aside import planned_aside
    from arfx.run.place import PAGE_START, files_locked, files_read

    def check(inputs: Inputs) -> None:
        if folder is not None:
            made = {
                "tradeoff.json": b'{\n "clip": ',
                "tradeoff.html": PAGE_START.encode(),
            }
            guard = Guard(files_read(inputs), options.overwrite)
            report.enter_context(files_locked(guard, folder, made, "--report"))

    began = time.perf_counter()
    with contextlib.ExitStack() as report:
        with Progress() as progress:
            options = run_options(given, progress)
            folder = options.report
            with planned_aside(job_config(given), options, check) as job:
                found = measure(job, frames, progress)
        measured = finite(document(found, job, time.perf_counter() - began))
        if folder is not None:
            say(f"report: {write_tradeoff(folder, found, measured)}")
    if wrote_json(measured):
        return
    for template in ("effects", "pipelines"):
        print_table(f"measure/tradeoff_{template}.jinja", words=2, d=measured)
    click.echo(measured["recommendation"])
