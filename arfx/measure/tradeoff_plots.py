"""Plots of a tradeoff: error against time, one picture per effect and one for whole pipelines. PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from arfx.measure.report_plots import INK, PREDICTED, RAW, SMOOTH, _png
from arfx.measure.tradeoff import Row
from arfx.measure.tradeoff_document import SEEN_MEAN, front

FLOOR = 0.02  # grey levels: what is drawn for none


def effect_plot(rows: Sequence[Row]) -> bytes:
    """Mean and 99th percentile of each level of one effect; the other formula's point is a diamond."""
    from matplotlib.figure import Figure

    own = [r for r in rows if r.formula == rows[0].formula]
    other = [r for r in rows if r.formula != rows[0].formula]
    fig = Figure(figsize=(6.4, 3.4), layout="constrained")
    axis = fig.subplots()
    for what, colour, label in (("p99", RAW, "99th percentile, worst frame"), ("mean", SMOOTH, "mean")):
        axis.plot(
            [1e3 * r.seconds for r in own],
            [max(_value(r, what), FLOOR) for r in own],
            "o-",
            color=colour,
            ms=5,
            lw=1,
            label=label,
        )
        for r in other:
            axis.plot(
                [1e3 * r.seconds],
                [max(_value(r, what), FLOOR)],
                "D",
                color=colour,
                ms=6,
                mfc="none",
                label=f"{label}, {r.formula}",
            )
    for r in [*own, *other]:
        text = r.level if r in own else f"{r.formula} {r.level}"
        axis.annotate(text, (1e3 * r.seconds, max(r.average("mean"), FLOOR)), (4, -11), textcoords="offset points", fontsize=8,
                      color=INK)  # fmt: skip
    _finish(axis, f"{rows[0].name}: error against its own reference")
    return bytes(_png(fig))


def pipeline_plot(rows: Sequence[Row]) -> bytes:
    """Whole pipelines, the front of those that no other beats joined by a line."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(7.6, 4.2), layout="constrained")
    axis = fig.subplots()
    best = front([r for r in rows if not r.formula])
    axis.plot([1e3 * r.seconds for r in best], [max(r.average("mean"), FLOOR) for r in best], "-", color=SMOOTH, lw=1.2,
              label="Pareto front")  # fmt: skip
    for r in rows:
        named = r.level != "mixed"
        marker, colour = ("D", RAW) if r.formula else ("o", SMOOTH if named else PREDICTED)
        axis.plot([1e3 * r.seconds], [max(r.average("mean"), FLOOR)], marker, color=colour, ms=6 if named else 4)
        if named:
            text = f"{r.formula} {r.level}".strip()
            axis.annotate(text, (1e3 * r.seconds, max(r.average("mean"), FLOOR)), (5, 5), textcoords="offset points",
                          fontsize=8, color=INK)  # fmt: skip
    _finish(axis, "Whole pipelines against everything at reference")
    return bytes(_png(fig))


def _value(row: Row, what: str) -> float:
    return row.worst(what) if what == "p99" else row.average(what)


def _finish(axis: Any, title: str) -> None:
    axis.axhline(SEEN_MEAN, color=PREDICTED, lw=0.8, ls=":")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("ms per frame, one core", fontsize=8)
    axis.set_ylabel("grey levels", fontsize=8)
    axis.set_title(title, fontsize=9, loc="left", color=INK)
    axis.margins(0.12)
    axis.legend(frameon=False, labelcolor=INK, fontsize=7, loc="upper right")
