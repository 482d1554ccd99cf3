"""Run one frame's plan. Pixels depend on the arguments alone: any process may run any frame.

Each layer is kept with the rectangle that it was made for; a step sees what it reads over its own rectangle, filled
with the neutral value (nothing virtual, no shadow) where no stage has written.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import UNWRITTEN, Dimmed, Layer, Layers, Patch, Spans
from arfx.core.numerics import count_non_finite
from arfx.core.plan import FramePlan
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.sheet import Sheet
from arfx.core.stage import ReadyStage, Stage
from arfx.errors import RenderError
from arfx.media.frame import Frame


@dataclass
class Canvas:
    """The layers of one frame while its plan runs: name -> (rectangle, array).

    read : what stages saw that look at earlier frames: they see that again, not what came of it
    """

    plate: np.ndarray | Sheet
    rect: Rect
    stored: dict[Layer, tuple[Rect, Any]] = field(default_factory=dict)
    read: dict[str, Layers] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.stored = {Layer.PLATE: (self.rect, self.plate), Layer.IMAGE: (self.rect, self.plate)}

    def view(self, names: frozenset[Layer], rect: Rect) -> Layers:
        """Read-only layers over `rect`."""
        return Layers(rect, {name: self.stored.get(name, UNWRITTEN) for name in names})

    def put(self, name: Layer, rect: Rect, array: np.ndarray) -> None:
        """Write `array` over `rect`; what was there before stays outside it."""
        where, before = self.stored.get(name, (rect, array))
        if isinstance(before, Sheet) and where.contains(rect):
            self.stored[name] = (where, Sheet(where, before, (rect, array)))
        elif where != rect and not rect.contains(where):
            whole = where.union(rect)
            merged = self.view(frozenset({name}), whole)[name].copy()
            merged[rect.slices_in(whole)] = array
            self.stored[name] = (whole, merged)
        else:
            self.stored[name] = (rect, array)

    def take(self, name: Layer, made: np.ndarray | Patch | Dimmed, need: Rect, out: Rect) -> tuple[Rect, np.ndarray]:
        """Write what a stage that saw `need` made, over `out`. Returns the pixels of it that are not neutral by definition.

        Of what is `Dimmed` nothing is written, as nobody reads it.
        """
        if isinstance(made, Dimmed):
            return made.part.rect, made.part.array
        patch = made if isinstance(made, Patch) else Patch(need, made)
        where = patch.rect.clip(out)
        pixels = patch.array[where.slices_in(patch.rect)]
        if where == out or name not in self.stored:
            self.put(name, where, pixels)
        else:  # neutral there now, whatever it was before
            self.put(name, out, Patch(where, pixels).over(name, out))
        return where, pixels


@dataclass(frozen=True, eq=False)
class FrameResult:
    """rect : pixels of the picture that are new;  made : those, or what of the rectangle can differ from what was there
    dimmed : less light on the plate elsewhere, None = nothing;  seconds : by stage
    """

    rect: Rect
    made: Patch
    dimmed: Dimmed | None
    seconds: dict[str, float]
    canvas: Canvas

    @property
    def image(self) -> np.ndarray:
        """(h, w, 3) linear over `rect`."""
        return self.made.array[self.rect.slices_in(self.made.rect)]

    def onto(self, frame: Frame, changed: Rect) -> Frame:
        """The frame with what is new inside `changed` written into its planes."""
        out, made, plate = frame, self.made, self.canvas.view(frozenset({Layer.PLATE}), self.rect)
        if self.dimmed is not None and not (where := self.dimmed.rect.clip(changed)).empty:
            d = self.dimmed
            out = out.dimmed(where, d.left[where.slices_in(d.rect)], d.opacity, d.bias, self.rect.clip(where))
        if self.rect.empty:
            return out
        if isinstance(made, Spans) and frame.row_by_row:
            plate = self.canvas.view(frozenset({Layer.PLATE}), made.rect)
            return out.edited(made.rect, plate.within(Layer.PLATE, made.parts()), made.made, made.columns, out is not frame)
        return out.edited(self.rect, plate[Layer.PLATE], self.image, in_place=out is not frame)


class Plate(Sheet):
    """A rectangle of a frame in linear light, converted where it is asked for. seconds : spent on that"""

    def __init__(self, rect: Rect, read: Callable[[Rect], np.ndarray]) -> None:
        super().__init__(rect, read)
        self.seconds = 0.0

    def _read(self, part: Rect) -> np.ndarray:
        start = time.perf_counter()
        pixels = super()._read(part)
        self.seconds += time.perf_counter() - start
        return pixels


def made_ready(plan: FramePlan, stages: Mapping[str, Stage], scene: Scene) -> dict[str, ReadyStage]:
    """What `run_frame` needs to run a plan, prepared for it alone."""
    return {s.stage: ReadyStage.of(stages[s.stage], scene, s.level) for s in plan.steps}


def run_frame(
    plate: np.ndarray | Plate,
    facts: FrameFacts,
    plan: FramePlan,
    ready: Mapping[str, ReadyStage],
    past: Sequence[tuple[Canvas, FrameFacts]] | None = None,
    real_depth_m: np.ndarray | None = None,
) -> FrameResult:
    """Run a plan that has steps.

    plate : (h, w, 3) float32 linear light over plan.rect; with a `Plate` the last stage may leave IMAGE as `Dimmed`
    ready : the stages of the plan, at its levels
    past : canvases of the frames before, oldest first, as many as the longest history asks for; None = no stage looks back
    real_depth_m : (h, w) float32 over plan.rect, what stages read as REAL_DEPTH; None = not measured

    Raises RenderError naming stage, frame and pixel if a stage makes a value that is not finite.
    """
    canvas = Canvas(plate, plan.rect)
    if real_depth_m is not None:
        canvas.put(Layer.REAL_DEPTH, plan.rect, real_depth_m)
    seconds: dict[str, float] = {}
    dimmed: Dimmed | None = None
    spans: Spans | None = None
    painted = EMPTY  # where IMAGE was written before them
    may_dim = isinstance(plate, Plate) and past is None

    def spent() -> float:
        """Seconds so far without those of converting the plate, which are no stage's."""
        return time.perf_counter() - (plate.seconds if isinstance(plate, Plate) else 0.0)

    for step in plan.steps:
        at = ready[step.stage]
        stage, start = at.stage, spent()
        seen = canvas.view(stage.reads, step.need)
        earlier = past[-stage.history :] if stage.history and past else ()
        before = tuple(at.view(c.read.get(stage.name) or c.view(stage.reads, step.need), f) for c, f in earlier)
        if stage.history:
            canvas.read[stage.name] = seen
        view = at.view(seen, facts, step.out, before, may_dim and step is plan.steps[-1])
        for name, array in stage.run(view, at.prepared).items():
            dimmed = array if isinstance(array, Dimmed) else dimmed
            if isinstance(array, Spans) and view.last and array.rect.contains(plan.changed):
                spans = array.only(step.out)
                _require_finite_spans(spans, name, stage.name, facts.index)
                continue
            where, pixels = canvas.take(name, array, step.need, step.out)
            painted = painted.union(where) if name is Layer.IMAGE else painted
            if name is not Layer.DEPTH:  # infinite where nothing is
                _require_finite(pixels, name, stage.name, facts.index, where)
        seconds[stage.name] = seconds.get(stage.name, 0.0) + spent() - start
    if spans is not None:
        return FrameResult(plan.changed, spans.holding(painted.clip(plan.changed)), None, seconds, canvas)
    if dimmed is None:
        rect = plan.changed
        image = canvas.view(frozenset({Layer.IMAGE}), rect)[Layer.IMAGE]
    else:
        rect = plan.changed.clip(dimmed.part.rect)
        image = dimmed.part.array[rect.slices_in(dimmed.part.rect)]
    return FrameResult(rect, Patch(rect, image), dimmed, seconds, canvas)


