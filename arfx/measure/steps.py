"""One frame on which any level of any stage is run by itself, upon what the steps before it
make; those are made once.

A reference costs minutes over a whole picture, so that pictures are rendered in a window
only: what a stage computes on a crop is what it computes on the whole (tests/contract, the
ROI law)."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.pixels import Plate
from arfx.core.plan import FramePlan
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage
from arfx.measure.timing import PROCESSOR
from arfx.media.frames import ClipReader
from arfx.run.frame import FrameLayers, real_depth_layer
from arfx.run.planned import Job
from arfx.stages import RENDERER

NEAR_PX = 16
MOST_KEPT = 40
Chain = tuple[
    tuple[Stage, str], ...
]  # levels in running order; a stage left out is absent


@dataclass
class PreparedStages:
    """Stages of a scene at their levels, each prepared once for all frames.

    prepare_s : processor time of that, by name and level
    """

    scene: Scene
    ready: dict[tuple[Stage, str], ReadyStage] = field(default_factory=dict)
    prepare_s: dict[tuple[str, str], float] = field(default_factory=dict)

    def at(self, stage: Stage, level: str) -> ReadyStage:
        def prepare() -> None:
            self.ready[stage, level] = ReadyStage.of(stage, self.scene, level)

        if (stage, level) not in self.ready:
            self.prepare_s[stage.name, level] = PROCESSOR.of(prepare)
        return self.ready[stage, level]


@dataclass(frozen=True)
class StageRun:
    """One level of one stage on a frame. layers : what it reads from"""

    at: ReadyStage
    facts: FrameFacts
    layers: FrameLayers

    def need(self, out: Rect) -> Rect:
        scene = self.at.scene
        read = self.at.stage.needs(out, self.facts, scene, self.at.level)
        return read.union(out).clip(scene.camera.rect)

    def __call__(
        self, out: Rect, facts: FrameFacts | None = None
    ) -> Mapping[Layer, Any]:
        """What it makes of `out`. facts : others than the frame's"""
        return self.at.run(self.layers.view(self.need(out)), facts or self.facts, out)

    def rerun(self, out: Rect, facts: FrameFacts | None = None) -> None:
        """For timing: forgets first what an earlier run kept for this frame."""
        self.at.memo.of_frame.clear()
        self(out, facts)


