"""`arfx verify`: a synthetic scene through the whole job, against its truth."""

import os
import tempfile
from pathlib import Path

import click

from arfx_cli.console import (
    Progress,
    arfx_command,
    detail_job,
    detail_template,
    note,
    wrote_json,
)


@arfx_command("verify")
def command(folder: Path, keep: Path | None, workers: int) -> None:
    """Run the synthetic scene in FOLDER and report errors against its truth.

    FOLDER is made by `arfx synth`, or a scene folder, which is rendered first. Exit code 5
    if a figure breaks a bound of the folder's tolerance.toml.

    \b
    Example:
      arfx verify sample_scenes/0901-frontal-40px"""
    from arfx.errors import ArfxError, ConfigError
    from arfx.measure.verification import read_tolerance, verify
    from arfx.run.pages import render

    if keep is not None and any(
        os.path.lexists(keep / name) for name in ("job", "out.mkv", "out.mkv.job")
    ):
        raise ConfigError(
            f"{keep} holds an earlier run", "name another folder with --keep"
        )
    with (
        tempfile.TemporaryDirectory(prefix="arfx-verify-") as temporary,
        Progress() as progress,
    ):
        work = keep or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        done = verify(folder, work, progress, note, workers)
    detail_job(done.report)
    bounds = read_tolerance(folder).get("truth", {})
    detail_template("measure/verify_bounds.jinja", bounds=bounds)
    document = {"folder": str(folder), "figures": done.figures, "broken": done.broken}
    if not wrote_json(document):
        click.echo(render("measure/verify.jinja", f=done.figures), nl=False)
    if done.broken:
        raise ArfxError(
            f"{folder}: " + "; ".join(done.broken),
            "tolerance.toml in that folder gives the bounds and their reasons",
        )
