"""What every command shares: its parameters, as commands.toml states them, messages on
standard error, one JSON document on standard output, tables, progress.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from arfx.core.opener import printable
from arfx.core.waiting import WAITS
from arfx.errors import counted

TABLE = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
_KINDS: dict[str, click.ParamType] = {
    "file": click.Path(path_type=Path, dir_okay=False),
    "folder": click.Path(path_type=Path, file_okay=False),
    "path": click.Path(path_type=Path),
    "existing-folder": click.Path(path_type=Path, file_okay=False, exists=True),
    "number": click.FLOAT,
}
_OUTPUT = (
    "arfx_cli.output"  # in the context of a command with --json: standard output
)
_LEVEL = (
    "arfx_cli.level"  # in the context of the running command: -1 quiet, 0, 1 verbose
)


class Command(click.Command):
    """With --json, what plug-ins and libraries print goes to standard error while it runs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Of an option that takes one value click uses the last, and drops others in silence."""
        used, _, order = self.make_parser(ctx).parse_args([*args])
        for p, count in Counter(order).items():
            single = isinstance(p, click.Option) and not (p.multiple or p.is_flag)
            if single and count > 1:
                note(
                    f"{p.opts[-1]} takes one value and is given {count}:"
                    f" {used[p.name]} is used"
                )
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        quiet, verbose, as_json = map(ctx.params.pop, ("quiet", "verbose", "json"))
        if quiet and verbose:
            raise click.UsageError(
                "--verbose and --quiet contradict each other: give one of them", ctx
            )
        ctx.meta[_LEVEL] = verbose - quiet
        if as_json:
            ctx.meta[_OUTPUT] = sys.stdout
            ctx.with_resource(contextlib.redirect_stdout(sys.stderr))
        return super().invoke(ctx)


def parameter(name: str, kind: Any = None, **words: Any) -> click.Parameter:
    """Of a row of commands.toml."""
    made = click.Option if name.startswith("-") else click.Argument
    if isinstance(kind, str):
        kind = _KINDS[kind]
    elif isinstance(kind, (list, tuple)):
        kind = (
            click.IntRange(*kind) if isinstance(kind[0], int) else click.Choice(kind)
        )
    return made(name.split(), type=kind, **words)


def arfx_command(name: str, *first: click.Parameter) -> Callable[..., Command]:
    """A command with these parameters, then its own, then those of every command."""
    shared = (*TABLE[name].get("also", ()), "json", "verbose", "quiet")
    rows = [
        *TABLE[name].get("parameter", ()),
        *(TABLE["shared"][key] for key in shared),
    ]
    params = [*first, *(parameter(**row) for row in rows)]
    return click.command(cls=Command, params=params)


def tell(message: str) -> None:
    """A line on standard error in any case; file names in it cannot steer the terminal."""
    click.echo(printable(message), err=True)


def say(message: str) -> None:
    """A line for people, on standard error (standard output is kept for results); not with
    --quiet.
    """
    if not quiet():
        tell(message)


def note(message: str) -> None:
    """A warning, with --quiet too."""
    tell(f"note: {message}")


def _level() -> int:
    context = click.get_current_context(silent=True)
    return context.meta.get(_LEVEL, 0) if context else 0


def quiet() -> bool:
    """Whether --quiet asks for warnings and errors alone."""
    return _level() < 0


def verbose() -> bool:
    """Whether --verbose asks for detail."""
    return _level() > 0


def detail(message: str) -> None:
    """A line that only --verbose shows."""
    if verbose():
        tell(f"  {message}")


def asks_for_json() -> bool:
    """Whether --json asks for the result, in place of words and tables."""
    return _OUTPUT in click.get_current_context().meta


def wrote_json(document: Any) -> bool:
    """Whether --json asks for the result, which is then written."""
    from arfx.core.numerics import finite

    if not asks_for_json():
        return False
    output = click.get_current_context().meta[_OUTPUT]
    json.dump(finite(document), output, indent=1)
    output.write("\n")
    return True


def print_table(template: str, words: int = 1, **values: Any) -> None:
    """A table on standard output; cells wrap between words alone.

    template : its title, then the heads, then the rows, with a tab between cells; an empty
    row is a line;  words : how many of the first columns are left-justified
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from arfx.run.pages import render

    title, *lines = render(template, **values).removesuffix("\n").split("\n")
    rows = [line.split("\t") if line else [] for line in lines]
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for k, column in enumerate(zip(*filter(None, rows), strict=True)):
        longest = max(len(word) for cell in column for word in [*cell.split(), ""])
        table.add_column(
            column[0], justify="left" if k < words else "right", min_width=longest
        )
    for row in rows[1:]:
        table.add_row(*row) if row else table.add_section()
    Console(highlight=False, markup=False).print(table)


class Progress:
    """A rich bar with ETA on a terminal, a plain line now and then otherwise, nothing with
    --quiet. A context manager.

    unit : what is counted"""

    def __init__(self, unit: str = "frames") -> None:
        self._unit = unit
        self._quiet = quiet()
        self._bars: Any = None
        self._shown: dict[
            str, Any
        ] = {}  # phase -> its bar, or the tenth that was said
        self._title = ""

    def __enter__(self) -> Progress:
        if not self._quiet and sys.stderr.isatty():
            from rich import progress
            from rich.console import Console

            self._bars = progress.Progress(
                progress.TextColumn("{task.description}", markup=False),
                progress.BarColumn(),
                progress.MofNCompleteColumn(),
                progress.TimeElapsedColumn(),
                progress.TimeRemainingColumn(),
                console=Console(stderr=True),
            )
            self._bars.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._bars:
            self._bars.stop()

    def begin(self, title: str) -> None:
        """The phases that follow are those of another piece of work, which is named before each."""
        self._title = f"{printable(title)}: "
        for bar in self._shown.values() if self._bars else ():
            self._bars.remove_task(bar)
        self._shown.clear()

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        """Phase `phase` has finished `done` of `total` steps (None = not known)."""
        if self._quiet:
            return
        words = self._title + WAITS.get(phase, phase)
        if self._bars:
            if phase not in self._shown:
                self._shown[phase] = self._bars.add_task(words, total=total)
            self._bars.update(self._shown[phase], completed=done, total=total)
            return
        waits = phase in WAITS
        tenth = done * 10 // total if total else done // (10 if waits else 100)
        if tenth != self._shown.get(phase) and (done or total):
            self._shown[phase] = tenth
            unit = "seconds" if waits else self._unit
            amount = (
                f"{done}/{counted(total, unit)}" if total else counted(done, unit)
            )
            say(f"{words}: {amount}")


def say_job(report: dict[str, Any]) -> None:
    """The job in a line; with --verbose also its stages, phases and the health of every
    estimate.
    """
    from arfx.run.model_size import size_in_words
    from arfx.run.pages import render

    size = size_in_words(report["model"])
    say(render("measure/job_line.jinja", r=report, size=size).strip())
    detail_job(report)


def detail_job(report: dict[str, Any]) -> None:
    detail_template("measure/job_detail.jinja", r=report)


def detail_template(template: str, **values: Any) -> None:
    """The lines of a template, which only --verbose shows."""
    if verbose():
        from arfx.run.pages import render

        for line in render(template, **values).splitlines():
            detail(line)
