"""How long a job will take, from its plans and the price list, once its analysis has told what decoding costs.

The wall clock is the time up to the plan (measured: analysis, and loading compiled code beside it) + what every worker prepares
+ the frames' work as the workers share it (run/schedule.py) + the join + what the report makes anew.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

from arfx.core.cost import Prediction, Prices, measured, sum_independent, with_spread
from arfx.core.plan import FramePlan, levels_of
from arfx.plan.levels import sum_correlated
from arfx.run.chunks import borders
from arfx.run.schedule import Load, elapsed

DECODE_SPREAD = 0.25  # decoding again beside the rendering, against decoding beside the analysis


@dataclass(frozen=True)
class Terms:
    """What of a job the price of everything but its stages depends on.

    frame_mpx : millions of pixels of a frame;  frames : of the job;  decode_s : of all frames, as the analysis measured it
    before_s : seconds up to now;  workers, processes : how many render, and how many of them are further processes
    keys : frames that decoding can begin at;  checked : stages that the report may prepare once more, for their health
    """

    frames: int
    frame_mpx: float
    decode_s: float
    before_s: float
    codec: str
    workers: int = 1
    processes: int = 0
    mfaces: float = 0.0
    keys: tuple[int, ...] = (0,)
    checked: frozenset[str] = frozenset()


@dataclass(frozen=True)
class JobPrediction:
    """What a job is predicted to take. phases : seconds of each, summed over the workers, None = not known
    share : of the seconds that the workers share, how many pass on the wall;  workers : at once
    """

    phases: dict[str, Prediction | None]
    share: float
    workers: int

    @property
    def wall(self) -> Prediction | None:
        """Of the whole job; None where a phase is not known. The phases err alike: a machine that is slower today is so for all,
        and what the calibration's scenes do not show of one phase was not seen to be made good by another."""
        known = [p if name in ALONE else p.times(self.share) for name, p in self.phases.items() if p is not None]
        return sum_correlated(known) if len(known) == len(self.phases) else None


ALONE = ("before", "prepare", "join", "report")


def predict(
    plans: Sequence[FramePlan], work: Prediction | None, terms: Terms, prices: Prices, prepared: bool = False
) -> JobPrediction:
    """work : of all stages;  prepared : what they prepare is in it"""
    changed = [p for p in plans if p.steps]
    edited = {"frames": float(len(changed)), "mpx": sum(p.rect.area + p.changed.area for p in changed) / 1e6}
    edit = prices.predict("edit", edited) if changed else measured(0.0)
    whole = {"frames": float(terms.frames), "mpx": terms.frames * terms.frame_mpx}
    encode = prices.predict(f"encode {terms.codec}", whole)
    share, lead = _shared(plans, work, terms, prices, *(0.0 if p is None else p.seconds for p in (edit, encode)))
    phases = {
        "before": measured(terms.before_s),
        "prepare": measured(0.0) if prepared else prepare(levels_of(plans), terms, prices),
        "decode": with_spread(terms.decode_s + lead, DECODE_SPREAD),
        "stages": work,
        "edit": edit,
        "encode": encode,
        "join": prices.predict("join", whole),
        "report": prepare({at for at in levels_of(plans) if at[0] in terms.checked}, terms, prices),
    }
    return JobPrediction(phases, share, terms.workers)


def _shared(
    plans: Sequence[FramePlan], work: Prediction | None, terms: Terms, prices: Prices, edit_s: float, encode_s: float
) -> tuple[float, float]:
    """(wall seconds per second of work that the workers share, seconds of decoding only to get to where a chunk begins)

    A worker that is alone encodes a chunk while it renders it.
    """
    planned = [sum(s.seconds or 0.0 for s in p.steps) for p in plans]
    scale = 1.0 if work is None or not sum(planned) else work.seconds / sum(planned)
    each, written = (s / max(terms.frames, 1) for s in (terms.decode_s + edit_s, encode_s))
    both: Callable[[float, float], float] = max if terms.workers == 1 else operator.add
    loads = [
        Load(a, b, both(each * (b - a + 1) + scale * sum(planned[a : b + 1]), written * (b - a + 1)))
        for a, b in borders(terms.frames)
    ]
    threads = not terms.processes
    alone = prices.alone if threads else 1.0
    wall_s, lead_s = elapsed(loads, terms.workers, threads, terms.keys, terms.decode_s / max(terms.frames, 1), alone)
    spent_s = terms.decode_s + edit_s + encode_s + scale * sum(planned) + lead_s
    return (wall_s / spent_s if spent_s > 0 else 1.0 / terms.workers), lead_s


def prepare(wanted: Collection[tuple[str, str]], terms: Terms, prices: Prices) -> Prediction | None:
    """What is made once: threads share it, every further process makes it anew, beside the others."""
    found = [prepare_one(stage, level, terms, prices) for stage, level in wanted]
    known = [p for p in found if p is not None]
    return sum_independent(known) if len(known) == len(found) else None


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
    return sum_independent(sum_correlated(every) for every in by_stage.values())


def to_json(job: JobPrediction, prices: Prices) -> dict[str, Any]:
    """{wall {s, low_s, high_s} or null, phases {name: the same}, workers, share, prices, calibrated}"""
    total = job.wall
    return {
        "wall": None if total is None else total.to_json(),
        "phases": {name: None if p is None else p.to_json() for name, p in job.phases.items()},
        "workers": job.workers,
        "share": job.share,
        "prices": prices.source,
        "calibrated": prices.calibrated,
    }
