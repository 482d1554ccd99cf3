"""tradeoff.json, and the sentence that it comes to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from arfx.core.cost import Prediction
from arfx.measure.tradeoff import QUALITIES, Found, Row
from arfx.run.planned import Job

FEW_PX = 1500
PER_FRAME = ("mean", "p99", "flip", "delta_e", "ssim")
SEEN_MEAN, SEEN_P99 = 1.0, 12.0  # grey levels: more than either is taken for visible


def document(found: Found, job: Job, seconds: float) -> dict[str, Any]:
    """seconds : what the measuring took. `errors` is what `--tradeoff` reads (plan/errors.py)."""
    stages: dict[str, dict[str, float]] = {}
    own = {n: getattr(s, "formula", "") for n, s in job.inputs.config.params.items()}
    for r in found.effects:
        if r.formula == own.get(r.name, ""):
            stages.setdefault(r.name, {})[r.level] = max(d.mean for d in r.by_frame.values()) if r.by_frame else 0.0
    names, times = [r.name for r in found.effects], {f.index: f.time_s for f in job.facts}
    frames = [{"frame": s.index, "time_s": times[s.index], "stands_for": s.words, **s.facts} for s in found.samples]
    return {
        "clip": str(job.inputs.info.path), "frames": frames,
        "windows": {str(i): w.to_json() for i, w in found.windows.items()},
        "effects": [_row(r, found) for r in sorted(found.effects, key=lambda r: names.index(r.name))],
        "pipelines": [_row(r, found) for r in found.pipelines],
        "recommendation": recommendation(found), "seconds": seconds,
        "source": f"measured on {len(found.samples)} frames of {job.inputs.info.path.name}", "errors": stages,
    }  # fmt: skip


def _row(r: Row, found: Found) -> dict[str, Any]:
    return {
        "name": r.name, "level": r.level, "formula": r.formula, "levels": dict(r.levels) if r.name == "pipeline" else None,
        "seconds_per_frame": r.seconds, "between_s": [r.time.low_s, r.time.high_s],
        "prepare_s": found.prepare_s.get((r.name, r.level)),
        **{what: r.average(what) for what in PER_FRAME}, "mean_worst": r.worst("mean"), "p99": r.worst("p99"),
        "worst_frame": r.worst_frame(), "touched_px": sum(d.pixels for d in r.by_frame.values()),
        "unrest": None if r.unrest is None else {"level": r.unrest[0], "reference": r.unrest[1]},
        "by_frame": {str(i): {k: getattr(d, k) for k in PER_FRAME} for i, d in r.by_frame.items()},
    }  # fmt: skip


def front(rows: Sequence[Row]) -> list[Row]:
    """Those that no other beats in both time and mean error, cheapest first."""
    out: list[Row] = []
    for r in sorted(rows, key=lambda r: (r.seconds, r.average("mean"))):
        if not out or r.average("mean") < out[-1].average("mean") - 1e-9:
            out.append(r)
    return out


def visible(r: Row) -> bool:
    return r.worst("mean") > SEEN_MEAN or r.worst("p99") > SEEN_P99


def recommendation(found: Found) -> str:
    """One sentence: the cheapest quality whose difference from the reference does not show, and what would."""
    by_quality = {r.level: r for r in found.pipelines if r.level in QUALITIES and not r.formula}
    reference = by_quality.get("reference")
    if reference is None:
        return "every effect has one level only: there is nothing to choose"
    others = sorted((r for q, r in by_quality.items() if q != "reference"), key=lambda r: r.seconds)
    if not others:
        return "the job has one quality only"
    good = next((r for r in others if not visible(r)), None)
    chosen = good or min(others, key=lambda r: r.average("mean"))
    if good is None:
        return _none(found, chosen, reference) + _window(found)
    words = (
        f"{chosen.level} is within {chosen.average('mean'):.1f} grey levels of reference on average (99 % of the pixels within "
        f"{chosen.worst('p99'):.0f}) at {_share(chosen.time, reference.time)} of its time"
    )
    lower = QUALITIES[: QUALITIES.index(chosen.level)]
    left = (r for r in found.effects if r.level in lower and not _is_other(r, found))
    shows = [r for r in left if visible(r)]
    if shows:
        worst = max(shows, key=lambda r: r.worst("p99"))
        place = found.places.get((worst.name, worst.level), "")
        words += f"; {worst.name} {worst.level} would show {place}".rstrip() + f" (frame {worst.worst_frame()})"
    return words + _window(found)


def _none(found: Found, nearest: Row, reference: Row) -> str:
    """Where every quality below reference shows: the nearest of them, and whose difference it is."""
    own = [r for r in found.effects if nearest.levels.get(r.name) == r.level and not _is_other(r, found)]
    most = max(own, key=lambda r: r.average("mean"), default=None)
    words = (
        f"no quality below reference is without a difference that shows: the nearest, {nearest.level}, is "
        f"{nearest.average('mean'):.1f} grey levels off on average at {_share(nearest.time, reference.time)} of its time, and "
        f"would show in frame {nearest.worst_frame()}"
    )
    if most is not None and most.average("mean") > SEEN_MEAN:
        words += f"; most of it is {most.name}'s ({most.average('mean'):.1f} grey levels by itself)"
    return words


def _window(found: Found) -> str:
    """Said where so little of the picture was compared that other parts of it may differ otherwise."""
    least = min(found.windows.values(), key=lambda w: w.area, default=None)
    if least is None or least.area >= FEW_PX:
        return ""
    return f"; compared on {least.width} × {least.height} px of a frame alone, as the references take so long"


def _is_other(r: Row, found: Found) -> bool:
    """Is it the row of a formula that the job does not use?"""
    first = next(x for x in found.effects if x.name == r.name)
    return r.formula != first.formula


def _share(part: Prediction, whole: Prediction) -> str:
    """ "1/40", with where it lies nine times in ten if that is told apart in two figures."""
    if part.seconds <= 0 or whole.seconds <= 0:
        return "a part"
    ratio = whole.seconds / part.seconds
    if ratio < 1.5:
        return f"{100 / ratio:.0f} %"
    # parts of one machine that is slower or faster are so alike: what is left is each one's own error
    apart = math.hypot(math.log(part.high_s / part.seconds), math.log(whole.high_s / whole.seconds))
    low, high = _two(ratio * math.exp(-apart)), _two(ratio * math.exp(apart))
    return f"1/{_two(ratio)}" + ("" if low == high else f" (1/{low} to 1/{high})")


def _two(value: float) -> str:
    """Two figures."""
    digits = max(math.floor(math.log10(value)) - 1, 0)
    return f"{round(value / 10**digits) * 10**digits:.0f}"
