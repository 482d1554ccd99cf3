"""The shipped errors and prices by themselves: levels are steps, of which each is worth its
time.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import arfx.plan.errors
from arfx.core.cost import shipped_prices
from arfx.core.stage import level_named
from arfx.measure.bench_scene import bench_scene
from arfx.plan.errors import errors_of_clip, shipped_errors
from arfx.plan.planner import plan_frame
from arfx.stages import ON_DEPTH, STAGES

BETWEEN_LEVELS = {
    name: stage.levels for name, stage in STAGES.items() if len(stage.levels) > 1
}
STEP, HALF = 1.6, 0.5  # in time at least, or of the error at most
ROUNDING = 0.005  # grey levels, of pictures in whole ones


def shipped_table() -> dict[str, Any]:
    text = (
        Path(arfx.plan.errors.__file__)
        .with_name("default_errors.json")
        .read_text(encoding="utf-8")
    )
    return dict(json.loads(text))


def seconds(stage: str, level: str) -> float:
    """Of a frame of the benchmark's standard scene, by the shipped prices."""
    at = bench_scene(1280, 720)
    if stage in ON_DEPTH:
        at = at.with_depth()
    stages = [s() for s in STAGES.values()]
    levels = {
        s.name: level_named(s.levels, level if s.name == stage else "standard")
        for s in stages
    }
    plan = plan_frame(
        stages,
        levels,
        at.facts,
        at.scene,
        at.scene.camera.rect,
        prices=shipped_prices(),
    )
    return next(s.cost.seconds for s in plan.steps if s.stage == stage)


def test_every_level_has_an_error_and_a_price_and_each_step_up_is_worth_it() -> None:
    """By the mean over the clips: the upper end may be that of one clip in which levels
    differ in nothing but rounding.
    """
    errors, table, bad = shipped_errors(), shipped_table()["errors"], []
    for stage, levels in BETWEEN_LEVELS.items():
        upper = [errors.known(stage, level, levels[-1]) for level in levels]
        assert None not in upper, f"{stage}: a level whose error is not known"
        assert all(a > b for a, b in pairwise(upper)), f"{stage}: {upper}"
        known = [*(table[stage][level]["mean"] for level in levels[:-1]), 0.0]
        times = [seconds(stage, level) for level in levels]
        for (level, more, least), (_, less, most) in pairwise(
            zip(levels[:-1], known, times, strict=False)
        ):
            if not (
                less < more
                and most > least
                and (most >= STEP * least or less <= HALF * more)
            ):
                bad.append(
                    f"{stage}, up from {level}: {least:.4f} to {most:.4f} s, error"
                    f" {more:.3f} to {less:.3f}"
                )
        assert known[-2] > 0 and times[-1] > times[-2], stage
    assert not bad


def test_errors_fall_from_level_to_level_on_every_clip() -> None:
    clips = shipped_table()["clips"]
    assert set(clips) == set(BETWEEN_LEVELS) and all(
        len(of) >= 2 for of in clips.values()
    ), "an effect on one clip alone"
    for stage, of in clips.items():
        for clip, errors in of.items():
            assert len(errors) == len(BETWEEN_LEVELS[stage]) - 1
            assert all(a >= b - ROUNDING for a, b in pairwise([*errors, 0.0])), (
                f"{stage} on {clip}: {errors}"
            )


def test_the_tool_writes_what_a_plan_reads_and_marks_what_is_no_step(
    tmp_path: Path,
) -> None:
    from tools.measure_errors import document, faults

    levels = ("draft", "standard", "high", "reference")
    clip = {
        le: {"error": e, "seconds": s}
        for le, e, s in zip(
            levels, (2.0, 0.9, 0.8, 0.0), (1.0, 1.1, 1.3, 90.0), strict=True
        )
    }
    assert [level for level, _ in faults(clip, levels)] == ["high"], (
        "a step may cost next to nothing where it halves the error"
    )
    assert [
        level
        for level, _ in faults(
            {**clip, "standard": {"error": 0.9, "seconds": 0.9}}, levels
        )
    ] == ["standard", "high"]
    other = {
        le: {"error": 3 * of["error"], "seconds": of["seconds"]}
        for le, of in clip.items()
    }
    made = document({"a": {"dof": clip}, "b": {"dof": other}}, {"dof": levels}, 2)
    (tmp_path / "made.json").write_text(json.dumps(made))
    assert errors_of_clip(tmp_path / "made.json").of(
        "dof", "draft", "reference"
    ) == pytest.approx(2 + 0.95 * 4)
    assert made["clips"]["dof"] == {"a": [2.0, 0.9, 0.8], "b": [6.0, 2.7, 2.4]}
