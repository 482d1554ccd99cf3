"""A paper's page, one HTML file without any outside link: what is printed beside what the
program gives, and error maps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from arfx.measure.difference import difference, level_difference
from arfx.measure.report_html import (
    Html,
    figure,
    full_page,
    html_table,
    plot_image,
    png,
    section,
    tiles,
)
from arfx.measure.tradeoff_html import TIMES, error_map
from arfx.reproduce import Paper
from arfx.reproduce.rows import (
    CORRECTED,
    HOLDS,
    PRINTED,
    REFERENCE,
    UNDERIVED,
    VERDICTS,
    Figure,
    Item,
    Row,
    Value,
)

JPEG_QUALITY = 85
_CLASS = {HOLDS: "ok", UNDERIVED: "bad"}
_STYLE = """<style>.side { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: 10px; }
.side figure { cursor: default; } .plot { max-width: 760px; }
td:first-child { min-width: 12em; } td:last-child { min-width: 17em; }</style>"""


def page(paper: Paper, items: Sequence[Item], machine: str, short: bool) -> str:
    """machine : what it ran on, in words;  short : whether it was the short form"""
    rows = [i for i in items if isinstance(i, Row)]
    counts = tiles([(sum(r.verdict == v for r in rows), v) for v in VERDICTS])
    made = f"{'Short form: small pictures, times mean nothing. ' if short else ''}{machine}"
    head = (
        f"<header><h1>{escape(paper.title)}</h1><p"
        f' class="path">{escape(paper.authors)}</p><p>{escape(WHAT)}</p><p>{escape(made)}</p>{counts}'
        "</header>"
    )
    drawn = [
        section(
            f"{i.item[:1].upper()}{i.item[1:]}: {i.title}",
            _pictures(i) if isinstance(i, Figure) else plot_image(png(i.figure), i.title),
        )
        for i in items
        if not isinstance(i, Row)
    ]
    table = section("Every equation, number and figure", rows_table(rows))
    return full_page(f"{paper.authors} – arfx reproduce", [_STYLE, head, table, *drawn])


WHAT = (
    "Everything that the paper states, beside what its printed method gives here (formula"
    " paper) and what the corrected one gives. A row holds where all agree. All scenes are"
    " synthetic, so that a reference is known."
)


def rows_table(rows: Sequence[Row]) -> str:
    body = [
        [
            r.item,
            text(r.printed),
            text(r.paper_formula),
            text(r.corrected),
            r.unit,
            Html(f'<span class="{_CLASS.get(r.verdict, "")}">{escape(r.verdict)}</span>'),
            r.reason,
        ]
        for r in rows
    ]
    return html_table(
        (
            "item",
            "printed",
            "printed method here",
            "corrected",
            "unit",
            "verdict",
            "reason",
        ),
        body,
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


def _pictures(shown: Figure) -> str:
    drawn = (
        figure(picture, caption, JPEG_QUALITY) for picture, caption in captioned(shown)
    )
    return f'<div class="side">{"".join(drawn)}</div>'


def captioned(shown: Figure) -> Iterator[tuple[np.ndarray, str]]:
    """Every picture with its caption, followed by its error map where it is compared with
    another.
    """
    compared = (
        {PRINTED: REFERENCE, CORRECTED: REFERENCE}
        if REFERENCE in shown.pictures
        else {CORRECTED: PRINTED}
    )
    for name, picture in shown.pictures.items():
        against = compared.get(name)
        if against is None or against not in shown.pictures:
            yield picture, name
            continue
        other = shown.pictures[against]
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
