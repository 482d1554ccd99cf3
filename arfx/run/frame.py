"""Run one frame's plan. Pixels depend on the arguments alone: any process may run any frame.

A step sees what it reads over its own rectangle: where no stage has written, the neutral
value (nothing virtual, no shadow), and of IMAGE what was there before."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.pixels import Attenuated, Pixels, Region
from arfx.core.plan import FramePlan
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage, blamed
from arfx.errors import RenderError
from arfx.media.frame import Frame


@dataclass
class FrameLayers:
    """The layers of one frame while its plan runs."""

    plate: np.ndarray | Pixels
    rect: Rect
    stored: dict[Layer, Pixels] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = self.plate
        plate = (
            given
            if isinstance(given, Pixels)
            else Pixels(self.rect, rest=lambda part: given[part.slices_in(self.rect)])
        )
        self.plate, self.stored = plate, {Layer.PLATE: plate, Layer.IMAGE: plate}

    def view(self, rect: Rect) -> Layers:
        """Read-only layers over `rect`."""
        return Layers(rect, dict(self.stored))

    def put(
        self, name: Layer, output: np.ndarray | Pixels, need: Rect, out: Rect
    ) -> Pixels:
        """Write what a stage returned that saw `need`, over `out`; the rest stays. Returns
        what is new.
        """
        new = (output if isinstance(output, Pixels) else Pixels(need, output)).clip(out)
        before = self.stored.get(name)
        if name is Layer.IMAGE:
            assert before is not None
            rest = new.rest or before
            if (rest.plate if isinstance(rest, Attenuated) else rest) is not before:
                new, rest = Pixels(out, new(out)), before
            self.stored[name] = Pixels(
                before.rect, new.array, rest, new.part, new.written.rects
            )
        elif before is None or out.contains(before.part):
            self.stored[name] = new
        else:
            whole = before.part.union(out)
            merged = self.view(whole)[name].copy()
            merged[out.slices_in(whole)] = Layers(out, {name: new})[name]
            self.stored[name] = Pixels(whole, merged)
        return new


@dataclass(frozen=True, eq=False)
class FrameResult:
    """rect : pixels of the picture that may be new;  seconds : by stage"""

    rect: Rect
    seconds: dict[str, float]
    layers: FrameLayers

    @property
    def image(self) -> np.ndarray:
        """(h, w, 3) linear over `rect`."""
        return self.layers.view(self.rect)[Layer.IMAGE]

    def onto(self, frame: Frame) -> Frame:
        """The frame with what is new written into its planes.

        A shadow that no stage read is applied to the stored samples.
        """
        out, plate, image = (
            frame,
            self.layers.stored[Layer.PLATE],
            self.layers.stored[Layer.IMAGE],
        )
        region, light = image.written.clip(self.rect), image.rest
        if isinstance(light, Attenuated):
            if not (where := light.rect.clip(self.rect)).empty:
                transmittance, hole = (
                    light.transmittance[where.slices_in(light.rect)],
                    region.bounds.clip(where),
                )
                out = frame.dimmed(
                    where, transmittance, float(light.opacity), light.bias, hole
                )
        elif frame.row_by_row:
            region.grow(image.painted.clip(self.rect))
        else:
            region = Region([self.rect])
        if not region.rects:
            return out
        rect = (
            region.bounds
            if region.bounds == region.rects[0]
            else image.part.union(region.bounds)
        )
        columns = region.columns(rect) if frame.row_by_row else None
        before, after = plate.over(rect, region.rects), image.over(rect, region.rects)
        return out.edited(rect, before, after, columns, out is not frame)


def ready_stages(
    plan: FramePlan, stages: Mapping[str, Stage], scene: Scene
) -> dict[str, ReadyStage]:
    """The stages of a plan, prepared at its levels."""
    return {s.stage: ReadyStage.of(stages[s.stage], scene, s.level) for s in plan.steps}


def run_frame(
    plate: np.ndarray | Pixels,
    facts: FrameFacts,
    plan: FramePlan,
    ready: Mapping[str, ReadyStage],
    real_depth_m: np.ndarray | None = None,
) -> FrameResult:
    """Run a plan that has steps.

    plate : (h, w, 3) float32 linear light over plan.rect;  ready : the stages of the plan,
    at its levels
    real_depth_m : (h, w) float32 over plan.rect, what stages read as REAL_DEPTH; None = not
    measured

    Raises RenderError naming stage, frame and pixel if a stage makes a value that is not
    finite; with the distribution, what a plug-in raises, and a layer beside IMAGE."""
    layers = FrameLayers(plate, plan.rect)
    if real_depth_m is not None:
        layers.put(Layer.REAL_DEPTH, real_depth_m, plan.rect, plan.rect)
    seconds: dict[str, float] = {}
    source = layers.stored[Layer.PLATE]

    def own_time() -> float:
        """Seconds so far without those of converting the plate, which are no stage's."""
        return time.perf_counter() - source.seconds

    for step in plan.steps:
        at = ready[step.stage]
        stage, start = at.stage, own_time()
        seen = layers.view(step.need)
        with blamed(stage, f"in frame {facts.index}"):
            made = stage.run(at.view(seen, facts, step.out), at.prepared)
            if stage.distribution:
                _require_picture(made, step.need)
            for name, output in made.items():
                layer = Layer(name)
                new = layers.put(layer, output, step.need, step.out)
                if layer is not Layer.DEPTH:  # infinite where nothing is
                    _require_finite(new, layer, stage.name, facts.index)
        seconds[stage.name] = seconds.get(stage.name, 0.0) + own_time() - start
    return FrameResult(plan.changed, seconds, layers)


def _require_picture(made: object, seen: Rect) -> None:
    """Raises for what a plug-in returns beside IMAGE over the rectangle that it saw."""
    if not isinstance(made, Mapping):
        raise TypeError(
            f"it returns {type(made).__name__}; it must return {{Layer.IMAGE: array}}"
        )
    for name, output in made.items():
        if name != Layer.IMAGE:
            raise ValueError(f"it returns a layer {name!r}; it writes image")
        right = (seen.height, seen.width, 3)
        if not isinstance(output, Pixels) and np.shape(output) != right:
            raise ValueError(
                f"it returns an image of shape {np.shape(output)}; it must be {right}"
            )


def _require_finite(pixels: Pixels, layer: Layer, stage: str, index: int) -> None:
    rects, array = pixels.written.rects, pixels.array
    if array.dtype.kind != "f" or not rects:
        return
    flat = array.ravel()
    with np.errstate(all="ignore"):
        # a sum of squares is a quick proof; beside the written pixels anything may lie
        if np.isfinite(np.vdot(flat, flat)) or all(
            np.isfinite(array[r.slices_in(pixels.part)]).all() for r in rects
        ):
            return
    bad = np.zeros(array.shape[:2], bool)
    for r in rects:
        at = r.slices_in(pixels.part)
        bad[at] = ~np.isfinite(array[at].reshape(*bad[at].shape, -1)).all(-1)
    y, x = np.argwhere(bad)[0]
    raise RenderError(
        f"stage {stage!r} made {bad.sum()} pixels of layer {layer} that are not finite"
        f" numbers, frame {index}, first at x {x + pixels.part.x0}, y {y + pixels.part.y0}",
        "please report this with the job folder; --set or another level may avoid it",
    )
