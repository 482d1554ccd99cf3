"""Cost of every stage and level on this machine, as a ratio to a yardstick that is timed in the same run.

Yardstick: one cv2.GaussianBlur(float32, 3 channels, sigma 5) of a picture of that size. Stages and yardstick take turns,
each with all cores, and medians are told: a ratio survives a change of machine or of load, a time does not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from arfx.config.load import suggestion
from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.core.stage import Stage, level_named
from arfx.errors import ConfigError
from arfx.measure.bench_scene import BenchScene, bench_scene
from arfx.measure.steps import Chain, FrameBench, Run, Shop, chain_of
from arfx.measure.timed_runs import WALL
from arfx.plan.planner import plan_frame
from arfx.plan.work import terms_of
from arfx.run.worker import keep_memory
from arfx.stages import STAGES

FEWEST, MOST, BUDGET_S = 3, 25, 1.5
SLOW_S = 3.0  # a run that takes longer is not made again for the median
Progress = Callable[[str, int, int], None]


@dataclass
class Cell:
    """One stage at one level on the standard scene. seconds : of each run;  yardstick_s : of the blurs beside them

    chain : of steps, itself the last;  out : what it makes
    """

    frame: FrameBench
    chain: Chain
    out: Rect
    seconds: list[float] = field(default_factory=list)
    yardstick_s: list[float] = field(default_factory=list)

    @property
    def stage(self) -> str:
        return self.chain[-1][0]

    @property
    def level(self) -> str:
        return self.chain[-1][1]

    @cached_property
    def run(self) -> Run:
        """Threads share it. What comes before is rendered, and itself prepared, when it is first asked for."""
        return self.frame.run(self.chain)

    def prepare(self) -> None:
        """What is made once per clip."""
        self.frame.shop.at(self.stage, self.level)

    def go(self, facts: FrameFacts | None = None) -> None:
        self.run.anew(self.out, facts)

    def terms(self, facts: FrameFacts | None = None) -> dict[str, float]:
        """Of its price (plan/work.py)."""
        return terms_of(self.run.need(self.out), facts or self.run.facts, self.run.at.scene)

    @property
    def done(self) -> bool:
        fewest = 1 if max(self.seconds, default=0.0) > SLOW_S else FEWEST
        return len(self.seconds) >= MOST or (len(self.seconds) >= fewest and sum(self.seconds) > BUDGET_S)

    def to_json(self) -> dict[str, Any]:
        camera = self.frame.shop.scene.camera
        ms, yard = 1e3 * float(np.median(self.seconds)), 1e3 * float(np.median(self.yardstick_s))
        return {
            "stage": self.stage, "level": self.level, "size": f"{camera.width}x{camera.height}", "ms": ms,
            "yardstick_ms": yard, "ratio": ms / yard, "runs": len(self.seconds), "area_px": self.out.area,
        }  # fmt: skip


def bench(
    sizes: Sequence[tuple[int, int]],
    stage: str | None = None,
    level: str | None = None,
    progress: Progress = lambda *_: None,
    stages: Mapping[str, type[Stage]] = STAGES,
) -> list[dict[str, Any]]:
    """Rows of {stage, level, size, ms, yardstick_ms, ratio, runs, area_px}; ms >= 0, medians.

    stage, level : only these;  sizes : (width, height) px
    Raises ConfigError for an unknown stage, a level that no chosen stage has, or a size below 64x64.
    """
    check(stages, stage, level, sizes)
    keep_memory()  # as a worker does
    rows = []
    for size in sizes:
        cells = make_cells(bench_scene(*size), stage, level, stages)
        _take_turns(cells, size, lambda done, total, size=size: progress(f"bench {size[0]}x{size[1]}", done, total))  # type: ignore[misc]
        rows += [c.to_json() for c in cells]
    return rows


def check(stages: Mapping[str, type[Stage]], stage: str | None, level: str | None, sizes: Sequence[tuple[int, int]]) -> None:
    if stage is not None and stage not in stages:
        raise ConfigError(f"there is no stage {stage!r}", suggestion(stage, list(stages)))
    for width, height in sizes:
        if min(width, height) < 64 or max(width, height) > 8192:
            raise ConfigError(f"size {width}x{height} cannot be benchmarked", "from 64 to 8192 px a side: 1280x720")
    chosen = [stages[stage]] if stage is not None else list(stages.values())
    levels = {level for s in chosen for level in s.levels}
    if level is not None and level not in levels:
        where = f" of stage {stage!r}" if stage else ""
        raise ConfigError(f"no such level {level!r}{where}", suggestion(level, sorted(levels)))


def make_cells(at: BenchScene, stage: str | None, level: str | None, stages: Mapping[str, type[Stage]]) -> list[Cell]:
    """What is to be timed; the layers that a stage reads are made once by the standard levels of those before it.

    Stages that require measured depth are timed on the same scene with a depth map.
    """
    made: dict[str, Stage] = {name: stages[name]() for name in stages}
    wanted = {stage} if stage is not None else set(made)
    deep = {name for name in wanted if "depth" in made[name].requires}
    scenes = [(at, wanted - deep), (at.in_depth(), deep)] if deep else [(at, wanted)]
    return [cell for scene, names in scenes if names for cell in _cells(scene, made, names, level)]


def _cells(at: BenchScene, made: Mapping[str, Stage], wanted: Collection[str], level: str | None) -> list[Cell]:
    """Of the stages with these names."""
    standard = {name: level_named(s.levels, "standard") for name, s in made.items()}
    whole = at.scene.camera.rect
    plan = plan_frame(list(made.values()), standard, at.facts, at.scene, whole)
    if not any(s.stage in wanted for s in plan.steps):
        stage = next(iter(wanted))
        why = next((s.reason for s in plan.skipped if s.stage == stage), "")
        raise ConfigError(f"the standard scene does not use {stage!r}: {why}", f"one of {', '.join(s.stage for s in plan.steps)}")
    frame = FrameBench(at.facts, at.plate, plan, whole, Shop(at.scene, made), real_depth_m=at.real_depth_m)
    chain = chain_of(plan, standard)
    return [
        Cell(frame, (*chain[:k], (step.stage, le)), step.out)
        for k, step in enumerate(plan.steps)
        if step.stage in wanted
        for le in made[step.stage].levels
        if level in (None, le)
    ]


def _take_turns(cells: list[Cell], size: tuple[int, int], progress: Callable[[int, int], None]) -> None:
    picture = np.random.default_rng(1).random((size[1], size[0], 3), np.float32)
    for _ in range(3):
        cv2.GaussianBlur(picture, (0, 0), 5)
    for cell in cells:  # loads, allocates, uploads: not counted, unless so slow that it hardly matters
        seconds = WALL.of(cell.go)
        if seconds > SLOW_S:
            _count(cell, seconds, picture)
    while waiting := [c for c in cells if not c.done]:
        for cell in waiting:
            _count(cell, WALL.of(cell.go), picture)
        progress(sum(c.done for c in cells), len(cells))


def _count(cell: Cell, seconds: float, picture: np.ndarray) -> None:
    start = time.perf_counter()
    cv2.GaussianBlur(picture, (0, 0), 5)
    cell.seconds.append(seconds)
    cell.yardstick_s.append(time.perf_counter() - start)
