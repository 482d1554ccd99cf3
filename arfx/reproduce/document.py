"""Runs the papers' modules: the JSON document and the pages of `arfx reproduce`."""

import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy import ndarray

from arfx.core.machine import usable_cores
from arfx.measure.difference import level_difference
from arfx.measure.plots import png
from arfx.measure.tradeoff_html import TIMES, error_map
from arfx.reproduce import PAPERS
from arfx.reproduce.rows import (
    CORRECTED,
    PRINTED,
    REFERENCE,
    VERDICTS,
    Figure,
    Item,
    Row,
    Value,
    eight_bit,
)
from arfx.reproduce.work import Work
from arfx.run.folder import write
from arfx.run.pages import render


def page_name(paper: str) -> str:
    return f"{paper}.html"


def reproduce(papers: Sequence[str], folder: Path, work: Work) -> dict[str, Any]:
    """Write the page of each paper into `folder`.

    Returns {"rows": […]}, the rows as `Row`, with their paper.
    """
    rows = []
    for k, paper in enumerate(papers):
        work.progress("papers", k, len(papers))
        items = items_of(paper, work)
        folder.mkdir(parents=True, exist_ok=True)
        html = render(
            "reproduce/paper.html",
            paper=PAPERS[paper],
            items=items,
            machine=machine(),
            short=work.short,
            verdicts=VERDICTS,
            text=text,
            captioned=captioned,
            png=png,
        )
        write(folder / page_name(paper), html)
        rows += [{"paper": paper, **asdict(i)} for i in items if isinstance(i, Row)]
    work.progress("papers", len(papers), len(papers))
    return {"rows": rows}


def items_of(paper: str, work: Work) -> list[Item]:
    """All that a paper's module yields.

    Raises ValueError where an item has two rows, or a figure has none.
    """
    found: list[Item] = list(import_module(PAPERS[paper].module).rows(work))
    names = [i.item for i in found if isinstance(i, Row)]
    if twice := {n for n in names if names.count(n) > 1}:
        raise ValueError(f"{paper}: two rows for {min(twice)!r}")
    if lone := [i.item for i in found if i.item not in names]:
        raise ValueError(f"{paper}: there is a picture of {lone[0]!r}, but no row")
    return found


def machine() -> str:
    """What the times were taken on."""
    system = (
        f"{platform.machine()}, {usable_cores()} cores, {platform.system()}, Python"
        f" {platform.python_version()}"
    )
    return (
        f"Made on {system}. Rates are of one worker over decoding, analysing, rendering and"
        " encoding; start-up, planning and what is prepared once per clip are left out."
        " Memory is the most that a process of its own held, Python and libraries"
        " included."
    )


def text(value: Value) -> str:
    """A value for reading: numbers with six figures at most."""
    if value is None or isinstance(value, str):
        return value or "–"
    return f"{value:,.6g}" if abs(value) < 1e6 else f"{value:.4g}"


def captioned(shown: Figure) -> Iterator[tuple[ndarray, str]]:
    """Every picture with its caption, followed by its error map where it is compared with
    another.
    """
    pictures = {name: eight_bit(picture) for name, picture in shown.pictures.items()}
    compared = dict.fromkeys((PRINTED, CORRECTED), REFERENCE)
    if REFERENCE not in pictures:
        compared = {CORRECTED: PRINTED}
    for name, picture in pictures.items():
        against = compared.get(name, "")
        other = pictures.get(against)
        if other is None:
            yield picture, name
            continue
        apart = level_difference(other, picture)
        words = (
            f"{name}: {apart.mean():.2f} grey levels from {against} on average,"
            f" {apart.max():.0f} at most"
        )
        yield picture, words
        yield (
            error_map(other, picture),
            f"{name} less {against}, × {TIMES} about grey",
        )
