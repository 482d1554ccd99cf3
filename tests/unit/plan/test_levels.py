"""Levels by budget and by error: monotone, within the wish, told where a wish cannot be met."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arfx.core.cost import Prediction, with_spread
from arfx.plan.errors import UNKNOWN, Errors, errors_of_clip, shipped_errors
from arfx.plan.levels import (
    Option,
    best_within_budget,
    cheapest_within_error,
    convex_hull,
    total,
)

NAMES = ("draft", "standard", "high", "reference")


def option(level: str, seconds: float, error: float, spread: float = 0.15) -> Option:
    return Option(level, with_spread(seconds, spread), error, 10)


def options(
    dof: tuple[float, ...] = (1, 2, 5, 60), raster: tuple[float, ...] = (2, 3, 4, 90)
) -> dict:
    errors = (3.0, 0.8, 0.3, 0.0)
    return {
        (0, "raster"): [
            option(n, s, e / 2) for n, s, e in zip(NAMES, raster, errors, strict=True)
        ],
        (0, "dof"): [
            option(n, s, e) for n, s, e in zip(NAMES, dof, errors, strict=True)
        ],
        (1, "dof"): [
            option(n, s / 10, e) for n, s, e in zip(NAMES, dof, errors, strict=True)
        ],
    }


def upper(work: Prediction) -> float:
    return 1.5 + work.high_s / 2


def steps_taken(code: Callable[[], object]) -> int:
    """How many lines are run, each turn of a loop counted: unlike seconds the same on every
    machine.
    """
    count = 0

    def trace(_frame: object, event: str, _argument: object) -> Callable:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        code()
    finally:
        sys.settrace(before)
    return count


def test_levels_that_cost_more_and_err_more_are_not_worth_taking() -> None:
    worth = convex_hull(
        [
            option("draft", 3, 2),
            option("standard", 2, 1),
            option("high", 2.5, 0.9),
            option("reference", 50, 0),
        ]
    )
    assert worth[0].level == "reference" and "draft" not in [o.level for o in worth]
    seconds = [o.cost.seconds for o in worth]
    assert seconds == sorted(seconds, reverse=True)


def test_plenty_of_time_means_the_reference_and_none_the_cheapest_with_the_truth_told() -> (
    None
):
    rich, poor = (
        best_within_budget(options(), upper, 1e6),
        best_within_budget(options(), upper, 0.1),
    )
    assert set(rich.levels.values()) == {"reference"} and rich.met and rich.error == 0
    assert (
        set(poor.levels.values()) == {"draft"}
        and not poor.met
        and "even the cheapest" in poor.why
    )


@settings(max_examples=80, deadline=None)
@given(st.lists(st.floats(0.05, 300), min_size=2, max_size=6))
def test_a_smaller_budget_never_predicts_more_time_nor_less_error(
    budgets: list[float],
) -> None:
    chosen = [best_within_budget(options(), upper, b) for b in sorted(budgets)]
    for less, more in zip(chosen, chosen[1:], strict=False):  # noqa: RUF007
        assert (
            less.stages.seconds <= more.stages.seconds + 1e-9
            and less.error >= more.error - 1e-9
        )
    for c, b in zip(chosen, sorted(budgets), strict=True):
        assert upper(c.stages) <= b or not c.met


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 6), st.floats(0, 6))
def test_an_error_is_kept_in_every_shot_and_less_error_is_never_cheaper(
    a: float, b: float
) -> None:
    low, high = (cheapest_within_error(options(), e) for e in sorted((a, b)))
    assert low.met and high.met and low.error <= min(a, b) + 1e-9
    assert low.stages.seconds >= high.stages.seconds - 1e-9


def test_a_level_whose_error_was_never_measured_is_no_choice_for_an_error_and_the_last_for_a_budget() -> (
    None
):
    errors = Errors({"dof": {"standard": 0.5}}, "a test")
    assert (
        errors.of("dof", "reference", "reference") == 0
        and errors.of("dof", "draft", "reference") == UNKNOWN
    )
    every = {
        (0, "dof"): [
            option(n, s, errors.of("dof", n, "reference"))
            for n, s in zip(NAMES, (1, 2, 5, 60), strict=True)
        ]
    }
    assert cheapest_within_error(every, 10.0).levels[0, "dof"] == "standard"
    assert best_within_budget(every, upper, 0.0).levels[0, "dof"] == "draft"
    assert total({(0, "dof"): every[0, "dof"][0]}).seconds == 1


def test_of_many_clips_the_upper_end_counts_and_of_one_its_own(tmp_path) -> None:
    (tmp_path / "t.json").write_text(
        '{"errors": {"dof": {"draft": {"low": 0.2, "mean": 0.7, "high": 1.5}, "high":'
        ' 0.1}}, "source": "x"}'
    )
    found = errors_of_clip(tmp_path / "t.json")
    assert (
        found.of("dof", "draft", "reference"),
        found.known("dof", "high", "reference"),
    ) == (1.5, 0.1)
    assert (
        found.known("dof", "reference", "reference") == 0
        and found.known("no such", "draft", "reference") is None
    )
    assert found.by_level["raster"] == shipped_errors().by_level["raster"], (
        "what the clip did not measure"
    )


def test_the_shipped_errors_name_real_levels_and_a_wrong_file_is_refused(
    tmp_path,
) -> None:
    from arfx.errors import InputError
    from arfx.stages import STAGES

    for stage, levels in shipped_errors().by_level.items():
        assert set(levels) <= set(STAGES[stage].levels)
    for wrong in ("-1", '{"low": 0.1}', '{"high": -2}', "[1]"):
        (tmp_path / "t.json").write_text(
            f'{{"errors": {{"dof": {{"draft": {wrong}}}}}, "source": "x"}}'
        )
        with pytest.raises(InputError, match=r"tradeoff\.json"):
            errors_of_clip(tmp_path / "t.json")


def test_of_a_clip_with_many_shots_few_ways_are_tried_and_the_dearest_that_fits_is_taken() -> (
    None
):
    many = {(shot, "dof"): options()[0, "dof"] for shot in range(3000)}
    asked: list[float] = []

    def upper_of(work: Prediction) -> float:
        asked.append(work.high_s)
        return upper(work)

    budget_s = upper(total({key: every[1] for key, every in many.items()}))
    chosen = best_within_budget(many, upper_of, budget_s)
    assert len(asked) < 30
    saved_by_one = 3 * 1.2 / 2  # from high to standard, upper end
    assert chosen.met and 0 <= budget_s - upper(chosen.stages) <= 2 * saved_by_one
    within = cheapest_within_error(many, 0.8)
    assert within.met and set(within.levels.values()) == {"standard"}
    few = {key: every for key, every in many.items() if key[0] < 300}
    steps, fewer = (
        steps_taken(lambda o=o: cheapest_within_error(o, 0.8)) for o in (many, few)
    )  # type: ignore[misc]
    assert steps < 11 * fewer, "ten times as many shots"
