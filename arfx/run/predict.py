"""The levels of a job and its predicted time, from its plans and the price list: the
analysis is done, nothing is rendered yet.

The wall clock is the time up to the plan (measured: analysis, and loading compiled code
beside it) + what every worker prepares
+ the frames' work as the workers share it (run/schedule.py) + the join + what the report
prepares again.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from arfx.config.sections import JobConfig
from arfx.core.compiled import work_clock
from arfx.core.cost import Prediction, Prices, measured, sum_independent, with_spread
from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan, levels_of
from arfx.core.scene import Scene
from arfx.core.stage import Stage
from arfx.errors import ConfigError
from arfx.plan.clip import LevelPolicy, plan_clip
from arfx.plan.errors import Errors
from arfx.plan.explain import without_price
from arfx.plan.levels import sum_by_stage, sum_correlated
from arfx.run.schedule import chunks_of, elapsed

DECODE_SPREAD = (
    0.25  # decoding again beside the rendering, against decoding beside the analysis
)
SHARED = ("decode", "stages", "edit", "encode")  # phases that the workers share


class JobSize(NamedTuple):
    """What of a job the price of everything but its stages depends on.

    frame_mpx : millions of pixels of a frame;  frames : of the job;  decode_s : of all
    frames, as the analysis measured it
    began : what `work_clock` said before any of the job was done
    workers : how many render;  threads : of this process
    checked : stages that the report may prepare once more, for their health
    """

    frames: int
    frame_mpx: float
    decode_s: float
    began: float
    codec: str
    workers: int
    threads: bool
    mfaces: float
    checked: frozenset[str]


class JobPrediction(NamedTuple):
    """phases : seconds of each, summed over the workers, None = not known;  workers : at once
    share : of the seconds that the workers share, the fraction that passes on the wall clock
    """

    phases: dict[str, Prediction | None]
    share: float
    workers: int

    @property
    def wall(self) -> Prediction | None:
        """Of the whole job; None where a phase is not known. Errors of the phases are
        correlated: a machine that is slower today is so for all of them."""
        known = [
            p.times(self.share) if name in SHARED else p
            for name, p in self.phases.items()
            if p is not None
        ]
        return sum_correlated(known) if len(known) == len(self.phases) else None

    def to_json(self, prices: Prices) -> dict[str, Any]:
        """{wall {s, low_s, high_s} or null, phases {name: the same}, workers, share,
        prices, calibrated}
        """
        return {
            "wall": None if self.wall is None else self.wall.to_json(),
            "phases": {
                name: None if p is None else p.to_json()
                for name, p in self.phases.items()
            },
            "workers": self.workers,
            "share": self.share,
            "prices": prices.source,
            "calibrated": prices.calibrated,
        }


def predict(
    plans: Sequence[FramePlan],
    work: Prediction | None,
    size: JobSize,
    prices: Prices,
    prepared: bool = False,
) -> JobPrediction:
    """work : of all stages;  prepared : it includes what they prepare"""
    changed = [p for p in plans if p.steps]
    edited = {
        "frames": float(len(changed)),
        "mpx": sum(p.rect.area + p.changed.area for p in changed) / 1e6,
    }
    whole = {"frames": float(size.frames), "mpx": size.frames * size.frame_mpx}
    shared = {
        "decode": with_spread(size.decode_s, DECODE_SPREAD),
        "stages": work,
        "edit": prices.predict("edit", edited) if changed else measured(0.0),
        "encode": prices.predict(f"encode {size.codec}", whole),
    }
    levels = levels_of(plans)
    phases = {
        "before": measured(work_clock() - size.began),
        "prepare": measured(0.0) if prepared else prepare(levels, size, prices),
        **shared,
        "join": prices.predict("join", whole),
        "report": prepare(
            {at for at in levels if at[0] in size.checked}, size, prices
        ),
    }
    seconds = {name: p.seconds for name, p in shared.items() if p is not None}
    share = _share(plans, defaultdict(float, seconds), size, prices.alone)
    return JobPrediction(phases, share, size.workers)


def _share(
    plans: Sequence[FramePlan],
    seconds: Mapping[str, float],
    size: JobSize,
    alone: float,
) -> float:
    """Wall seconds per second of work that the workers share, chunk by chunk. A worker that
    is alone encodes while it renders.

    seconds : of the phases that they share;  alone : as of `elapsed`, of threads"""
    total_s = sum(seconds.values())
    stages_s, encode_s = seconds["stages"], seconds["encode"]
    if total_s <= 0:
        return 1.0 / size.workers
    if size.workers == 1:
        return max(total_s - encode_s, encode_s) / total_s
    planned = [sum(s.cost.seconds for s in p.steps if s.cost) for p in plans]
    scale = stages_s / (sum(planned) or 1.0)
    per_frame_s = (total_s - stages_s) / size.frames
    loads = [
        per_frame_s * c.frames + scale * sum(planned[c.first : c.last + 1])
        for c in chunks_of(size.frames)
    ]
    return elapsed(loads, size.workers, alone if size.threads else 1.0) / total_s


def prepare(
    wanted: Collection[tuple[str, str]], size: JobSize, prices: Prices
) -> Prediction | None:
    """What is made once: threads share it, every further process makes its own, beside the
    others.
    """
    found = [prepare_one(stage, level, size, prices) for stage, level in wanted]
    known = [p for p in found if p is not None]
    return sum_independent(known) if len(known) == len(found) else None


def prepare_one(
    stage: str, level: str, size: JobSize, prices: Prices
) -> Prediction | None:
    """A level that was not timed counts as the stage's most expensive one, with a wide interval."""
    work = {"frames": 1.0, "mfaces": size.mfaces}
    own = prices.predict(f"prepare {stage}/{level}", work)
    others = [
        p.seconds(work)
        for key, p in prices.prices.items()
        if key.startswith(f"prepare {stage}/")
    ]
    return own or (with_spread(max(others), 1.0) if others else None)


