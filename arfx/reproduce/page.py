"""A paper's page, one HTML file without any outside link: what is printed beside what the
program gives, and error maps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from arfx.measure.difference import difference, level_difference
from arfx.measure.report_html import full_page, html_table, jpeg, plot_image, png, section
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
    Plot,
    Row,
    Value,
)

_CLASS = {HOLDS: "ok", UNDERIVED: "bad"}
_STYLE = """<style>.side { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: 10px; }
.side figure { cursor: default; } .plot { max-width: 760px; }
td:first-child { min-width: 12em; } td:last-child { min-width: 17em; }</style>"""


def page(paper: Paper, items: Sequence[Item], machine: str, short: bool) -> str:
    """machine : what it ran on, in words;  short : whether it was the short form"""
    rows = [i for i in items if isinstance(i, Row)]
    counts = "".join(
        "<div"
        f' class="tile"><b>{sum(r.verdict == v for r in rows)}</b><span>{escape(v)}</span></div>'
        for v in VERDICTS
    )
    made = f"{'Short form: small pictures, times mean nothing. ' if short else ''}{machine}"
    head = (
        f"<header><h1>{escape(paper.title)}</h1><p"
        f' class="path">{escape(paper.authors)}</p><p>{escape(WHAT)}</p><p>{escape(made)}</p><div'
        f' class="tiles">{counts}</div></header>'
    )
    drawn = [
        section(
            f"{i.item[:1].upper()}{i.item[1:]}: {i.title}",
            _pictures(i) if isinstance(i, Figure) else _plot(i),
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
            escape(r.item),
            text(r.printed),
            text(r.paper_formula),
            text(r.corrected),
            escape(r.unit),
            f'<span class="{_CLASS.get(r.verdict, "")}">{escape(r.verdict)}</span>',
            escape(r.reason),
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
    """HTML of a value: numbers with six figures at most."""
    if value is None:
        return "–"
    return (
        escape(value)
        if isinstance(value, str)
        else f"{value:,.6g}"
        if abs(value) < 1e6
        else f"{value:.4g}"
    )


def _plot(plot: Plot) -> str:
    return plot_image(png(plot.figure), plot.title)


def _pictures(figure: Figure) -> str:
    return (
        "<div"
        f' class="side">{"".join(_shown(picture, caption) for picture, caption in captioned(figure))}</div>'
    )


def captioned(figure: Figure) -> Iterator[tuple[np.ndarray, str]]:
    """Every picture with its caption, followed by its error map where it is compared with
    another.
    """
    compared = (
        {PRINTED: REFERENCE, CORRECTED: REFERENCE}
        if REFERENCE in figure.pictures
        else {CORRECTED: PRINTED}
    )
    for name, picture in figure.pictures.items():
        against = compared.get(name)
        if against is None or against not in figure.pictures:
            yield picture, name
            continue
        other = figure.pictures[against]
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


def _shown(rgb: np.ndarray, caption: str) -> str:
    said = escape(caption)
    return (
        f'<figure><img alt="{said}"'
        f' src="{jpeg(rgb, 85)}"><figcaption>{said}</figcaption></figure>'
    )
