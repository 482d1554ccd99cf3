"""Run one frame's plan. Pixels depend on the arguments alone: any process may run any frame.

A step sees what it reads over its own rectangle: where no stage has written, the neutral
value (nothing virtual, no shadow), and of IMAGE what was there before."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.pixels import Pixels, Plate
from arfx.core.plan import FramePlan
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage, blamed
from arfx.errors import InputError, RenderError
from arfx.media.depth_maps import DepthMaps, fill_holes
from arfx.media.frame import Frame

# What the renderer takes from the model's files, whose colours are those of BT.709
MODEL_COLOURS = (Layer.ALBEDO, Layer.EMISSIVE)


@dataclass
class FrameLayers:
    """The layers of one frame while its plan runs."""

    plate: Plate
    stored: dict[Layer, Pixels | Plate] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.stored = {Layer.PLATE: self.plate}

    @property
    def rect(self) -> Rect:
        return self.plate.rect

    def view(self, rect: Rect) -> Layers:
        """Read-only layers over `rect`."""
        return Layers(rect, dict(self.stored))

    def put(
        self, name: Layer, output: ndarray | Pixels, need: Rect, out: Rect
    ) -> Pixels:
        """Write what a stage returned that saw `need`, over `out`; the rest stays. Returns
        what is new.
        """
        new = (output if isinstance(output, Pixels) else Pixels(need, output)).clip(
            out
        )
        before = self.stored.get(name)
        kept = new.rect if name is Layer.IMAGE else out
        if before is None or kept.contains(before.rect):
            self.stored[name] = new
        elif not kept.empty:
            whole = before.rect.union(kept)
            merged = self.view(whole)[name].copy()
            merged[kept.slices_in(whole)] = Layers(kept, {name: new})[name]
            self.stored[name] = Pixels(whole, merged)
        return new


@dataclass(frozen=True, eq=False)
class FrameResult:
    """rect : pixels of the picture that may be new;  seconds : by stage"""

    rect: Rect
    seconds: dict[str, float]
    layers: FrameLayers

    @property
    def image(self) -> ndarray:
        """(h, w, 3) linear over `rect`."""
        return self.layers.view(self.rect)[Layer.IMAGE]

    def onto(self, frame: Frame) -> Frame:
        """The frame with what is new written into its planes."""
        image = self.layers.stored.get(Layer.IMAGE)
        if image is None or (rect := image.rect.clip(self.rect)).empty:
            return frame
        return frame.edited(rect, self.layers.plate.part(rect), image.part(rect))


def ready_stages(
    plan: FramePlan, stages: Mapping[str, Stage], scene: Scene
) -> dict[str, ReadyStage]:
    """The stages of a plan, prepared at its levels."""
    return {
        s.stage: ReadyStage.of(stages[s.stage], scene, s.level) for s in plan.steps
    }


def run_frame(
    plate: Plate | ndarray,
    facts: FrameFacts,
    plan: FramePlan,
    ready: Mapping[str, ReadyStage],
    real_depth_m: ndarray | None = None,
    colours: ndarray | None = None,
) -> FrameResult:
    """Run a plan that has steps.

    plate : over plan.rect; an array (h, w, 3) is linear light already;  ready : the stages
    of the plan, at its levels
    real_depth_m : (h, w) float32 over plan.rect, what stages read as REAL_DEPTH; None = not
    measured
    colours : (3, 3) from the models' colours to the clip's, as of `core.colour.from_bt709`;
    None = they are the same

    Raises RenderError naming stage, frame and pixel if a stage makes a value that is not
    finite; with the distribution, what a plug-in raises, and a layer beside IMAGE."""
    if isinstance(plate, ndarray):
        plate = Plate.of(plate, plan.rect)
    layers = FrameLayers(plate)
    if real_depth_m is not None:
        layers.put(Layer.REAL_DEPTH, real_depth_m, plan.rect, plan.rect)
    seconds: dict[str, float] = {}

    def own_time() -> float:
        """Seconds so far without those of converting the plate, which are no stage's."""
        return time.perf_counter() - plate.seconds

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
                if colours is not None and layer in MODEL_COLOURS:
                    output = _converted(output, colours)
                new = layers.put(layer, output, step.need, step.out)
                if layer is not Layer.DEPTH:  # infinite where nothing is
                    _require_finite(new, layer, stage.name, facts.index)
        seconds[stage.name] = seconds.get(stage.name, 0.0) + own_time() - start
    return FrameResult(plan.changed, seconds, layers)


def real_depth_layer(
    maps: DepthMaps, facts: FrameFacts, frame: Frame, camera: Camera, rect: Rect
) -> ndarray | None:
    """REAL_DEPTH over `rect`: metres, > 0 everywhere, holes filled along the picture's
    edges; None where there is none.

    The whole map is filled whatever the rectangle, so that a pixel gets the same from any.
    Raises InputError where the map is not the one that was analysed."""
    real = facts.real_depth
    if real is None:
        return None
    depth = maps.load(real.map, camera.width, camera.height)
    if not depth.any():
        raise InputError(
            f"depth map {maps.name(real.map)} has changed since the analysis",
            "start the job again",
        )
    whole = fill_holes(depth, np.ascontiguousarray(frame.luma()))
    return np.ascontiguousarray(whole[rect.slices]) * np.float32(real.scale)


def _converted(output: ndarray | Pixels, colours: ndarray) -> ndarray | Pixels:
    """Linear colours (h, w, 3) in other primaries."""
    array = output.array if isinstance(output, Pixels) else output
    if not array.size:
        return output
    array = cv2.transform(np.ascontiguousarray(array), colours.astype(np.float32))
    return Pixels(output.rect, array) if isinstance(output, Pixels) else array


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
    array = pixels.array
    if array.dtype.kind != "f" or not array.size:
        return
    if array.flags.c_contiguous:
        flat = array.ravel()
        with np.errstate(all="ignore"):
            if np.isfinite(np.vdot(flat, flat)):  # a quick proof
                return
    if np.isfinite(array).all():
        return
    bad = ~np.isfinite(array.reshape(*array.shape[:2], -1)).all(-1)
    y, x = np.argwhere(bad)[0]
    raise RenderError(
        f"stage {stage!r} made {bad.sum()} pixels of layer {layer} that are not finite"
        f" numbers, frame {index}, first at x {x + pixels.rect.x0}, y {y + pixels.rect.y0}",
        "please report this with the job folder; --set or another level may avoid it",
    )
