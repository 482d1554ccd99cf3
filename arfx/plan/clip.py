"""The plan of a whole clip: levels shot by shot, then one plan per frame. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from arfx.core.cost import Prediction, Prices, measured
from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan
from arfx.core.scene import Scene
from arfx.core.stage import Stage, level_named
from arfx.plan.errors import Errors
from arfx.plan.levels import Chosen, Option, Place, keep_budget, keep_error, named, sum_correlated
from arfx.plan.planner import plan_frame
from arfx.plan.work import terms_of, what_is_new

SecondsOf = Callable[[Sequence[FramePlan], Prediction], float]
Once = Callable[[str, str], Prediction | None]
NOTHING = measured(0.0)


@dataclass(frozen=True)
class Wish:
    """How levels are chosen: a quality by name, or a budget for the whole job, or an error.

    budget_s : seconds;  max_error : mean grey levels, over the pixels that are changed;  at most one of the two
    """

    quality: str = "standard"
    budget_s: float | None = None
    max_error: float | None = None


@dataclass(frozen=True)
class ClipPlan:
    """plans : of every frame;  chosen : levels and what was predicted of them;  shots : first frame of each"""

    plans: list[FramePlan]
    chosen: Chosen
    shots: Mapping[int, int] = field(default_factory=dict)

    def explained(self, errors: Errors) -> list[dict[str, Any]]:
        """Of every shot and stage: the level, and the error that the table gives it."""
        rows = []
        for (shot, stage), level in self.chosen.levels.items():
            error = errors.by_level.get(stage, {}).get(level)
            rows.append({"shot": shot, "first_frame": self.shots[shot], "stage": stage, "level": level, "error": error})
        return rows


def plan_clip(
    stages: Sequence[Stage],
    facts: Sequence[FrameFacts],
    scene: Scene,
    wish: Wish,
    errors: Errors,
    prices: Prices,
    seconds_of: SecondsOf,
    skip: bool = True,
    once: Once = lambda stage, level: NOTHING,
) -> ClipPlan:
    """seconds_of : upper end of the whole job's time, from plans (for what is not the stages') and the stages' prediction
    once : what a stage prepares at a level, in the same seconds as its work; None = not known
    """
    frame = scene.camera.rect
    new = list(what_is_new(stages, facts))
    usual = {s.name: level_named(s.levels, wish.quality) for s in stages}
    plans = [plan_frame(stages, usual, f, scene, frame, skip, prices, n) for f, n in zip(facts, new, strict=True)]
    shots: dict[int, int] = {}
    for f in facts:
        shots.setdefault(f.shot, f.index)
    options = _options(stages, plans, facts, new, scene, prices, errors, once)
    if wish.budget_s is not None:
        chosen = keep_budget(options, lambda work: seconds_of(plans, work), wish.budget_s)
    elif wish.max_error is not None:
        chosen = keep_error(options, wish.max_error)
    else:
        return ClipPlan(plans, named(options, usual), shots)
    by_shot = {shot: {name: chosen.levels.get((shot, name), level) for name, level in usual.items()} for shot in shots}
    plans = [plan_frame(stages, by_shot[f.shot], f, scene, frame, skip, prices, n) for f, n in zip(facts, new, strict=True)]
    return ClipPlan(plans, chosen, shots)


def _options(
    stages: Sequence[Stage],
    plans: Sequence[FramePlan],
    facts: Sequence[FrameFacts],
    new: Sequence[frozenset[str]],
    scene: Scene,
    prices: Prices,
    errors: Errors,
    once: Once,
) -> dict[Place, list[Option]]:
    """Every level of every stage that runs, shot by shot. A level without a price cannot be chosen by a budget."""
    by_name = {s.name: s for s in stages}
    work: dict[Place, list[dict[str, float]]] = {}
    for plan, f, n in zip(plans, facts, new, strict=True):
        for step in plan.steps:
            work.setdefault((f.shot, step.stage), []).append(terms_of(step.need, f, scene, n))
    out: dict[Place, list[Option]] = {}
    shots = Counter(name for _, name in work)
    for (shot, name), runs in work.items():
        stage = by_name[name]
        for level in stage.levels:
            costs = [prices.predict(f"{name}/{level}", terms) for terms in runs]
            made = once(name, level)
            costs.append(None if made is None else made.times(1 / shots[name]))
            known = [c for c in costs if c is not None]
            cost = sum_correlated(known) if len(known) == len(costs) else Prediction(float("inf"), 0.0, float("inf"))
            error = errors.of(name, level, stage.levels[-1])
            out.setdefault((shot, name), []).append(Option(level, cost, error, len(runs)))
    return out
