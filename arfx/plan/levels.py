"""Which level of which stage, between two cuts: the cheapest within an error, or the best
within a budget.

Every stage of every shot has levels with a price and an error. Those worth taking lie on
the lower convex hull of (seconds, error); going down it, each step loses more error per
second saved than the one before. All steps of a clip, sorted by that rate, are one way from
the reference down to the cheapest: a budget or an error only says where on it to stop. So
less budget never means less error, and never more predicted time."""

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

from arfx.core.cost import Prediction, measured, sum_independent

ShotStage = tuple[int, str]  # shot, stage


class Option(NamedTuple):
    """One level of one stage over one shot. error : mean grey levels;  frames : in which it runs"""

    level: str
    cost: Prediction
    error: float
    frames: int


class LevelChoice(NamedTuple):
    """levels : by (shot, stage);  stages : predicted, all shots and workers together;
    error : of the worst shot, grey levels
    met : the limit holds;  why : in words"""

    levels: Mapping[ShotStage, str]
    stages: Prediction
    error: float
    met: bool
    why: str


def convex_hull(options: Iterable[Option]) -> list[Option]:
    """The levels worth taking, most expensive first: error lost per second saved only grows
    from one to the next.
    """
    hull: list[Option] = []
    for option in sorted(options, key=lambda o: (-o.cost.seconds, o.error)):
        # a level with no more error for less time makes those above it pointless
        while (
            hull
            and option.error <= hull[-1].error
            and option.cost.seconds <= hull[-1].cost.seconds
        ):
            hull.pop()
        while len(hull) > 1 and _rate(hull[-2], hull[-1]) >= _rate(hull[-2], option):
            hull.pop()
        if not hull or option.cost.seconds < hull[-1].cost.seconds:
            hull.append(option)
    return hull


def _rate(a: Option, b: Option) -> float:
    saved = a.cost.seconds - b.cost.seconds
    return (b.error - a.error) * a.frames / saved if saved > 0 else math.inf


def best_within_budget(
    options: Mapping[ShotStage, Sequence[Option]],
    seconds_of: Callable[[Prediction], float],
    budget_s: float,
) -> LevelChoice:
    """The best levels with which a job stays within its budget.

    seconds_of : upper end of the whole job's time for a prediction of the stages' work;
    budget_s >= 0
    met is False where even the cheapest levels take longer."""
    start, steps = _start(options)

    def after(count: int) -> dict[ShotStage, Option]:
        return start | {key: option for _, key, option in steps[:count]}

    @cache
    def upper_s(count: int) -> float:
        return seconds_of(total(after(count)))

    # each step saves time; of a clip with many shots there are too many to try all
    count = bisect_left(range(len(steps)), True, key=lambda k: upper_s(k) <= budget_s)
    state, upper = after(count), upper_s(count)
    if upper <= budget_s:
        return _choice(
            state,
            True,
            f"{upper:.1f} s at most, nine times in ten, of {budget_s:.1f} s",
        )
    return _choice(
        state,
        False,
        f"even the cheapest levels take up to {upper:.1f} s, not {budget_s:.1f} s",
    )


def cheapest_within_error(
    options: Mapping[ShotStage, Sequence[Option]], limit: float
) -> LevelChoice:
    """The cheapest levels whose errors add up to at most `limit` grey levels in every shot.

    Differences of pictures add up to no more than the sum of their sizes, so the sum over
    the stages is a bound."""
    state, steps = _start(options)
    stages: dict[int, list[ShotStage]] = {}
    for key in state:
        stages.setdefault(key[0], []).append(key)
    blocked: set[ShotStage] = set()
    for _, key, option in steps:
        if (
            key not in blocked
            and sum((option if k == key else state[k]).error for k in stages[key[0]])
            <= limit
        ):
            state[key] = option
        else:
            blocked.add(key)
    error = _worst(state)
    return _choice(
        state,
        error <= limit,
        f"errors add up to {error:.2f} of {limit:.2f} grey levels",
    )


def _start(
    options: Mapping[ShotStage, Sequence[Option]],
) -> tuple[dict[ShotStage, Option], list[tuple[float, ShotStage, Option]]]:
    """The most expensive levels worth taking, and every step down from them: (rate, of
    what, to what), lowest rate first.
    """
    hulls = {key: convex_hull(every) for key, every in options.items()}
    steps = [
        (_rate(a, b), key, b)
        for key, hull in hulls.items()
        for a, b in itertools.pairwise(hull)
    ]
    # sorted() keeps the order of equal rates: those of one stage go down one by one
    return {key: hull[0] for key, hull in hulls.items()}, sorted(
        steps, key=lambda step: step[0]
    )


def _worst(state: Mapping[ShotStage, Option]) -> float:
    """Error of the worst shot."""
    errors: dict[int, float] = {}
    for (shot, _), option in state.items():
        errors[shot] = errors.get(shot, 0.0) + option.error
    return max(errors.values(), default=0.0)


def total(state: Mapping[ShotStage, Option]) -> Prediction:
    """Work of all stages."""
    return sum_by_stage((stage, o.cost) for (_, stage), o in state.items())


def sum_by_stage(costs: Iterable[tuple[str, Prediction]]) -> Prediction:
    """Predictions of one stage are all wrong by the same factor, those of different stages
    independently.
    """
    by_stage: dict[str, list[Prediction]] = {}
    for stage, cost in costs:
        by_stage.setdefault(stage, []).append(cost)
    return sum_independent(map(sum_correlated, by_stage.values()))


def sum_correlated(parts: Iterable[Prediction]) -> Prediction:
    """The sum of predictions that are all wrong by the same factor."""
    return Prediction(*map(float, map(sum, zip(measured(0), *parts, strict=True))))


def _choice(state: Mapping[ShotStage, Option], met: bool, why: str) -> LevelChoice:
    return LevelChoice(
        {key: o.level for key, o in state.items()},
        total(state),
        _worst(state),
        met,
        why,
    )
