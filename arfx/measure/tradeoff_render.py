"""One frame rendered again and again with other levels; what steps have in common is rendered once.

A reference costs minutes over a whole picture, so the slow levels are rendered in a window only: what a stage computes on a
crop is what it computes on the whole (tests/contract, the ROI law). Their time is told for the whole step, by its pixels.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from arfx.core.colour import Transfer
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Level, Stage, Window
from arfx.run.frame import Canvas, rng_for

NEAR_PX = 16
AGAIN_S = 1.0
KEPT = 5
SRGB = Transfer("srgb")
Chain = tuple[tuple[str, str], ...]  # (stage, level) in running order; a stage left out is absent


@dataclass
class Shop:
    """What is prepared once for all frames. stages : by name, under the formula of the job or another one"""

    scene: Scene
    stages: Mapping[str, Stage]
    prepared: dict[tuple[str, str], Any] = field(default_factory=dict)
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)
    spent_s: dict[str, float] = field(default_factory=dict)  # by "stage/level": what the measuring itself took

    def at(self, stage: str, level: Level) -> Any:
        key = (stage, level.name)
        if key not in self.prepared:
            start = time.perf_counter()
            self.prepared[key] = self.stages[stage].prepare(self.scene, level)
            self.prepare_s[key] = time.perf_counter() - start
        return self.prepared[key]


@dataclass
class FrameBench:
    """A frame and all that was rendered of it.

    plate : (h, w, 3) linear, whole frame;  plan : at the job's own levels;  window : where references are rendered
    slow : (stage, level) that are rendered for the window alone
    seconds : of one run of a stage at a level over all that the plan asks of it, the last one measured
    """

    facts: FrameFacts
    plate: np.ndarray
    plan: FramePlan
    window: Rect
    shop: Shop
    slow: frozenset[tuple[str, str]]
    made: dict[tuple[Chain, bool], Canvas] = field(default_factory=dict)
    shown: dict[Chain, np.ndarray] = field(default_factory=dict)
    seconds: dict[tuple[str, str], float] = field(default_factory=dict)

    def image(self, chain: Chain) -> np.ndarray:
        """(h, w, 3) uint8 sRGB of the window after these steps."""
        if chain not in self.shown:
            canvas = self._run(chain, any(step in self.slow for step in chain))
            if Layer.IMAGE in canvas.stored:
                self.shown[chain] = _srgb8(canvas.view(frozenset({Layer.IMAGE}), self.window)[Layer.IMAGE])
            else:
                self.shown[chain] = self.original()
        return self.shown[chain]

    def original(self) -> np.ndarray:
        """The same of the frame as it was."""
        return _srgb8(self.plate[self.window.slices])

    def coverage(self, chain: Chain) -> np.ndarray:
        """(h, w) of the window."""
        canvas = self._run(chain, any(step in self.slow for step in chain))
        return np.asarray(canvas.view(frozenset({Layer.COVERAGE}), self.window)[Layer.COVERAGE])

    def _run(self, chain: Chain, narrow: bool) -> Canvas:
        """narrow : only what the window needs. The steps before the last are looked up, or made and kept."""
        key = (chain, narrow)
        if key in self.made:
            self.made[key] = self.made.pop(key)  # used last
            return self.made[key]
        if not chain:
            frame = self.shop.scene.camera.rect
            canvas = Canvas(self.plate, frame)
        else:
            before = self._run(chain[:-1], narrow)
            canvas = Canvas(before.plate, before.rect)
            canvas.stored = dict(before.stored)
            name, level_name = chain[-1]
            stage = self.shop.stages[name]
            level = next(le for le in stage.levels if le.name == level_name)
            step = self._step(chain, name, level, narrow)
            if step is not None:
                self._do(canvas, stage, level, step)
        self.made[key] = canvas
        whole = [k for k in self.made if k[0] and not k[1]]
        if len(whole) > KEPT:  # a whole picture's layers are some 100 MB
            del self.made[whole[0]]
        return canvas

    def _do(self, canvas: Canvas, stage: Stage, level: Level, step: Step) -> None:
        began = time.perf_counter()
        prepared = self.shop.at(stage.name, level)
        need = step.need
        window = Window((canvas.view(stage.reads, need),), (self.facts,), step.out)
        start = time.perf_counter()
        made = stage.run(window, self.shop.scene, prepared, level, rng_for(self.shop.scene.seed, self.facts.index, stage.name))
        spent = time.perf_counter() - start
        if spent < AGAIN_S:  # the first run loads code and makes what is kept for this light
            start = time.perf_counter()
            stage.run(window, self.shop.scene, prepared, level, rng_for(self.shop.scene.seed, self.facts.index, stage.name))
            spent = min(time.perf_counter() - start, self.seconds.get((stage.name, level.name), spent))
        told = f"{stage.name}/{level.name}"
        self.shop.spent_s[told] = self.shop.spent_s.get(told, 0.0) + time.perf_counter() - began
        for layer, array in made.items():
            canvas.take(layer, array, need, step.out)
        whole = next(s for s in self.plan.steps if s.stage == stage.name)
        self.seconds[stage.name, level.name] = spent * max(whole.out.area / step.out.area, 1.0)

    def _step(self, chain: Chain, name: str, level: Level, narrow: bool) -> Step | None:
        """What the plan asks of the stage; with `narrow` only what the later stages need of it for the window."""
        planned = {s.stage: s for s in self.plan.steps}
        if name not in planned:
            return None
        stage, facts, scene = self.shop.stages[name], self.facts, self.shop.scene
        frame, out = scene.camera.rect, planned[name].out
        if narrow:
            want = self.window
            order = list(planned)
            for later in reversed(order[order.index(name) + 1 :]):
                s = self.shop.stages[later]
                reach = want.clip(planned[later].out)
                if not reach.empty:
                    need = s.needs(reach, facts, scene, s.levels[-1])
                    # who does not read the composited picture takes the real frame alone from far away
                    want = want.union(need if Layer.IMAGE in s.reads else need.clip(reach.pad(NEAR_PX)))
            out = out.clip(want)
        if out.empty:
            return None
        return Step(name, level.name, out, stage.needs(out, facts, scene, level).union(out).clip(frame), "", None)


def window_of(plan: FramePlan, facts: FrameFacts, frame: Rect, area_px: float) -> Rect:
    """At most `area_px` pixels of what the plan changes, around the middle of the object's box."""
    whole = plan.changed
    if whole.area <= area_px:
        return whole
    box = facts.model_box.clip(whole)
    if box.empty:
        box = whole
    share = np.sqrt(area_px / whole.area)
    width, height = max(round(whole.width * share), 16), max(round(whole.height * share), 16)
    cx, cy = (box.x0 + box.x1) // 2, (box.y0 + box.y1) // 2 + box.height // 8  # a little of the shadow rather than the top
    x0 = min(max(cx - width // 2, whole.x0), max(whole.x1 - width, whole.x0))
    y0 = min(max(cy - height // 2, whole.y0), max(whole.y1 - height, whole.y0))
    return Rect(x0, y0, x0 + width, y0 + height).clip(whole).clip(frame)


def chain_of(plan: FramePlan, levels: Mapping[str, str], without: Sequence[str] = ()) -> Chain:
    return tuple((s.stage, levels[s.stage]) for s in plan.steps if s.stage not in without)


def _srgb8(linear: np.ndarray) -> np.ndarray:
    return np.asarray(np.clip(np.rint(255 * SRGB.encode(np.clip(linear, 0, 1))), 0, 255), np.uint8)
