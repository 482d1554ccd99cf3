"""Dof: the blur of a stated thin lens on real and virtual pixels alike, in linear light.

Every pixel's light is spread over its blur circle (disc or n-blade), energy kept, at a resolution
that fits the circle's size; the real scene and the virtual object are two layers, so that a
blurred silhouette lets through what is behind it. Where the circle stays below 1 px nothing
changes, bit for bit. While the object fades in or out the lens opens with it.
Levels: draft and standard differ in how finely radii are told apart, and in the cells on which
light is spread (`LEVELS`). reference is the integral over the lens.
Cost: O(blurred pixels), nearly independent of the radius. Leaves out: what real things hide behind
their edges, that a blurred object lets through light of one side of the lens only, what is blurred
before the object and reaches over it, lens aberrations, vignetting, motion.
Source: docs/methods/dof.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Check, Demand, JobView, Stage, View
from arfx.stages.dof import demand as called
from arfx.stages.dof.blur import LEVELS, blurred
from arfx.stages.dof.layers import layers_of_light
from arfx.stages.dof.optics import CircleOfConfusion, circle_of_confusion, unknown_lens
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real, direction_grid, real_scene


class Dof(Stage):
    name = "dof"
    facts = frozenset({"pose", "depth"})
    levels: ClassVar[tuple[str, ...]] = ("draft", "standard", "reference")
    Params = DofParams

    def __init__(self, params: DofParams | None = None) -> None:
        super().__init__(params)
        if self.params.lens == "footage":
            self.facts = self.facts | {"lens"}

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        if unknown := unknown_lens(self.params, facts):
            return Demand(EMPTY, unknown)
        coc, real = self._frame(facts, scene)
        seen = real if self.params.scope == "all" else None
        return called.demand(facts, frame, coc, seen, direction_grid(scene.camera))

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        if facts.camera_from_world is None or unknown_lens(self.params, facts):
            return out
        coc, real = self._frame(facts, scene)
        grid, frame = direction_grid(scene.camera), scene.camera.rect
        seen = real if self.params.scope == "all" else None
        return called.needs(out, facts, coc, seen, grid, frame)

    def health(self, job: JobView) -> Iterator[Check]:
        """The lens of the blur: given, or measured from the footage's edges."""
        name = "lens of the blur"
        if self.params.lens != "footage":
            yield Check(name, "given", "given or measured", True, "")
            return
        fits = [f.lens for f in job.facts if f.lens is not None]
        known = [f for f in fits if f.known]
        reason = fits[0].reason if fits else "not measured"
        yield Check(
            name,
            "measured" if known else "refused",
            "measured",
            bool(known),
            f"object stays sharp: {reason}",
        )
        if known:
            fraction = max(
                float(divide(f.px_per_dioptre_ci95, f.px_per_dioptre)) for f in known
            )
            yield Check(
                f"{name}, half width of its interval",
                fraction,
                0.5,
                fraction <= 0.5,
                "blur is a rough guess",
            )

    def prepare(self, scene: Scene, level: str) -> Any:
        if level == "reference":
            from arfx.stages.dof.lens_rays import RayScene

            return RayScene.of(scene)
        return direction_grid(scene.camera)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray | Pixels]:
        now, facts, scene = view.layers, view.facts, view.scene
        if not facts.present or unknown_lens(self.params, facts):
            return {Layer.IMAGE: now[Layer.IMAGE].copy()}
        coc, real = self._frame(facts, scene)
        if view.level == "reference":
            from arfx.stages.dof import reference

            return {
                Layer.IMAGE: reference.render(
                    now, facts, scene, real, coc, self.params, prepared
                )
            }
        layers = layers_of_light(now, facts, real, prepared, coc, self.params)
        image = blurred(now[Layer.IMAGE], layers, view.out, LEVELS[view.level], self.params)
        rows = Rect(now.rect.x0, view.out.y0, now.rect.x1, view.out.y1)
        below = now.written[Layer.IMAGE]
        return {Layer.IMAGE: Pixels(now.rect, image, below, rows, [view.out])}

    def _frame(self, facts: FrameFacts, scene: Scene) -> tuple[CircleOfConfusion, Real]:
        """The lens, and where the real scene stands."""
        coc, measured = circle_of_confusion(self.params, facts, scene), facts.real_depth
        if measured is not None:
            return coc, Real(None, (), 0.0, measured.tiles)
        return coc, real_scene(scene, facts.pose, self.params.background_m)
