from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arfx.core.cost import Price, Prices
from arfx.core.plan import FramePlan
from arfx.core.rect import EMPTY, Rect
from arfx.core.stage import Demand
from arfx.plan.explain import group_reasons, summarise
from arfx.plan.planner import FORCED, plan_frame
from tests.scenes import facts, scene

SCENE = scene()
FACTS = facts(SCENE)
FRAME = SCENE.camera.rect
LEVEL = "standard"


class Fake:
    levels = (LEVEL,)
    without_object = False

    def __init__(self, name: str, rect: Rect | None, pad: int = 0) -> None:
        empty = rect is not None and rect.empty
        self.name, self._pad = name, pad
        self._demand = Demand(rect, "circle 0.4 px < 1 px" if empty else "because")

    def demand(self, *_: Any) -> Demand:
        return self._demand

    def needs(self, out: Rect, *_: Any) -> Rect:
        return out.pad(self._pad)


BOX = Rect(40, 30, 90, 80)


def pipeline(dof_rect: Rect = EMPTY, raster_rect: Rect = BOX) -> list[Any]:
    return [
        Fake("raster", raster_rect),
        Fake("plain", raster_rect),
        Fake("composite", None),
        Fake("dof", dof_rect, pad=6),
    ]


def plan(stages: list[Any], **kw: Any) -> Any:
    prices = Prices({f"{s.name}/{LEVEL}": Price({"mpx": 0.1}, 0.2) for s in stages})
    return plan_frame(
        stages,
        {s.name: LEVEL for s in stages},
        FACTS,
        SCENE,
        FRAME,
        prices=prices,
        **kw,
    )


def seconds(plan: FramePlan) -> float:
    return sum(s.cost.seconds for s in plan.steps if s.cost is not None)


def test_the_composite_covers_what_changes_and_no_more() -> None:
    p = plan(pipeline())
    assert [s.stage for s in p.steps] == ["raster", "plain", "composite"]
    assert (
        p.changed == BOX
        and p.rect == BOX
        and p.skipped[0].reason == "circle 0.4 px < 1 px"
    )


def test_a_blur_grows_what_earlier_steps_deliver_but_not_what_they_may_change() -> (
    None
):
    p = plan(pipeline(dof_rect=Rect(80, 70, 120, 100)))
    by = {s.stage: s for s in p.steps}
    assert by["dof"].out == BOX.union(Rect(80, 70, 120, 100)).clip(
        Rect(80, 70, 120, 100)
    )
    assert by["dof"].need == Rect(74, 64, 126, 106)
    assert by["raster"].out == BOX, (
        "rendering outside the model's box would be wasted"
    )
    assert p.changed == BOX.union(Rect(80, 70, 120, 100)) and p.rect.contains(
        by["dof"].need
    )


def test_nothing_virtual_means_no_work() -> None:
    p = plan(pipeline(raster_rect=EMPTY))
    assert not p.steps and p.rect.empty and p.changed.empty
    assert {s.stage for s in p.skipped} >= {"raster", "plain", "composite"}


def test_forced_runs_everything_on_the_whole_frame_where_a_pose_is_known() -> None:
    p = plan(pipeline(), skip=False)
    assert [s.stage for s in p.steps] == ["raster", "plain", "composite", "dof"]
    assert all(s.out == FRAME and s.reason == FORCED for s in p.steps)
    absent = plan_frame(pipeline(raster_rect=EMPTY), {n: LEVEL for n in ("raster", "plain", "composite", "dof")},
                        FACTS.with_(camera_from_world=None), SCENE, FRAME, skip=False)  # fmt: skip
    assert not absent.steps


corner = st.tuples(
    st.integers(0, 159), st.integers(0, 119), st.integers(1, 80), st.integers(1, 60)
)


@settings(max_examples=60, deadline=None)
@given(corner, corner, st.integers(0, 20))
def test_every_step_gets_what_later_steps_need(a: tuple, b: tuple, pad: int) -> None:
    ra, rb = (Rect(x, y, x + w, y + h).clip(FRAME) for x, y, w, h in (a, b))
    stages = pipeline(rb, ra)
    stages[3]._pad = pad
    p = plan(stages)
    by = {s.stage: s for s in p.steps}
    for s in p.steps:
        assert (
            FRAME.contains(s.need)
            and s.need.contains(s.out)
            and p.rect.contains(s.need)
            and not s.out.empty
        )
    if "dof" in by:
        assert by["composite"].out.contains(by["dof"].need.clip(ra))
    assert seconds(p) >= 0
    bigger = plan(pipeline(rb.pad(5).clip(FRAME), ra))
    stages[3]._pad = 6
    assert seconds(bigger) >= seconds(plan(stages)) - 1e-12, (
        "more demand never predicts less time"
    )


def test_reasons_that_differ_in_numbers_are_one_line() -> None:
    out = group_reasons(
        [
            "circle 0.2 px < 1 px",
            "marker not visible",
            "circle 0.6 px < 1 px",
            "circle 0.4 px < 1 px",
        ]
    )
    assert out == {"circle 0.2…0.6 px < 1 px": 3, "marker not visible": 1}


def test_summary_counts_every_stage_frame() -> None:
    plans = [plan(pipeline()), plan(pipeline(raster_rect=EMPTY))]
    rows = {
        r["name"]: r
        for r in summarise(plans, ["raster", "plain", "composite", "dof"], FRAME.area)
    }
    assert all(r["frames_run"] + r["frames_skipped"] == 2 for r in rows.values())
    assert rows["raster"]["area_fraction"] == pytest.approx(BOX.area / FRAME.area)
    assert rows["dof"]["frames_run"] == 0 and np.isclose(
        rows["plain"]["predicted_s"], 0.1 * BOX.area / 1e6
    )