def _require_finite(array: np.ndarray, layer: Layer, stage: str, index: int, rect: Rect) -> None:
    if array.dtype.kind != "f":
        return
    if array.strides[-1] == 0:  # one value for all channels
        array = array[..., 0]
    if array.dtype == np.float32 and array.flags.c_contiguous and _finite(array.reshape(-1).view(np.int32)):
        return
    bad = count_non_finite(array)
    if bad:
        wrong = ~np.isfinite(array.reshape(*array.shape[:2], -1)).all(-1)
        y, x = np.argwhere(wrong)[0]
        raise RenderError(
            f"stage {stage!r} made {bad} pixels of layer {layer} that are not finite numbers, "
            f"frame {index}, first at x {x + rect.x0}, y {y + rect.y0}",
            "please report this with the job folder; --set or another level may avoid it",
        )


def _require_finite_spans(spans: Spans, name: Layer, stage: str, index: int) -> None:
    bits = spans.made.reshape(len(spans.made), -1).view(np.int32)
    if not _finite_within(bits, spans.columns):
        _require_finite(spans.array, name, stage, index, spans.rect)


@numba.njit(cache=True, nogil=True)
def _finite_within(bits: np.ndarray, columns: np.ndarray) -> bool:  # pragma: no cover - compiled
    """As `_finite`, of rows (h, 3 w), columns (h, 2) of pixels."""
    found = True
    for y in range(bits.shape[0]):
        found &= _finite(bits[y, 3 * columns[y, 0] : 3 * columns[y, 1]])
    return found


@numba.njit(cache=True, nogil=True)
def _finite(bits: np.ndarray) -> bool:  # pragma: no cover - compiled
    """Whether all float32 with these bits are finite: none has all bits of its exponent set. One pass at memory speed."""
    highest = np.int32(0)
    for k in range(bits.shape[0]):
        highest = max(highest, bits[k] & np.int32(0x7F800000))
    return bool(highest < np.int32(0x7F800000))
