"""The commands as commands.toml states them: their parameters, and what every command does
with --json, -v and -q.
"""

from __future__ import annotations

import contextlib
import sys
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from arfx_cli.console import LEVEL, OUTPUT, note

TABLE = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
_KINDS: dict[str, click.ParamType] = {
    "file": click.Path(path_type=Path, dir_okay=False),
    "folder": click.Path(path_type=Path, file_okay=False),
    "path": click.Path(path_type=Path),
    "existing-folder": click.Path(path_type=Path, file_okay=False, exists=True),
    "number": click.FLOAT,
}


class Command(click.Command):
    """With --json, what plug-ins and libraries print goes to standard error while it runs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Of an option that takes one value click uses the last, and drops others in silence."""
        used, _, order = self.make_parser(ctx).parse_args([*args])
        words = [part for w in args for part in w.split("=", w.startswith("--"))]
        for option in {p for p in order if isinstance(p, click.Option)}:
            count, last = order.count(option), used.get(option.name)
            if count < 2 or option.multiple or option.is_flag:
                continue
            values = [value for w, value in pairwise([*words, ""]) if w in option.opts]
            lost = "".join(f", not {value}" for value in values if value != last)
            if lost or len(values) < count:  # those of -oNAME
                note(
                    f"{option.opts[-1]} takes one value and is given {count}: {last} is"
                    f" used{lost}"
                )
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        quiet, verbose, as_json = map(ctx.params.pop, ("quiet", "verbose", "json"))
        if quiet and verbose:
            raise click.UsageError(
                "--verbose and --quiet contradict each other: give one of them", ctx
            )
        ctx.meta[LEVEL] = verbose - quiet
        if as_json:
            ctx.meta[OUTPUT] = sys.stdout
            ctx.with_resource(contextlib.redirect_stdout(sys.stderr))
        return super().invoke(ctx)


def parameter(name: str, kind: Any = None, **words: Any) -> click.Parameter:
    """Of a row of commands.toml."""
    made = click.Option if name.startswith("-") else click.Argument
    if isinstance(kind, str):
        kind = _KINDS[kind]
    elif isinstance(kind, (list, tuple)):
        kind = click.IntRange(*kind) if 1 in kind else click.Choice(kind)
    return made(name.split(), type=kind, **words)


def arfx_command(name: str, *first: click.Parameter) -> Callable[..., Command]:
    """A command with these parameters, then its own, then those of every command."""
    shared = (*TABLE[name].get("also", ()), "json", "verbose", "quiet")
    rows = [*TABLE[name].get("parameter", ()), *(TABLE["shared"][key] for key in shared)]
    params = [*first, *(parameter(**row) for row in rows)]
    return click.command(cls=Command, params=params)
