"""tradeoff.html: one file without any outside link.

Tables, plots, pictures side by side with their error maps times eight.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy import ndarray

from arfx.measure.difference import delta_e
from arfx.measure.plots import INK, PREDICTED, png, styled
from arfx.measure.pose_plot import RAW, SMOOTH
from arfx.measure.report import write_json
from arfx.measure.tradeoff import LEFT_OUT, QUALITIES, Measurements, Row, front
from arfx.run.folder import write
from arfx.run.pages import render
from arfx.run.planned import Job

TIMES, MOST_DELTA_E = 8, 10


def write_tradeoff(
    folder: Path, found: Measurements, document: Mapping[str, Any]
) -> Path:
    """Write tradeoff.json and tradeoff.html into `folder`. Returns the page's path."""
    write_json(folder / "tradeoff.json", document)
    write(folder / "tradeoff.html", page(found, document))
    return folder / "tradeoff.html"


def page(found: Measurements, document: Mapping[str, Any]) -> str:
    return render(
        "measure/tradeoff.html",
        clip=Path(str(document["clip"])).name,
        document=document,
        effects=found.effects,
        pipelines=found.pipelines,
        error_plot=error_plot,
        most_different=most_different,
        error_map=error_map,
        delta_e_map=delta_e_map,
        times=TIMES,
        most_delta_e=MOST_DELTA_E,
    )


def error_map(reference: ndarray, picture: ndarray) -> ndarray:
    """(h, w, 3) uint8: grey is no difference, eight times the difference about it."""
    apart = picture.astype(np.int16) - reference.astype(np.int16)
    return np.asarray(np.clip(128 + TIMES * apart, 0, 255), np.uint8)


def delta_e_map(reference: ndarray, picture: ndarray) -> ndarray:
    """(h, w, 3) uint8: how visible the difference is, from black to white at MOST_DELTA_E."""
    share = delta_e(reference, picture) / MOST_DELTA_E
    return np.asarray(colormaps["inferno"](share, bytes=True)[..., :3])


def most_different(rows: Sequence[Row], reference: Row) -> int:
    """The frame in which the levels differ most."""
    return max(
        reference.pictures,
        key=lambda i: max(
            (r.by_frame[i].p99 for r in rows if i in r.by_frame), default=0.0
        ),
    )


FLOOR = 0.02  # grey levels: what is drawn for none


@styled
def error_plot(rows: Sequence[Row], title: str) -> bytes:
    """Mean and 99th percentile over the time; those means that no other beats are joined by
    a line, and the other formula's are diamonds."""
    fig = Figure((7.2, 3.9))
    axis = fig.subplots()
    own = [r for r in rows if r.level != LEFT_OUT and not r.other]
    other = [r for r in rows if r.other]
    for some, worst, style, colour, label in (
        (own, True, "o", RAW, "99th percentile, worst frame"),
        (own, False, "o", SMOOTH, "mean"),
        (front(own), False, "-", SMOOTH, "Pareto front"),
        (other, False, "D", SMOOTH, None),
    ):
        points = [_point(r, worst) for r in some]
        axis.plot(
            *np.reshape(points, (-1, 2)).T, style, color=colour, ms=5, label=label
        )
    for r in [*own, *other]:
        axis.annotate(
            f"{r.formula} {r.level}" if r.other else r.level,
            _point(r),
            (4, -11),
            textcoords="offset points",
            fontsize=8,
            color=INK,
        )
    axis.axhline(SEEN_MEAN, color=PREDICTED, lw=0.8, ls=":")
    axis.set(xscale="log", yscale="log", title=title)
    axis.set(xlabel="ms per frame, one core", ylabel="grey levels")
    axis.margins(0.12)
    axis.legend(loc="upper right")
    return png(fig)


def _point(r: Row, worst: bool = False) -> tuple[float, float]:
    """Milliseconds, and grey levels: the mean, or the 99th percentile of the worst frame."""
    error = r.worst("p99") if worst else r.average("mean")
    return 1e3 * r.seconds, max(error, FLOOR)


