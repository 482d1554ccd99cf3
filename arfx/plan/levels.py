"""Which level of which stage, between two cuts: the cheapest that keeps an error, or the best that keeps a budget.

Every stage of every shot has levels with a price and an error. Those worth taking lie on the lower convex hull of (seconds,
error); going down it, each step loses more error per second saved than the one before. All steps of a clip, sorted by that
rate, are one way from the reference down to the cheapest: a budget or an error only says where on it to stop. So less budget
never means less error, and never more predicted time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from arfx.core.cost import Prediction, measured, sum_independent

Place = tuple[int, str]  # shot, stage
Choice = dict[Place, str]


@dataclass(frozen=True)
class Option:
    """One level of one stage over one shot. error : mean grey levels;  frames : in which it runs"""

    level: str
    cost: Prediction
    error: float
    frames: int


@dataclass(frozen=True)
class Chosen:
    """levels : by (shot, stage);  stages : predicted, all shots and workers together;  error : of the worst shot, grey levels
    met : the wish holds;  why : in words
    """

    levels: Mapping[Place, str]
    stages: Prediction
    error: float
    met: bool
    why: str


@dataclass(frozen=True)
class _Move:
    rate: float
    place: Place
    to: Option


def ladder(options: Iterable[Option]) -> list[Option]:
    """Those worth taking, dearest first: each next one is cheaper, and the error lost per second saved only grows."""
    best: list[Option] = []
    for option in sorted(options, key=lambda o: (-o.cost.seconds, o.error)):
        # a level with no more error for less time makes what is above it pointless
        while best and option.error <= best[-1].error and option.cost.seconds <= best[-1].cost.seconds:
            best.pop()
        while len(best) > 1 and _rate(best[-2], best[-1]) >= _rate(best[-2], option):
            best.pop()
        if not best or option.cost.seconds < best[-1].cost.seconds:
            best.append(option)
    return best


def _rate(a: Option, b: Option) -> float:
    saved = a.cost.seconds - b.cost.seconds
    if saved <= 0:
        return math.inf
    return (b.error - a.error) * a.frames / saved


def keep_budget(options: Mapping[Place, Sequence[Option]], seconds_of: Callable[[Prediction], float], budget_s: float) -> Chosen:
    """The best levels with which a job stays within its budget.

    seconds_of : upper end of the whole job's time for a prediction of the stages' work;  budget_s >= 0
    met is False where even the cheapest levels take longer.
    """
    state, moves = _start(options)
    while seconds_of(total(state)) > budget_s and moves:
        move = moves.pop(0)
        state[move.place] = move.to
    stages = total(state)
    upper = seconds_of(stages)
    met = upper <= budget_s
    why = f"{upper:.1f} s at most, nine times in ten, of {budget_s:.1f} s"
    if not met:
        why = f"even the cheapest levels take up to {upper:.1f} s, not {budget_s:.1f} s"
    return _chosen(state, stages, met, why)


def keep_error(options: Mapping[Place, Sequence[Option]], most: float) -> Chosen:
    """The cheapest levels whose errors add up to at most `most` grey levels in every shot.

    Differences of pictures add up to no more than the sum of their sizes, so the sum over the stages is a bound.
    """
    state, moves = _start(options)
    blocked: set[Place] = set()
    for move in moves:
        if move.place in blocked:
            continue
        error = _shot_error({**state, move.place: move.to}, move.place[0])
        if error <= most:
            state[move.place] = move.to
        else:
            blocked.add(move.place)
    error = max((_shot_error(state, shot) for shot, _ in state), default=0.0)
    return _chosen(state, total(state), error <= most, f"errors add up to {error:.2f} of {most:.2f} grey levels")


def named(options: Mapping[Place, Sequence[Option]], levels: Mapping[str, str]) -> Chosen:
    """levels : by stage, as a quality names them"""
    state = {place: next(o for o in every if o.level == levels[place[1]]) for place, every in options.items()}
    return _chosen(state, total(state), True, "levels named by the quality")


def _start(options: Mapping[Place, Sequence[Option]]) -> tuple[dict[Place, Option], list[_Move]]:
    """The dearest levels worth taking, and every step down from them, the least error lost per second saved first."""
    state: dict[Place, Option] = {}
    moves: list[_Move] = []
    for place, every in options.items():
        worth = ladder(every)
        state[place] = worth[0]
        moves += [_Move(_rate(a, b), place, b) for a, b in itertools.pairwise(worth)]
    # sorted() keeps the order of equal rates: those of one place go down one by one
    return state, sorted(moves, key=lambda m: m.rate)


def _shot_error(state: Mapping[Place, Option], shot: int) -> float:
    return sum(o.error for (s, _), o in state.items() if s == shot)


def total(state: Mapping[Place, Option]) -> Prediction:
    """Work of all stages: the shots of one stage err alike, stages independently."""
    by_stage: dict[str, list[Prediction]] = {}
    for (_, stage), option in state.items():
        by_stage.setdefault(stage, []).append(option.cost)
    return sum_independent(sum_correlated(costs) for costs in by_stage.values())


def sum_correlated(parts: Iterable[Prediction]) -> Prediction:
    """The sum of predictions that are all wrong by the same factor."""
    out = measured(0.0)
    for p in parts:
        out = Prediction(out.seconds + p.seconds, out.low_s + p.low_s, out.high_s + p.high_s)
    return out


def _chosen(state: Mapping[Place, Option], stages: Prediction, met: bool, why: str) -> Chosen:
    error = max((_shot_error(state, shot) for shot, _ in state), default=0.0)
    return Chosen({place: o.level for place, o in state.items()}, stages, error, met, why)
