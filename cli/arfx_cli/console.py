"""What every command shares: messages on standard error, one JSON document on standard output, progress."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from typing import Any

import click


def json_option(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="One JSON document on standard output.")(f)


def verbose_option(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("-v", "--verbose", is_flag=True, help="More detail on standard error.")(f)


def overwrite_option(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--overwrite", is_flag=True, help="Replace existing outputs.")(f)


def say(message: str) -> None:
    """A line for people, on standard error (standard output is kept for results)."""
    click.echo(message, err=True)


def strict_json(value: Any) -> Any:
    """The same document with non-finite numbers as null: JSON has no NaN."""
    if isinstance(value, dict):
        return {str(k): strict_json(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [strict_json(v) for v in value]
    if hasattr(value, "tolist"):
        return strict_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def emit_json(document: Any) -> None:
    json.dump(strict_json(document), sys.stdout, indent=1)
    sys.stdout.write("\n")


class Progress:
    """A rich bar with ETA on a terminal, a plain line now and then otherwise. Use as a context manager."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._rich: Any = None
        self._tasks: dict[str, Any] = {}
        self._last: dict[str, int] = {}

    def __enter__(self) -> Progress:
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as RichProgress

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
            )
            self._rich = RichProgress(*columns, console=Console(stderr=True), transient=False)
            self._rich.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._rich:
            self._rich.stop()

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        """Phase `phase` has finished `done` of `total` steps (None = not known)."""
        if self._quiet:
            return
        if self._rich:
            if phase not in self._tasks:
                self._tasks[phase] = self._rich.add_task(phase, total=total)
            self._rich.update(self._tasks[phase], completed=done, total=total)
            return
        tenth = done * 10 // total if total else done // 100
        if tenth != self._last.get(phase) and (done or total):
            self._last[phase] = tenth
            say(f"{phase}: {done}{f'/{total}' if total else ''} frames")
