"""Choose the levels of a job and plan its frames: the analysis is done, nothing is rendered yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from arfx.config.sections import JobConfig
from arfx.core.cost import Prediction, Prices
from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan
from arfx.core.scene import Scene
from arfx.core.stage import Stage
from arfx.errors import ConfigError
from arfx.plan.clip import Wish, plan_clip
from arfx.plan.errors import Errors
from arfx.plan.explain import without_price
from arfx.run.predict import Terms, predict, prepare_one, stages_of, to_json


def wish_of(config: JobConfig, stages: Mapping[str, Stage], prices: Prices) -> Wish:
    """How levels are to be chosen. Raises ConfigError where two ways are asked for, or a budget with a stage without prices."""
    p = config.pipeline
    asked = [f"--{name.replace('_', '-')}" for name in ("budget", "fps", "max_error") if getattr(p, name) is not None]
    if len(asked) > 1:
        raise ConfigError(f"{asked[0]} and {asked[1]} both choose levels", "give one of them")
    unknown = [n for n, s in stages.items() if not any(f"{n}/{level}" in prices.prices for level in s.levels)]
    if unknown and (p.budget is not None or p.fps is not None):
        what, how = without_price(unknown)
        raise ConfigError(f"a budget needs the price of everything, and {what}", how)
    return Wish(p.quality, p.budget, p.max_error)


def choose(
    config: JobConfig, stages: Mapping[str, Stage], facts: Sequence[FrameFacts], scene: Scene, wish: Wish, errors: Errors,
    prices: Prices, terms: Terms, notice: Callable[[str], None],
) -> tuple[list[FramePlan], dict[str, Any]]:  # fmt: skip
    """The plans of all frames, and {predicted, levels}: from here on they stand, whatever the job measures."""
    if config.pipeline.fps is not None:
        wish = replace(wish, budget_s=len(facts) / config.pipeline.fps)

    def upper_s(plans: Sequence[FramePlan], work: Prediction) -> float:
        found = predict(plans, work, terms, prices, prepared=True).wall
        if found is None:
            raise ConfigError(
                f"a budget needs the price of everything, and encoding {terms.codec} has none",
                "--codec h264 or ffv1, or choose by --quality or --max-error",
            )
        return found.high_s

    def once(stage: str, level: str) -> Prediction | None:
        found = prepare_one(stage, level, terms, prices)
        return None if found is None else found.times(terms.workers)  # no worker helps another with it

    made = plan_clip(list(stages.values()), facts, scene, wish, errors, prices, upper_s, config.pipeline.skip, once)
    if not made.chosen.met:
        notice(made.chosen.why)
    if wish.budget_s is not None and not prices.calibrated:
        notice("the budget rests on shipped prices, wide intervals: `arfx bench --calibrate` measures this machine's")
    document = {
        "predicted": to_json(predict(made.plans, stages_of(made.plans), terms, prices), prices),
        "levels": {
            "by": "budget" if wish.budget_s is not None else "error" if wish.max_error is not None else "quality",
            "budget_s": wish.budget_s, "max_error": wish.max_error, "met": made.chosen.met, "why": made.chosen.why,
            "error": made.chosen.error if wish.budget_s is not None or wish.max_error is not None else None,
            "errors_from": errors.source, "chosen": made.explained(errors),
        },
    }  # fmt: skip
    return made.plans, document
