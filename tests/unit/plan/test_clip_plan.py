"""The plan of a clip: levels per shot, nothing but levels changed by a wish, light that is new."""

from __future__ import annotations

from dataclasses import replace

from arfx.core.cost import Price, Prices, measured
from arfx.core.light import DirectionalLight, Light
from arfx.core.stage import level_named
from arfx.plan.clip import LevelPolicy, plan_clip
from arfx.plan.errors import Errors
from arfx.plan.planner import new_terms
from arfx.stages import STAGES
from tests.scenes import facts, look_at, scene

SCENE = scene()
NAMES = ("raster", "lightmap", "composite", "dof")
LEVELS = ("draft", "standard", "high", "reference")
PRICES = Prices(
    {f"{n}/{le}": Price({"frames": 0.01 * 4**k, "object_mpx": 1.0}, 0.1, 5) for n in NAMES
     for k, le in enumerate(STAGES[n].levels)}, 1, "a test", True,
)  # fmt: skip
ERRORS = Errors(
    {n: {"draft": 2.0, "standard": 0.6, "high": 0.2} for n in NAMES}, "a test"
)


def clip() -> list:
    """Two shots: ten frames near, four far."""
    near = [facts(SCENE, look_at(0.4), i) for i in range(10)]
    return near + [
        replace(facts(SCENE, look_at(1.2), i), shot=1) for i in range(10, 14)
    ]


def planned(wish: LevelPolicy):
    stages = [STAGES[n]() for n in NAMES]
    return plan_clip(
        stages,
        clip(),
        SCENE,
        wish,
        ERRORS,
        PRICES,
        lambda plans, work: 1.0 + work.high_s,
        skip=True,
        prepare_cost=lambda stage, level: measured(0.0),
    )


def test_levels_are_fixed_between_cuts_and_follow_the_budget() -> None:
    seconds, errors = [], []
    for budget in (1.2, 3, 6, 20, 200):
        made = planned(LevelPolicy(budget_s=budget))
        for shot in (0, 1):
            used = {
                (s.stage, s.level)
                for p, f in zip(made.plans, clip(), strict=True)
                if f.shot == shot
                for s in p.steps
            }
            assert len(used) == len({stage for stage, _ in used}), (
                "one level of a stage in a shot: quality never pops"
            )
        assert {(s.stage, s.level) for p in made.plans for s in p.steps} == {
            (n, le) for (_, n), le in made.choice.levels.items()
        }
        seconds.append(sum(s.cost.seconds for p in made.plans for s in p.steps))
        errors.append(made.choice.error)
    assert (
        seconds == sorted(seconds)
        and errors == sorted(errors, reverse=True)
        and len(set(errors)) >= 3
    )
    told = planned(LevelPolicy(budget_s=20)).explained(
        ERRORS, {n: STAGES[n]() for n in NAMES}
    )
    assert all(r["first_frame"] in (0, 10) for r in told)
    assert {r["error"] for r in told if r["stage"] == "composite"} == {0.0}, (
        "one level, which is the best"
    )


def test_an_error_limit_holds_for_the_sum_over_the_stages() -> None:
    for limit in (0.0, 0.3, 1.0, 3.0, 9.0):
        made = planned(LevelPolicy(max_error=limit))
        for shot in (0, 1):
            found = {n: le for (s, n), le in made.choice.levels.items() if s == shot}
            assert (
                sum(ERRORS.of(n, le, STAGES[n].levels[-1]) for n, le in found.items())
                <= limit + 1e-9
            )


def test_a_named_quality_is_that_quality() -> None:
    made = planned(LevelPolicy("draft"))
    assert all(
        s.level == level_named(STAGES[s.stage].levels, "draft")
        for p in made.plans
        for s in p.steps
    )
    assert any(s.level == "draft" for p in made.plans for s in p.steps)


def test_light_is_new_once() -> None:
    stages = [STAGES["lightmap"](), STAGES["gi"]()]
    lamp = DirectionalLight((0.3, 0.2, 0.9), (0.5, 0.5, 0.5), 4.0)
    f = facts(SCENE)
    lit = replace(f, light=Light(lights=(lamp,)))
    dimmer = replace(f, light=Light(lights=(replace(lamp, rgb=(0.2, 0.2, 0.2)),)))
    gone = replace(f, camera_from_world=None)
    found = list(new_terms(stages, [gone, lit, lit, dimmer, lit]))
    soft = replace(f, light=Light(lights=()))
    assert list(new_terms(stages, [soft])) == [{"new_lights"}], (
        "no lamp, no shadow to make"
    )
    assert found == [
        frozenset(),
        {"new_directions", "new_lights"},
        frozenset(),
        {"new_lights"},
        frozenset(),
    ]
