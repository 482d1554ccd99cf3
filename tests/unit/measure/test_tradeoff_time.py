"""What a level costs per frame, of a stage whose cost is known to the last pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from arfx.core.cost import Price, Prices
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.stage import Stage, View
from arfx.measure.steps import FrameRenderer, PreparedStages
from arfx.measure.timing import Stopwatch
from arfx.measure.tradeoff_time import Times
from tests.scenes import camera, facts, look_at, scene

ALONE_S, BOX_S = 0.2, 60e-6  # of a run by itself;  of a pixel of the object's box
NEW_S = 0.4  # of a new light
LIT: dict[int, frozenset[str]] = dict.fromkeys((0, 1), frozenset())


class Slow(Stage):
    """Takes its time by the clock it is given, in the object's box and beside it."""

    name = "slow"
    levels = ("draft", "reference")

    def __init__(self, box: Rect, rest_s: float) -> None:
        y, x = np.indices((480, 640))
        inside = (x >= box.x0) & (x < box.x1) & (y >= box.y0) & (y < box.y1)
        self.seconds = np.where(inside, BOX_S, rest_s)
        self.now_s = 0.0

    def run(self, view: View, prepared: Any) -> dict[Layer, np.ndarray]:
        share = 1.0 if view.level == "reference" else 1e-3
        made = view.memo.of_light.made
        view.memo.of_light.get("the light", lambda: 1)
        self.now_s += NEW_S * share * (view.memo.of_light.made - made)
        self.now_s += share * (ALONE_S + float(self.seconds[view.out.slices].sum()))
        return {Layer.IMAGE: view[Layer.IMAGE]}


class Clock(Stopwatch):
    """The stage's."""

    def __init__(self, stage: Slow) -> None:
        super().__init__()
        object.__setattr__(self, "stage", stage)

    def of(self, work: Callable[[], Any]) -> float:
        start = self.stage.now_s  # type: ignore[attr-defined]
        work()
        return float(self.stage.now_s - start)  # type: ignore[attr-defined]


def test_a_reference_that_is_slow_is_predicted_by_the_price_list() -> None:
    _, stage, frame = slow_frame(2e-6)
    chain = frame.chain({"slow": "reference"})
    area = frame.plan.changed.area / 1e6
    dear = {"slow/reference": Price({"mpx": 10 / area}, 0.2)}
    times = Times([frame], LIT, Prices(dear, calibrated=True), Clock(stage))
    found = times.of(chain)
    assert found.seconds == pytest.approx(10) and times.is_slow(chain)
    assert found.low_s < 10 < found.high_s and stage.now_s == 0
    cheap = {"slow/reference": Price({"mpx": 1 / area}, 0.2)}
    for prices in (cheap, {}):
        times = Times([frame], LIT, Prices(prices), Clock(stage))
        truth = ALONE_S + float(stage.seconds[frame.plan.changed.slices].sum())
        assert times.of(chain).seconds == pytest.approx(truth), "it is run"


def test_what_is_fast_is_run_over_the_whole() -> None:
    _, stage, frame = slow_frame(2e-6)
    times = Times([frame], LIT, Prices({}), Clock(stage))
    found = times.of(frame.chain({"slow": "draft"}))
    truth = 1e-3 * (ALONE_S + float(stage.seconds[frame.plan.changed.slices].sum()))
    assert found.seconds == pytest.approx(truth)


def test_a_light_that_is_new_in_every_other_frame_costs_half_of_what_it_takes() -> (
    None
):
    found = []
    for new in ({}, {1: frozenset({"new_lights"})}):
        _, stage, frame = slow_frame(2e-6)
        stage.terms = ("frames", "new_lights")
        second = replace(frame, facts=frame.facts.with_(index=1))
        times = Times([frame, second], {**LIT, **new}, Prices({}), Clock(stage))
        found.append(times.of(frame.chain({"slow": "draft"})).seconds)
    assert found[1] - found[0] == pytest.approx(0.5 * NEW_S * 1e-3, rel=0.01)


def slow_frame(rest_s: float) -> tuple[Any, Slow, FrameRenderer]:
    s = scene(camera(640, 480))
    seen = facts(s, look_at(0.6), 0)
    out = seen.model_box.pad(60).clip(s.camera.rect)
    stage = Slow(seen.model_box, rest_s)
    plan = FramePlan(0, out, out, (Step("slow", "draft", out, out, "", None),), ())
    plate = np.zeros((480, 640, 3), np.float32)
    stages: Any = {"slow": stage}
    return (
        s,
        stage,
        FrameRenderer(seen, plate, plan, stages, s.camera.rect, PreparedStages(s)),
    )