def time_of_stages(plans: Sequence[FramePlan]) -> Prediction | None:
    """Of all steps of the plans; None where one is not known."""
    steps = [step for plan in plans for step in plan.steps]
    known = [(step.stage, step.cost) for step in steps if step.cost is not None]
    return sum_by_stage(known) if len(known) == len(steps) else None


def level_policy(
    config: JobConfig, stages: Mapping[str, Stage], prices: Prices
) -> LevelPolicy:
    """How levels are to be chosen.

    Raises ConfigError where two ways are asked for, or a budget with a stage without
    prices.
    """
    p = config.pipeline
    asked = [
        f"--{name.replace('_', '-')}"
        for name in ("budget", "fps", "max_error")
        if getattr(p, name) is not None
    ]
    if len(asked) > 1:
        raise ConfigError(
            f"{asked[0]} and {asked[1]} both choose levels", "give one of them"
        )
    unknown = [
        n
        for n, s in stages.items()
        if not any(f"{n}/{level}" in prices.prices for level in s.levels)
    ]
    if unknown and (p.budget is not None or p.fps is not None):
        what, how = without_price(unknown)
        raise ConfigError(f"a budget needs the price of everything, and {what}", how)
    return LevelPolicy(p.quality, p.budget, p.max_error)


def choose(
    config: JobConfig,
    stages: Mapping[str, Stage],
    facts: Sequence[FrameFacts],
    scene: Scene,
    policy: LevelPolicy,
    errors: Errors,
    prices: Prices,
    size: JobSize,
) -> tuple[list[FramePlan], dict[str, Any]]:
    """The plans of all frames, and {predicted, levels}: final, whatever the job measures later."""
    if config.pipeline.fps is not None:
        policy = policy._replace(budget_s=len(facts) / config.pipeline.fps)

    def upper_s(plans: Sequence[FramePlan], work: Prediction) -> float:
        wall = predict(plans, work, size, prices, prepared=True).wall
        if wall is None:
            raise ConfigError(
                f"a budget needs the price of everything, and encoding {size.codec} has"
                " none",
                "--codec h264 or ffv1, or choose by --quality or --max-error",
            )
        return wall.high_s

    def prepare_cost(stage: str, level: str) -> Prediction | None:
        found = prepare_one(stage, level, size, prices)
        # no worker helps another with it
        return None if found is None else found.times(size.workers)

    plan = plan_clip(
        list(stages.values()),
        facts,
        scene,
        policy,
        errors,
        prices,
        upper_s,
        config.pipeline.skip,
        prepare_cost,
    )
    predicted = predict(plan.plans, time_of_stages(plan.plans), size, prices)
    by = (
        "budget"
        if policy.budget_s is not None
        else "error"
        if policy.max_error is not None
        else "quality"
    )
    return plan.plans, {
        "predicted": predicted.to_json(prices),
        "levels": {
            "by": by,
            "budget_s": policy.budget_s,
            "max_error": policy.max_error,
            "met": plan.choice.met,
            "why": plan.choice.why,
            "error": None if by == "quality" else plan.choice.error,
            "errors_from": errors.source,
            "chosen": plan.explained(errors, stages),
        },
    }
