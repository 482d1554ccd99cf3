"""Runs the papers' modules: the JSON document and the pages of `arfx reproduce`."""

import platform
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy import ndarray

from arfx.core.machine import usable_cores
from arfx.measure.difference import level_difference
from arfx.measure.tradeoff_html import TIMES, error_map
from arfx.reproduce import PAPERS
from arfx.reproduce.rows import (
    CORRECTED,
    PRINTED,
    REFERENCE,
    VERDICTS,
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
        own = [*import_module(f"arfx.reproduce.{paper}").rows(work)]
        folder.mkdir(parents=True, exist_ok=True)
        html = render(
            "reproduce/paper.html",
            paper=PAPERS[paper],
            rows=own,
            platform=platform,
            cores=usable_cores(),
            short=work.short,
            verdicts=VERDICTS,
            text=text,
            captioned=captioned,
        )
        write(folder / page_name(paper), html)
        rows += [document_of(paper, row) for row in own]
    work.progress("papers", len(papers), len(papers))
    return {"rows": rows}


def document_of(paper: str, row: Row) -> dict[str, Any]:
    document = {"paper": paper, **row._asdict()}
    del document["title"], document["pictures"]
    return document


def text(value: Value) -> str:
    """A value for reading: numbers with six figures at most."""
    if value is None or isinstance(value, str):
        return value or "–"
    return f"{value:,.6g}" if abs(value) < 1e6 else f"{value:.4g}"


def captioned(row: Row) -> Iterator[tuple[ndarray, str]]:
    """Every picture with its caption, followed by its error map where it is compared with
    another.
    """
    pictures = {name: eight_bit(picture) for name, picture in row.pictures.items()}
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
