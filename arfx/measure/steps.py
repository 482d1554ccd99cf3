"""One frame rendered again and again with other levels, in a window; what steps have in common is rendered once.

A reference costs minutes over a whole picture, so all is rendered in a window only: what a stage computes on a crop is what it
computes on the whole (tests/contract, the ROI law). What it costs is measured elsewhere (tradeoff_time.py).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from arfx.core.colour import Transfer
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage
from arfx.measure.tradeoff_time import Times, areas_of
from arfx.run.frame import Canvas

NEAR_PX = 16
KEPT = 40
SRGB = Transfer("srgb")
Chain = tuple[tuple[str, str], ...]  # (stage, level) in running order; a stage left out is absent


@dataclass
class Shop:
    """What is prepared once for all frames. stages : by name, under the formula of the job or another one"""

    scene: Scene
    stages: Mapping[str, Stage]
    ready: dict[tuple[str, str], ReadyStage] = field(default_factory=dict)
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)
    spent_s: dict[str, float] = field(default_factory=dict)  # by "stage/level": what the pictures took, processor time

    def at(self, stage: str, level: str) -> ReadyStage:
        key = (stage, level)
        if key not in self.ready:
            start = time.process_time()
            self.ready[key] = ReadyStage.of(self.stages[stage], self.scene, level)
            self.prepare_s[key] = time.process_time() - start
        return self.ready[key]


@dataclass
class FrameBench:
    """A frame and all that was rendered of it.

    plate : (h, w, 3) linear, whole frame;  plan : at the job's own levels;  window : what is rendered
    slow : (stage, level) whose pictures are dear, and kept;  real_depth_m : (h, w) whole frame, None = not measured
    """

    facts: FrameFacts
    plate: np.ndarray
    plan: FramePlan
    window: Rect
    shop: Shop
    slow: frozenset[tuple[str, str]]
    real_depth_m: np.ndarray | None = None
    made: dict[Chain, Canvas] = field(default_factory=dict)
    shown: dict[Chain, np.ndarray] = field(default_factory=dict)

    def under(self, shop: Shop) -> FrameBench:
        """The same frame with other stages."""
        return FrameBench(self.facts, self.plate, self.plan, self.window, shop, self.slow, self.real_depth_m)

    def canvas(self) -> Canvas:
        """The frame as it was, before any step."""
        canvas = Canvas(self.plate, self.shop.scene.camera.rect)
        if self.real_depth_m is not None:
            canvas.put(Layer.REAL_DEPTH, self.real_depth_m, canvas.rect, canvas.rect)
        return canvas

    def image(self, chain: Chain) -> np.ndarray:
        """(h, w, 3) uint8 sRGB of the window after these steps."""
        if chain not in self.shown:
            canvas = self._run(chain)
            self.shown[chain] = _srgb8(canvas.view(frozenset({Layer.IMAGE}), self.window)[Layer.IMAGE])
        return self.shown[chain]

    def original(self) -> np.ndarray:
        """The same of the frame as it was."""
        return _srgb8(self.plate[self.window.slices])

    def coverage(self, chain: Chain) -> np.ndarray:
        """(h, w) of the window."""
        return np.asarray(self._run(chain).view(frozenset({Layer.COVERAGE}), self.window)[Layer.COVERAGE])

    def predicted_s(self, chains: Iterable[Chain], times: Times) -> float:
        """What the slow steps of these chains' pictures will take."""
        steps = {chain[: k + 1] for chain in chains for k, at in enumerate(chain) if at in self.slow}
        total = 0.0
        for chain in steps:
            step = self._step(chain)
            if step is not None and chain[-1] in times.tiles:
                total += times.tiles[chain[-1]].over(areas_of(step.out, self.facts.model_box)).seconds
        return total

    def _run(self, chain: Chain) -> Canvas:
        """The steps before the last are looked up, or made and kept."""
        if chain in self.made:
            self.made[chain] = self.made.pop(chain)  # used last
            return self.made[chain]
        if not chain:
            canvas = self.canvas()
        else:
            before = self._run(chain[:-1])
            canvas = Canvas(before.plate, before.rect)
            canvas.stored = dict(before.stored)
            step = self._step(chain)
            if step is not None:
                self._do(canvas, step)
        self.made[chain] = canvas
        cheap = [c for c in self.made if not self.slow.intersection(c)]
        if len(cheap) > KEPT:
            del self.made[cheap[0]]
        return canvas

    def _do(self, canvas: Canvas, step: Step) -> None:
        began = time.process_time()
        at = self.shop.at(step.stage, step.level)
        for layer, array in at.run(canvas.view(at.stage.reads, step.need), self.facts, step.out).items():
            canvas.put(layer, array, step.need, step.out)
        told = f"{step.stage}/{step.level}"
        self.shop.spent_s[told] = self.shop.spent_s.get(told, 0.0) + time.process_time() - began

    def _step(self, chain: Chain) -> Step | None:
        """Of what the plan asks of the chain's last stage, that which the later stages need for the window."""
        name, level = chain[-1]
        planned = {s.stage: s for s in self.plan.steps}
        if name not in planned:
            return None
        stage, facts, scene = self.shop.stages[name], self.facts, self.shop.scene
        want, order = self.window, list(planned)
        for later in reversed(order[order.index(name) + 1 :]):
            s = self.shop.stages[later]
            reach = want.clip(planned[later].out)
            if not reach.empty:
                need = s.needs(reach, facts, scene, s.levels[-1])
                # who does not read the composited picture takes the real frame alone from far away
                want = want.union(need if Layer.IMAGE in s.reads else need.clip(reach.pad(NEAR_PX)))
        out = planned[name].out.clip(want)
        if out.empty:
            return None
        return Step(name, level, out, stage.needs(out, facts, scene, level).union(out).clip(scene.camera.rect), "", None)


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
