"""What a level costs per frame, told from tiles of a stage whose cost is known to the last
pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Stage, View
from arfx.measure.steps import FrameRenderer, PreparedStages
from arfx.measure.tradeoff_time import Tiles, Times, time_frame
from tests.scenes import camera, facts, look_at, scene

ALONE_S, BOX_S, REST_S, NEW_S = 0.05, 60e-6, 2e-6, 0.4


class Slow(Stage):
    """A stage that takes its time by the clock it is given: dear in the object's box, and
    unevenly so; cheap elsewhere.
    """

    name = "slow"
    levels = ("draft", "reference")

    def __init__(self, box: Rect, seed: int, reads: bool = False) -> None:
        """reads : it takes time for what it reads, not for what it makes"""
        self.by_reading = reads
        y, x = np.indices((480, 640))
        inside = (x >= box.x0) & (x < box.x1) & (y >= box.y0) & (y < box.y1)
        uneven = np.random.default_rng(seed).uniform(0.7, 1.3, (480, 640)) * (
            1 + 0.5 * np.sin(x / 40 + seed)
        )
        self.seconds = np.where(inside, BOX_S * uneven, REST_S)
        self.now_s, self.most_px = 0.0, 0

    def needs(self, out: Rect, *_: Any) -> Rect:
        return out.pad(9)

    def run(self, view: View, prepared: Any) -> dict[Layer, np.ndarray]:
        share = 1.0 if view.level == "reference" else 1e-3
        self.most_px = max(self.most_px, view.out.area if view.level == "reference" else 0)
        made = view.memo.of_light.made
        view.memo.of_light.get("the light", lambda: 1)
        self.now_s += NEW_S * share * (view.memo.of_light.made - made)
        where = view.rect if self.by_reading else view.out
        self.now_s += share * (ALONE_S + float(self.seconds[where.slices].sum()))
        return {Layer.IMAGE: view[Layer.IMAGE]}


def measured(
    seed: int, new: float = 0.0, frames: int = 2, reads: bool = False
) -> tuple[Times, Slow, float]:
    """The times, the stage, and what a whole frame takes in truth."""
    s = scene(camera(640, 480))
    seen = facts(s, look_at(0.6), seed)
    out = seen.model_box.pad(60).clip(s.camera.rect)
    stage = Slow(seen.model_box, seed, reads)
    plan = FramePlan(
        seed,
        out,
        out,
        (Step("slow", "draft", out, out.pad(9).clip(s.camera.rect), "", None),),
        (),
    )
    times, prepared = Times(clock=lambda: stage.now_s), PreparedStages(s, {"slow": stage})
    wanted, slow = (
        frozenset({("slow", "draft"), ("slow", "reference")}),
        frozenset({("slow", "reference")}),
    )
    for k in range(frames):
        at = seen.with_(index=100 * seed + k)
        frame = FrameRenderer(
            at, np.zeros((480, 640, 3), np.float32), plan, s.camera.rect, prepared, slow
        )
        time_frame(times, frame, {"slow": "draft"}, wanted, {"slow": new})
    whole = out.pad(9).clip(s.camera.rect) if reads else out
    return times, stage, ALONE_S + float(stage.seconds[whole.slices].sum())


def test_tiles_tell_a_whole_frame_within_their_interval() -> None:
    held = 0
    for seed in range(20):
        times, stage, truth = measured(seed)
        found = times.of(("slow", "reference"))
        assert found is not None and stage.most_px < 5000, "never the whole"
        assert found.seconds == pytest.approx(truth, rel=0.35)
        held += found.low_s <= truth <= found.high_s
        # a level that is fast is run over the whole, so it is exact
        assert times.of(("slow", "draft")).seconds == pytest.approx(1e-3 * truth)  # type: ignore[union-attr]
    assert held >= 17, f"{held} of 20: nine in ten are promised"


def test_a_stage_that_takes_its_time_for_what_it_reads_is_held_too() -> None:
    held = 0
    for seed in range(20):
        times, _, truth = measured(seed, reads=True)
        found = times.of(("slow", "reference"))
        assert found is not None
        held += found.low_s <= truth <= found.high_s
    assert held >= 17, f"{held} of 20: nine in ten are promised"


def test_a_light_that_is_new_in_every_other_frame_costs_half_of_what_it_takes() -> None:
    still, changing = (measured(3, new)[0] for new in (0.0, 0.5))
    for level, share in (("draft", 1e-3), ("reference", 1.0)):
        a, b = still.of(("slow", level)), changing.of(("slow", level))
        assert (
            a is not None
            and b is not None
            and b.seconds - a.seconds == pytest.approx(0.5 * NEW_S * share, rel=0.01)
        )


def test_what_was_not_timed_is_not_known() -> None:
    assert Times().of(("dof", "draft")) is None
    one = Tiles([0.1], {"box": [(100, 0.3)]})
    found = one.over({"box": 1000, "rest": 500})
    assert (
        found.seconds == pytest.approx(0.1 + 1500 * 0.002)
        and found.high_s > 4 * found.seconds
    ), "one tile tells little"
    assert EMPTY.area == 0
