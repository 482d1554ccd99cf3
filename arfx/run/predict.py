"""How long a job will take, from its plans and the price list, once its analysis has told what decoding costs.

The wall clock is the time up to the plan (measured) + what every worker prepares + the frames' work shared by the workers
+ the join. Prices hold for workers that all are busy, as they were fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from arfx.core.cost import Prediction, Prices, exactly, together, with_spread
from arfx.core.plan import FramePlan
from arfx.plan.levels import alike

DECODE_SPREAD = 0.25  # decoding again beside the rendering, against decoding beside the analysis


@dataclass(frozen=True)
class Terms:
    """What of a job the price of everything but its stages depends on.

    frame_mpx : millions of pixels of a frame;  frames : of the job;  decode_s : of all frames, as the analysis measured it
    before_s : seconds up to now;  workers, processes : how many render, and how many of them are further processes
    """

    frames: int
    frame_mpx: float
    decode_s: float
    before_s: float
    codec: str
    workers: int = 1
    processes: int = 0
    mfaces: float = 0.0


def parts(
    plans: Sequence[FramePlan], work: Prediction | None, terms: Terms, prices: Prices, prepared: bool = False
) -> dict[str, Prediction | None]:
    """Seconds by phase, summed over the workers; None = not known.

    work : of all stages;  prepared : what they prepare is in it
    """
    changed = [p for p in plans if p.steps]
    edited = {"frames": float(len(changed)), "mpx": sum(p.rect.area + p.changed.area for p in changed) / 1e6}
    whole = {"frames": float(terms.frames), "mpx": terms.frames * terms.frame_mpx}
    return {
        "before": exactly(terms.before_s),
        "prepare": exactly(0.0) if prepared else prepare(_prepared(plans), terms, prices),
        "decode": with_spread(terms.decode_s, DECODE_SPREAD),
        "stages": work,
        "edit": prices.predict("edit", edited) if changed else exactly(0.0),
        "encode": prices.predict(f"encode {terms.codec}", whole),
        "join": prices.predict("join", whole),
    }


def wall(phases: dict[str, Prediction | None], terms: Terms) -> Prediction | None:
    """Of the whole job; None where a phase is not known."""
    known = [p for p in phases.values() if p is not None]
    if len(known) < len(phases):
        return None
    shared = 1.0 / terms.workers
    alone = ("before", "prepare", "join")
    return together(p if name in alone else p.times(shared) for name, p in phases.items() if p is not None)


def _prepared(plans: Sequence[FramePlan]) -> set[tuple[str, str]]:
    return {(s.stage, s.level) for p in plans for s in p.steps}


def prepare(wanted: Collection[tuple[str, str]], terms: Terms, prices: Prices) -> Prediction | None:
    """What is made once: threads share it, every further process makes it anew, beside the others."""
    found = [prepare_one(stage, level, terms, prices) for stage, level in wanted]
    known = [p for p in found if p is not None]
    return together(known) if len(known) == len(found) else None


def prepare_one(stage: str, level: str, terms: Terms, prices: Prices) -> Prediction | None:
    """A level that was not timed counts as the stage's dearest that was, with a wide interval."""
    work = {"frames": 1.0, "mfaces": terms.mfaces}
    own = prices.predict(f"prepare {stage}/{level}", work)
    if own is not None:
        return own
    others = [p.seconds(work) for key, p in prices.prices.items() if key.startswith(f"prepare {stage}/")]
    return with_spread(max(others), 1.0) if others else None


def stages_of(plans: Sequence[FramePlan]) -> Prediction | None:
    """Work of all steps of a plan; None where one is not known."""
    by_stage: dict[str, list[Prediction]] = {}
    for plan in plans:
        for s in plan.steps:
            if s.seconds is None or s.between is None:
                return None
            by_stage.setdefault(s.stage, []).append(Prediction(s.seconds, *s.between))
    return together(alike(every) for every in by_stage.values())


def to_json(phases: dict[str, Prediction | None], terms: Terms, prices: Prices) -> dict[str, Any]:
    """{wall {s, low_s, high_s} or null, phases {name: the same}, workers, prices}"""
    total = wall(phases, terms)
    return {
        "wall": None if total is None else total.to_json(),
        "phases": {name: None if p is None else p.to_json() for name, p in phases.items()},
        "workers": terms.workers,
        "prices": prices.source,
        "calibrated": prices.calibrated,
    }
