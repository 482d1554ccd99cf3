"""`arfx stages`: every stage and every setting."""

import sys

import click

from arfx_cli.console import arfx_command, wrote_json


@arfx_command("stages")
def command(name: str | None) -> None:
    """List the stages in running order; with NAME, one of them or one section of a job
    file: what it does, what it reads and writes, its levels with their errors and prices,
    its settings. NAME `all` prints everything.

    \b
    Example:
      arfx stages
      arfx stages dof
      arfx stages output --json"""
    from arfx.run.catalogue import describe, everything, overview, page, text

    if name in (None, "all"):
        document = everything()
        shown = overview(document) if name is None else page().rstrip()
    else:
        document = describe(str(name))
        shown = text(document)
    if wrote_json(document):
        return
    if not sys.stdout.isatty():
        click.echo(shown)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(shown))
