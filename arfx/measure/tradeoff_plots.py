"""Plots of a tradeoff: error against time, one picture per effect and one for whole pipelines. PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from arfx.measure.report_plots import INK, PREDICTED, RAW, SMOOTH, png
from arfx.measure.tradeoff import Row
from arfx.measure.tradeoff_document import SEEN_MEAN, front

FLOOR = 0.02  # grey levels: what is drawn for none


def effect_plot(rows: Sequence[Row]) -> bytes:
    """Mean and 99th percentile of each level of one effect; the other formula's point is a diamond."""
    fig, axis = _axis(6.4, 3.4)
    own = [r for r in rows if r.formula == rows[0].formula]
    other = [r for r in rows if r.formula != rows[0].formula]
    for worst, colour, label in ((True, RAW, "99th percentile, worst frame"), (False, SMOOTH, "mean")):
        axis.plot(*_points(own, worst), "o-", color=colour, ms=5, lw=1, label=label)
        for r in other:
            axis.plot(*_points([r], worst), "D", color=colour, ms=6, mfc="none", label=f"{label}, {r.formula}")
    _named(axis, [(r, r.level if r in own else f"{r.formula} {r.level}") for r in rows], (4, -11))
    return _finished(fig, axis, f"{rows[0].name}: error against its own reference")


def pipeline_plot(rows: Sequence[Row]) -> bytes:
    """Whole pipelines, the front of those that no other beats joined by a line."""
    fig, axis = _axis(7.6, 4.2)
    axis.plot(*_points(front([r for r in rows if not r.formula])), "-", color=SMOOTH, lw=1.2, label="Pareto front")
    for r in rows:
        named = r.level != "mixed"
        marker, colour = ("D", RAW) if r.formula else ("o", SMOOTH if named else PREDICTED)
        axis.plot(*_points([r]), marker, color=colour, ms=6 if named else 4)
    _named(axis, [(r, f"{r.formula} {r.level}".strip()) for r in rows if r.level != "mixed"], (5, 5))
    return _finished(fig, axis, "Whole pipelines against everything at reference")


def _points(rows: Sequence[Row], worst: bool = False) -> tuple[list[float], list[float]]:
    """Milliseconds, and grey levels: the mean, or the 99th percentile of the worst frame."""
    return [1e3 * r.seconds for r in rows], [max(r.worst("p99") if worst else r.average("mean"), FLOOR) for r in rows]


def _named(axis: Any, rows: Sequence[tuple[Row, str]], aside: tuple[int, int]) -> None:
    for r, text in rows:
        (x,), (y,) = _points([r])
        axis.annotate(text, (x, y), aside, textcoords="offset points", fontsize=8, color=INK)


def _axis(width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height), layout="constrained")
    return fig, fig.subplots()


def _finished(fig: Any, axis: Any, title: str) -> bytes:
    axis.axhline(SEEN_MEAN, color=PREDICTED, lw=0.8, ls=":")
    axis.set(xscale="log", yscale="log")
    axis.set_xlabel("ms per frame, one core", fontsize=8)
    axis.set_ylabel("grey levels", fontsize=8)
    axis.set_title(title, fontsize=9, loc="left", color=INK)
    axis.margins(0.12)
    axis.legend(frameon=False, labelcolor=INK, fontsize=7, loc="upper right")
    return png(fig)
