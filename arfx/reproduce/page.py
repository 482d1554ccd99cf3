"""A paper's page, one HTML file without any outside link: what is printed beside what the
program gives, and error maps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from arfx.measure.difference import difference, level_difference
from arfx.measure.report_html import png
from arfx.measure.tradeoff_html import TIMES, error_map
from arfx.reproduce import Paper
from arfx.reproduce.rows import (
    COLOURS,
    CORRECTED,
    PRINTED,
    REFERENCE,
    VERDICTS,
    Figure,
    Item,
    Value,
)
from arfx.run.pages import render


def page(paper: Paper, items: Sequence[Item], machine: str, short: bool) -> str:
    """machine : what it ran on, in words;  short : whether it was the short form"""
    return render(
        "reproduce/paper.html",
        paper=paper,
        items=items,
        machine=machine,
        short=short,
        verdicts=VERDICTS,
        colours=COLOURS,
        text=text,
        captioned=captioned,
        png=png,
    )


def text(value: Value) -> str:
    """A value for reading: numbers with six figures at most."""
    if value is None:
        return "–"
    return (
        value
        if isinstance(value, str)
        else f"{value:,.6g}"
        if abs(value) < 1e6
        else f"{value:.4g}"
    )


def captioned(shown: Figure) -> Iterator[tuple[np.ndarray, str]]:
    """Every picture with its caption, followed by its error map where it is compared with
    another.
    """
    compared = (
        {PRINTED: REFERENCE, CORRECTED: REFERENCE}
        if REFERENCE in shown.pictures
        else {CORRECTED: PRINTED}
    )
    pictures = {name: eight_bit(picture) for name, picture in shown.pictures.items()}
    for name, picture in pictures.items():
        against = compared.get(name)
        if against is None or against not in pictures:
            yield picture, name
            continue
        other = pictures[against]
        apart = difference(other, picture, np.ones(picture.shape[:2], bool))
        most = float(np.max(level_difference(other, picture)))
        yield (
            picture,
            (
                f"{name}: {apart.mean:.2f} grey levels from {against} on average,"
                f" {most:.0f} at most"
            ),
        )
        yield error_map(other, picture), f"{name} less {against}, × {TIMES} about grey"


def eight_bit(coded: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of coded values 0..1, of one channel or three; of uint8 as they are."""
    if coded.dtype == np.uint8:
        return coded
    out = np.round(255 * np.clip(coded, 0, 1)).astype(np.uint8)
    return out if out.ndim == 3 else np.dstack([out] * 3)