@dataclass
class FrameRenderer:
    """A frame and all that was rendered of it.

    plate : (h, w, 3) linear, whole frame;  plan : of the job;  stages : of the plan, by name
    window : what is rendered;  real_depth_m : (h, w) whole frame, None = not measured
    """

    facts: FrameFacts
    plate: ndarray
    plan: FramePlan
    stages: Mapping[str, Stage]
    window: Rect
    prepared: PreparedStages
    real_depth_m: ndarray | None = None
    rendered: dict[Chain, FrameLayers] = field(default_factory=dict, init=False)
    images: dict[Chain, ndarray] = field(default_factory=dict, init=False)

    def chain(
        self, levels: Mapping[str, str], stages: Mapping[str, Stage] | None = None
    ) -> Chain:
        """levels : by stage; one that has none is left out;  stages : None = the plan's"""
        stages = stages or self.stages
        names = [s.stage for s in self.plan.steps if s.stage in levels]
        return tuple((stages[name], levels[name]) for name in names)

    def run(self, chain: Chain) -> StageRun:
        """Its last step, upon those before it."""
        return StageRun(
            self.prepared.at(*chain[-1]), self.facts, self.after(chain[:-1])
        )

    def image(self, chain: Chain) -> ndarray:
        """(h, w, 3) uint8 sRGB of the window after these steps."""
        if chain not in self.images:
            layers = self.after(chain)
            self.images[chain] = _srgb8(layers.view(self.window)[Layer.IMAGE])
        return self.images[chain]

    def original(self) -> ndarray:
        """The same of the frame as it was."""
        return _srgb8(self.plate[self.window.slices])

    def layer(self, chain: Chain, name: Layer) -> ndarray:
        """(h, w, …) of the window after these steps."""
        return np.asarray(self.after(chain).view(self.window)[name])

    def after(self, chain: Chain) -> FrameLayers:
        """The frame after these steps; those before the last are looked up, or made and kept."""
        layers = self.rendered.pop(chain, None) or self._rendered(chain)
        self.rendered[chain] = layers  # used last
        if len(self.rendered) > MOST_KEPT:
            del self.rendered[next(iter(self.rendered))]
        return layers

    def _rendered(self, chain: Chain) -> FrameLayers:
        layers = FrameLayers(Plate.of(self.plate, self.prepared.scene.camera.rect))
        if chain:
            layers.stored = dict(self.after(chain[:-1]).stored)
            run, out = self.run(chain), self.out(chain)
            for layer, array in ({} if out.empty else run(out)).items():
                layers.put(layer, array, run.need(out), out)
        elif self.real_depth_m is not None:
            layers.put(Layer.REAL_DEPTH, self.real_depth_m, layers.rect, layers.rect)
        return layers

    def out(self, chain: Chain) -> Rect:
        """Of what the plan asks of the chain's last stage, that which the later stages need
        for the window.
        """
        name, want = chain[-1][0].name, self.window
        planned = {s.stage: s.out for s in self.plan.steps}
        order = list(planned)
        for later in reversed(order[order.index(name) + 1 :]):
            stage = self.stages[later]
            part = want.clip(planned[later])
            if not part.empty:
                need = stage.needs(
                    part, self.facts, self.prepared.scene, stage.levels[-1]
                )
                # the renderer takes the real frame alone from far away
                near = need.clip(part.pad(NEAR_PX)) if later in RENDERER else need
                want = want.union(near)
        return planned[name].clip(want)


def open_frames(job: Job, wanted: Collection[int]) -> dict[int, FrameRenderer]:
    """These frames of a job, whole, by number."""
    camera, maps, out = job.inputs.camera, job.inputs.depth, {}
    prepared = PreparedStages(job.scene)
    plans = {p.index: p for p in job.plan.frames}
    facts = {f.index: f for f in job.facts}
    pts = {job.analysed.pts[i]: i for i in wanted}
    with ClipReader(job.inputs.info, careful=job.analysed.careful) as reader:
        for frame in reader.frames(min(pts), max(pts)):
            if frame.pts not in pts:
                continue
            i = pts[frame.pts]
            depth = (
                None
                if maps is None
                else real_depth_layer(maps, facts[i], frame, camera, camera.rect)
            )
            plate = frame.linear(camera.rect)
            out[i] = FrameRenderer(
                facts[i], plate, plans[i], job.stages, camera.rect, prepared, depth
            )
    return out


def window_of(
    plan: FramePlan, facts: FrameFacts, frame: Rect, area_px: float
) -> Rect:
    """At most `area_px` pixels of what the plan changes, around the middle of the object's box."""
    whole = plan.changed
    if whole.area <= area_px:
        return whole
    clipped = facts.model_box.clip(whole)
    box = whole if clipped.empty else clipped
    scale = np.sqrt(area_px / whole.area)
    width, height = (max(round(s * scale), 16) for s in (whole.width, whole.height))
    # a little of the shadow rather than the top
    cx, cy = (box.x0 + box.x1) // 2, (box.y0 + box.y1) // 2 + box.height // 8
    x0 = max(min(cx - width // 2, whole.x1 - width), whole.x0)
    y0 = max(min(cy - height // 2, whole.y1 - height), whole.y0)
    return Rect(x0, y0, x0 + width, y0 + height).clip(whole).clip(frame)


def _srgb8(linear: ndarray) -> ndarray:
    return np.rint(255 * SRGB.encode(np.clip(linear, 0, 1))).astype(np.uint8)