FEW_PX = 1500
PER_FRAME = ("mean", "p99", "flip", "delta_e", "ssim")
SEEN_MEAN, SEEN_P99 = 1.0, 12.0  # grey levels: more than either is taken for visible


def document(found: Measurements, job: Job, seconds: float) -> dict[str, Any]:
    """seconds : what the measuring took. `errors` is what `--tradeoff` reads (plan/errors.py)."""
    errors: dict[str, dict[str, float]] = {}
    for r in found.effects:
        if r.level != LEFT_OUT and not r.other:
            errors.setdefault(r.name, {})[r.level] = r.worst("mean")
    times = {f.index: f.time_s for f in job.facts}
    frames = [
        {"frame": s.index, "time_s": times[s.index], "stands_for": s.words, **s.facts}
        for s in found.samples
    ]
    return {
        "clip": str(job.inputs.info.path),
        "frames": frames,
        "windows": {str(i): [*w] for i, w in found.windows.items()},
        "effects": [_row(r, found) for r in found.effects],
        "pipelines": [_row(r, found) for r in found.pipelines],
        "recommendation": recommendation(found),
        "seconds": seconds,
        "source": f"measured on {len(found.samples)} frames of {job.inputs.info.path.name}",
        "errors": errors,
    }


def _row(r: Row, found: Measurements) -> dict[str, Any]:
    own = [p for p in found.pipelines if not p.other]
    return {
        "name": r.name,
        "level": r.level,
        "formula": r.formula,
        "levels": (
            {**dict.fromkeys((e.name for e in found.effects), LEFT_OUT), **r.levels}
            if r.name == "pipeline"
            else None
        ),
        "beaten": r in own and r not in front(own),
        "seconds_per_frame": r.seconds,
        "between_s": [r.time.low_s, r.time.high_s],
        "predicted": r.predicted,
        "prepare_s": found.prepare_s.get((r.name, r.level)),
        **{what: r.average(what) for what in PER_FRAME},
        "mean_worst": r.worst("mean"),
        "p99": r.worst("p99"),
        "worst_frame": r.worst_frame(),
        "touched_px": sum(d.pixels for d in r.by_frame.values()),
        "unrest": (
            None
            if r.flicker is None
            else {"level": r.flicker[0], "reference": r.flicker[1]}
        ),
        "by_frame": {
            str(i): {k: getattr(d, k) for k in PER_FRAME}
            for i, d in r.by_frame.items()
        },
    }


def visible(r: Row) -> bool:
    return r.worst("mean") > SEEN_MEAN or r.worst("p99") > SEEN_P99


def recommendation(found: Measurements) -> str:
    """One sentence: the cheapest quality whose difference from the reference does not show,
    and what would; where all show, the nearest, and whose difference it is. Said too where
    so little of the picture was compared that other parts of it may differ otherwise.
    """
    by_quality = {r.level: r for r in found.pipelines if r.level in QUALITIES}
    reference = by_quality.pop("reference", None)
    others = sorted(by_quality.values(), key=lambda r: r.seconds)
    good = next((r for r in others if not visible(r)), None)
    chosen = good or min(others, key=lambda r: r.average("mean"), default=None)
    lower = QUALITIES[: QUALITIES.index(chosen.level)] if chosen else ()
    effects = [r for r in found.effects if not r.other]
    worse = [r for r in effects if r.level in lower and visible(r)]
    shows = max(worse, key=lambda r: r.worst("p99"), default=None)
    own = [r for r in effects if chosen and chosen.levels.get(r.name) == r.level]
    return render(
        "measure/tradeoff_advice.jinja",
        reference=reference,
        chosen=chosen,
        good=good,
        shows=shows,
        most=max(own, key=lambda r: r.average("mean"), default=None),
        window=min(found.windows.values(), key=lambda w: w.area, default=None),
        seen=SEEN_MEAN,
        few=FEW_PX,
    ).strip()
