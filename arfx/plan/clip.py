"""The plan of a whole clip: levels shot by shot, then one plan per frame. Pure."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from arfx.core.cost import Prediction, Prices, measured
from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan
from arfx.core.scene import Scene
from arfx.core.stage import Stage, level_named
from arfx.plan.errors import Errors
from arfx.plan.levels import (
    LevelChoice,
    Option,
    ShotStage,
    best_within_budget,
    cheapest_within_error,
    sum_correlated,
)
from arfx.plan.planner import new_terms, plan_frame, terms_of

_NO_PRICE = Prediction(float("inf"), 0.0, float("inf"))
PrepareCost = Callable[[str, str], Prediction | None]


class LevelPolicy(NamedTuple):
    """How levels are chosen: a quality by name, or a budget for the whole job, or an error.

    budget_s : seconds;  max_error : mean grey levels, over the pixels that are changed;  at
    most one of the two
    """

    quality: str = "standard"
    budget_s: float | None = None
    max_error: float | None = None


class ClipPlan(NamedTuple):
    """plans : of every frame;  choice : levels and what was predicted of them;  shots :
    first frame of each
    """

    plans: list[FramePlan]
    choice: LevelChoice
    shots: Mapping[int, int]

    def explained(
        self, errors: Errors, stages: Mapping[str, Stage]
    ) -> list[dict[str, Any]]:
        """Of every shot and stage: the level, and the error that the table gives it, None =
        not measured.
        """
        return [
            {
                "shot": shot,
                "first_frame": self.shots[shot],
                "stage": stage,
                "level": level,
                "error": errors.known(stage, level, stages[stage].levels[-1]),
            }
            for (shot, stage), level in self.choice.levels.items()
        ]


def plan_clip(
    stages: Sequence[Stage],
    facts: Sequence[FrameFacts],
    scene: Scene,
    policy: LevelPolicy,
    errors: Errors,
    prices: Prices,
    seconds_of: Callable[[Sequence[FramePlan], Prediction], float],
    skip: bool,
    prepare_cost: PrepareCost,
) -> ClipPlan:
    """seconds_of : upper end of the whole job's time, from plans (for what is not the
    stages') and the stages' prediction
    prepare_cost : of a stage at a level, in the same seconds as its work; None = not known
    """
    new = list(new_terms(stages, facts))
    usual = {s.name: level_named(s.levels, policy.quality) for s in stages}
    shots: dict[int, int] = {}
    for f in facts:
        shots.setdefault(f.shot, f.index)

    def plans_at(by_shot: Mapping[int, Mapping[str, str]]) -> list[FramePlan]:
        frame = scene.camera.rect
        return [
            plan_frame(stages, by_shot[f.shot], f, scene, frame, skip, prices, n)
            for f, n in zip(facts, new, strict=True)
        ]

    plans = plans_at(dict.fromkeys(shots, usual))
    if policy.budget_s is None and policy.max_error is None:
        named = {
            (f.shot, step.stage): step.level
            for f, plan in zip(facts, plans, strict=True)
            for step in plan.steps
        }
        why = "levels named by the quality"
        return ClipPlan(plans, LevelChoice(named, measured(0), 0.0, True, why), shots)
    options = _options(stages, plans, facts, new, scene, prices, errors, prepare_cost)
    if policy.max_error is not None:
        choice = cheapest_within_error(options, policy.max_error)
    else:
        choice = best_within_budget(
            options, lambda work: seconds_of(plans, work), policy.budget_s or 0.0
        )
    by_shot = {
        shot: {
            name: choice.levels.get((shot, name), level)
            for name, level in usual.items()
        }
        for shot in shots
    }
    return ClipPlan(plans_at(by_shot), choice, shots)


def _options(
    stages: Sequence[Stage],
    plans: Sequence[FramePlan],
    facts: Sequence[FrameFacts],
    new: Sequence[frozenset[str]],
    scene: Scene,
    prices: Prices,
    errors: Errors,
    prepare_cost: PrepareCost,
) -> dict[ShotStage, list[Option]]:
    """Every level of every stage that runs, shot by shot.

    A level without a price cannot be chosen by a budget.
    """
    levels = {s.name: s.levels for s in stages}
    work: dict[ShotStage, list[dict[str, float]]] = {}
    for plan, f, n in zip(plans, facts, new, strict=True):
        for step in plan.steps:
            work.setdefault((f.shot, step.stage), []).append(
                terms_of(step.need, f, scene, n)
            )
    out: dict[ShotStage, list[Option]] = {}
    shots = Counter(name for _, name in work)
    for (shot, name), runs in work.items():
        for level in levels[name]:
            costs = [prices.predict(f"{name}/{level}", terms) for terms in runs]
            prepare = prepare_cost(name, level)
            costs.append(None if prepare is None else prepare.times(1 / shots[name]))
            cost = sum_correlated(_NO_PRICE if c is None else c for c in costs)
            error = errors.of(name, level, levels[name][-1])
            out.setdefault((shot, name), []).append(
                Option(level, cost, error, len(runs))
            )
    return out
