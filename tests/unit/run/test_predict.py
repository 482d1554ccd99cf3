"""What a job is predicted to take beside its stages' work: who waits, what the report
makes anew.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

import arfx.run.predict as predict_module
from arfx.config.sections import JobConfig
from arfx.core.compiled import work_clock
from arfx.core.cost import Price, Prices, measured
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.plan.clip import ClipPlan, LevelPolicy
from arfx.plan.errors import Errors
from arfx.plan.levels import LevelChoice
from arfx.run.predict import JobPrediction, JobSize, choose, predict, time_of_stages

R = Rect(0, 0, 10, 10)
PRICES = Prices(
    {
        "edit": Price({"frames": 0.0}, 0.1), "encode h264": Price({"frames": 0.01}, 0.1), "join": Price({"frames": 0.001}, 0.1),
        "prepare gi/draft": Price({"frames": 0.5}, 0.1), "prepare lightmap/standard": Price({"frames": 0.2}, 0.1),
    },
    threads=2, calibrated=True,
)  # fmt: skip
SIZE = JobSize(
    frames=120,
    frame_mpx=0.1,
    decode_s=1.2,
    began=5.0,
    codec="h264",
    workers=2,
    threads=True,
    mfaces=0.0,
    checked=frozenset(),
)


def plans(
    busy: range, stage: str = "dof", level: str = "draft", seconds: float = 0.1
) -> list[FramePlan]:
    step = Step(stage, level, R, R, "", measured(seconds))
    return [FramePlan(i, R, R, (step,) if i in busy else (), ()) for i in range(120)]


def of(
    frames: list[FramePlan], size: JobSize = SIZE, prices: Prices = PRICES
) -> JobPrediction:
    prices = replace(
        prices,
        prices={**prices.prices, "prepare dof/draft": Price({"frames": 0.0}, 0.1)},
    )
    return predict(frames, time_of_stages(frames), size, prices)


def test_work_that_lies_in_one_chunk_takes_as_long_as_alone() -> None:
    spread, together = of(plans(range(0, 120, 4))), of(plans(range(30)))
    assert (
        spread.phases["stages"].seconds
        == pytest.approx(together.phases["stages"].seconds)
        == pytest.approx(3.0)
    )
    assert spread.share == pytest.approx(
        0.5, abs=0.05
    ) and together.share == pytest.approx(3.6 / 5.4)
    assert together.wall.seconds > spread.wall.seconds + 0.5, (
        "while one thread renders, the other has nothing left to do"
    )


def test_the_report_prepares_a_stage_again_whose_health_is_checked() -> None:
    frames = plans(range(120), "gi")
    found = predict(
        frames,
        time_of_stages(frames),
        SIZE._replace(checked=frozenset({"gi", "dof"})),
        PRICES,
    )
    assert (
        found.phases["report"].seconds == pytest.approx(0.5)
        and of(plans(range(9))).phases["report"].seconds == 0
    )
    told = found.to_json(PRICES)
    assert (
        told["wall"]["low_s"] < told["wall"]["s"] < told["wall"]["high_s"]
        and told["phases"]["report"]["s"] > 0
    )


def test_one_thread_alone_is_faster_and_a_phase_without_price_makes_the_whole_unknown() -> (
    None
):
    alone = of(plans(range(30)), prices=replace(PRICES, alone=0.6))
    assert alone.wall.seconds < of(plans(range(30))).wall.seconds - 0.2
    assert of(plans(range(30)), SIZE._replace(codec="av1")).wall is None


def test_what_planning_takes_is_in_the_prediction(monkeypatch) -> None:
    def slow(*_: object) -> ClipPlan:
        clock[0] += 0.5
        return ClipPlan([], LevelChoice({}, measured(0.0), 0.0, True, ""), {})

    clock = [7.0]
    monkeypatch.setattr(predict_module, "plan_clip", slow)
    monkeypatch.setattr("time.perf_counter", lambda: clock[0])
    size = SIZE._replace(began=work_clock() - 2)
    made = choose(
        JobConfig(), {}, [], None, LevelPolicy(), Errors({}, ""), PRICES, size
    )[1]  # type: ignore[arg-type]
    assert made["predicted"]["phases"]["before"]["s"] == pytest.approx(2.5)


def test_a_lone_worker_encodes_while_it_renders() -> None:
    one = SIZE._replace(workers=1)
    slow_render, slow_encode = (
        of(plans(range(120)), one),
        of([], one),
    )  # 12 s against 1.2 s; nothing but decoding
    assert slow_render.share == pytest.approx((1.2 + 12.0) / (1.2 + 12.0 + 1.2))
    assert slow_encode.share == pytest.approx(0.5)
