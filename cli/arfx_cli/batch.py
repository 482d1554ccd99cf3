"""`arfx batch`: many clips, one job each."""

from typing import Any

import click

from arfx_cli.console import (
    TABLE,
    Progress,
    arfx_command,
    print_table,
    say,
    tell,
    wrote_json,
)
from arfx_cli.job_options import job_config, job_options, run_options


def _options() -> list[click.Option]:
    """Those of `process`, but for its one clip."""
    options = [p for p in job_options() if isinstance(p, click.Option)]
    for option in options:
        option.help = TABLE["batch"]["words"].get(option.name, option.help)
    return options


@arfx_command("batch", *_options())
def command(inputs: tuple[str, ...], dry_run: bool, **given: Any) -> None:
    """Process many clips: those of a table, of a folder, of a pattern such as
    'shots/*.mp4', or those that are named.

    A clip that fails does not stop the others: exit code 6 in the end. All options of `arfx
    process` are for every clip. What the clips share (model, prices, compiled code) is
    loaded once. batch.json and batch.html sum up.

    MANIFEST is a table. As CSV, its columns are options without dashes (clip, output,
    camera, fit) or settings (dof.fnumber). As TOML, it is a job file with a [[job]] table
    for each clip. Its paths are relative to it. The command line wins over it, but for -o,
    which is for clips that have no output of their own.

    \b
    Example:
      arfx batch shots --camera camera.yaml --marker 36h11:3:165mm --model duck.glb --fit 15cm \\
        -o 'out/{stem}.mp4' --report report"""
    from arfx.core.waiting import wait_for
    from arfx.measure.batch import plan_batch, run_batch
    from arfx.run.batch_jobs import batch_jobs, home_of

    with Progress() as progress:
        options = run_options(given, progress)
        pattern = given["output"]
        given |= {"clip": None, "output": None}
        jobs = wait_for(
            "table",
            lambda: batch_jobs(
                inputs, lambda files: job_config(given, files), pattern
            ),
            progress,
        )

        def started(k: int, job: Any) -> None:
            progress.begin(f"{k + 1} of {len(jobs)} {job.clip}")

        def ended(k: int, row: dict[str, Any]) -> None:
            if row["exit_code"]:
                tell(f"{k + 1} of {len(jobs)} {row['clip']}: error: {row['message']}")
            else:
                say(
                    f"{k + 1} of {len(jobs)} {row['clip']}: {row['message']},"
                    f" {row['seconds']:.1f} s, to {row['output']}"
                )

        document = (plan_batch if dry_run else run_batch)(
            jobs, options, started, ended
        )
    if not wrote_json(document):
        template = (
            "measure/batch_plans.jinja" if dry_run else "measure/batch_table.jinja"
        )
        print_table(template, words=2, d=document)
    if not dry_run:
        say(f"summary: {(options.report or home_of(jobs)) / 'batch.html'}")
    if document["failed"]:
        click.get_current_context().exit(6)
