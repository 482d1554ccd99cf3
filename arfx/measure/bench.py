"""Cost of every stage and level on this machine, as a ratio to a yardstick that is timed in
the same run.

Yardstick: one cv2.GaussianBlur(float32, 3 channels, sigma 5) of a picture of that size.
Stages and yardstick take turns,
each with all cores, and medians are reported: a ratio survives a change of machine or of
load, a time does not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.config.load import suggestion
from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.core.stage import Stage, level_named
from arfx.core.waiting import Progress
from arfx.errors import ConfigError
from arfx.measure.bench_scene import BenchScene, bench_scene
from arfx.measure.steps import Chain, FrameRenderer, PreparedStages, StageRun
from arfx.measure.timing import WALL
from arfx.plan.errors import Errors, shipped_errors
from arfx.plan.planner import plan_frame, terms_of
from arfx.run.worker import keep_memory
from arfx.stages import ON_DEPTH, STAGES

MIN_RUNS, MAX_RUNS, BUDGET_S = 3, 25, 1.5
SLOW_S = 3.0  # a run that takes longer is not made again for the median


@dataclass
class Cell:
    """One stage at one level on the standard scene. seconds : of each run;  yardstick_s :
    of the blurs beside them

    before : the steps before it;  out : what it makes"""

    frame: FrameRenderer
    before: Chain
    stage: Stage
    level: str
    out: Rect
    seconds: list[float] = field(default_factory=list)
    yardstick_s: list[float] = field(default_factory=list)

    @cached_property
    def run(self) -> StageRun:
        """Threads share it. When it is first asked for, the steps before are rendered, and
        the stage is prepared.
        """
        return self.frame.run((*self.before, (self.stage, self.level)))

    def render(self, facts: FrameFacts | None = None) -> None:
        self.run.rerun(self.out, facts)

    def terms(self, facts: FrameFacts | None = None) -> dict[str, float]:
        """Of its price (`arfx.plan.planner.terms_of`)."""
        run = self.run
        return terms_of(run.need(self.out), facts or run.facts, run.at.scene)

    @property
    def done(self) -> bool:
        runs, least = len(self.seconds), MIN_RUNS
        if max(self.seconds, default=0.0) > SLOW_S:
            least = 1
        return runs >= (least if sum(self.seconds) > BUDGET_S else MAX_RUNS)

    def to_json(self, errors: Errors) -> dict[str, Any]:
        camera = self.frame.prepared.scene.camera
        name, best = self.stage.name, self.stage.levels[-1]
        both = 1e3 * np.median([self.seconds, self.yardstick_s], axis=1)
        ms, yardstick_ms = both.tolist()
        return {
            "stage": name,
            "level": self.level,
            "size": f"{camera.width}x{camera.height}",
            "ms": ms,
            "yardstick_ms": yardstick_ms,
            "ratio": ms / yardstick_ms,
            "error": errors.known(name, self.level, best),
            "runs": len(self.seconds),
            "area_px": self.out.area,
        }


def bench(
    sizes: Sequence[tuple[int, int]],
    stage: str | None = None,
    level: str | None = None,
    progress: Progress = lambda *_: None,
    errors: Errors | None = None,
) -> list[dict[str, Any]]:
    """Rows of {stage, level, size, ms, yardstick_ms, ratio, error, runs, area_px}; ms >= 0,
    medians; error None = not measured.

    stage, level : only these;  sizes : (width, height) px;  errors : None = those that are shipped
    Raises ConfigError for an unknown stage, a level that no chosen stage has, or a size
    below 64x64."""
    check(stage, level, sizes)
    keep_memory()  # as a worker does
    rows = []
    for size in sizes:
        cells = make_cells(bench_scene(*size), stage, level)
        if not cells:
            what = stage or f"level {level}"
            raise ConfigError(
                f"in the standard scene of {size[0]}x{size[1]} px there is nothing for"
                f" {what} to do",
                "another size, such as 1280x720",
            )
        _interleave(cells, size, partial(progress, f"bench {size[0]}x{size[1]}"))
        rows += [c.to_json(errors or shipped_errors()) for c in cells]
    return rows


def check(
    stage: str | None,
    level: str | None,
    sizes: Sequence[tuple[int, int]],
) -> None:
    if stage is not None and stage not in STAGES:
        raise ConfigError(
            f"there is no stage {stage!r}", suggestion(stage, list(STAGES))
        )
    for width, height in sizes:
        if min(width, height) < 64 or max(width, height) > 8192:
            raise ConfigError(
                f"size {width}x{height} cannot be benchmarked",
                "from 64 to 8192 px a side: 1280x720",
            )
    chosen = STAGES if stage is None else [stage]
    levels = {level for name in chosen for level in STAGES[name].levels}
    if level is not None and level not in levels:
        where = f" of stage {stage!r}" if stage else ""
        raise ConfigError(
            f"no such level {level!r}{where}", suggestion(level, sorted(levels))
        )


def make_cells(at: BenchScene, stage: str | None, level: str | None) -> list[Cell]:
    """What is to be timed; the layers that a stage reads are made once by the standard
    levels of those before it.

    Stages that require measured depth are timed on the same scene with a depth map."""
    stages = {name: kind() for name, kind in STAGES.items()}
    standard = {name: level_named(s.levels, "standard") for name, s in stages.items()}
    asked = set(stages) if stage is None else {stage}
    cells = []
    for wanted in filter(None, (asked - ON_DEPTH, asked & ON_DEPTH)):
        seen = at.with_depth() if wanted <= ON_DEPTH else at
        scene, whole = seen.scene, seen.scene.camera.rect
        plan = plan_frame([*stages.values()], standard, seen.facts, scene, whole)
        frame = FrameRenderer(
            seen.facts,
            seen.plate,
            plan,
            stages,
            whole,
            PreparedStages(scene),
            seen.real_depth_m,
        )
        chain = frame.chain(standard)
        cells += [
            Cell(frame, chain[:k], stages[step.stage], own, step.out)
            for k, step in enumerate(plan.steps)
            if step.stage in wanted
            for own in stages[step.stage].levels
            if level in (None, own)
        ]
    return cells


def _interleave(
    cells: list[Cell], size: tuple[int, int], progress: Callable[[int, int], None]
) -> None:
    picture = np.random.default_rng(1).random((size[1], size[0], 3), np.float32)
    for _ in range(3):
        cv2.GaussianBlur(picture, (0, 0), 5)
    for cell in cells:
        _ = cell.run  # renders the steps before it
        # loads, allocates, uploads: not counted, unless so slow that it hardly matters
        seconds = WALL.of(cell.render)
        if seconds > SLOW_S:
            _record(cell, seconds, picture)
    while waiting := [c for c in cells if not c.done]:
        for cell in waiting:
            _record(cell, WALL.of(cell.render), picture)
        progress(sum(c.done for c in cells), len(cells))


def _record(cell: Cell, seconds: float, picture: ndarray) -> None:
    cell.seconds.append(seconds)
    cell.yardstick_s.append(WALL.of(lambda: cv2.GaussianBlur(picture, (0, 0), 5)))
