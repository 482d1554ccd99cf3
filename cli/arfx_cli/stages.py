"""`arfx stages`: every stage and every setting."""

from __future__ import annotations

import sys

import click

from arfx_cli.console import emit_json, message_options


@click.command()
@click.argument("name", metavar="[NAME]", required=False)
@message_options
def command(name: str | None, as_json: bool) -> None:
    """List the stages in running order; with NAME, one of them or one section of a job
    file: what it does, what it reads and writes, its levels with their errors and prices,
    its settings. NAME `all` prints everything.

    \b
    Example:
      arfx stages
      arfx stages dof
      arfx stages output --json"""
    from arfx.run.catalogue import describe, overview, page, sections, text
    from arfx.stages import STAGES

    if as_json:
        every = {
            "stages": [describe(s) for s in STAGES],
            "sections": [describe(s) for s in sections()],
        }
        emit_json(every if name in (None, "all") else describe(str(name)))
        return
    shown = (
        overview()
        if name is None
        else page().rstrip()
        if name == "all"
        else text(describe(name))
    )
    if not sys.stdout.isatty():
        click.echo(shown)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(shown))
