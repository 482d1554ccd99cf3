"""Runs the papers' modules: the JSON document and the pages of `arfx reproduce`."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from arfx.core.machine import usable_cores
from arfx.reproduce import PAPERS
from arfx.reproduce.page import page
from arfx.reproduce.rows import Item, Row
from arfx.reproduce.work import Work
from arfx.run.folder import write


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
        write(folder / page_name(paper), page(PAPERS[paper], items, machine(), work.short))
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
