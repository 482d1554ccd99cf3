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

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.real_depth import TILE_PX
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Check, Demand, JobView, Stage, View
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.blur import LEVELS, blurred
from arfx.stages.dof.layers import (
    box_of,
    layers_of_light,
    object_box,
    object_radius_px,
)
from arfx.stages.dof.optics import (
    CircleOfConfusion,
    circle_of_confusion,
    unknown_lens,
)
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real, direction_grid, real_scene
from arfx.stages.viewing import GRID_PX


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
        on_object, on_real = self._radii_px(facts, scene, coc, real)
        largest = max(on_object, on_real)
        if largest <= SHARP_PX:
            return Demand(EMPTY, f"largest blur circle {2 * largest:.1f} px < 1 px")
        rect = EMPTY
        if on_object > SHARP_PX:
            rect = object_box(facts, frame, 2 * on_object)
        if on_real > SHARP_PX:
            around = blurred_rect(real, direction_grid(scene.camera), coc)
            rect = rect.union(around.clip(frame))
        words = f"blur circles up to {2 * largest:.1f} px"
        return Demand(rect, words if not rect.empty else f"{words}, but out of view")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """Pixels whose light can reach `out`, and those that decide how far it is spread."""
        if facts.camera_from_world is None or unknown_lens(self.params, facts):
            return out
        coc, real = self._frame(facts, scene)
        need, frame = out, scene.camera.rect
        if self.params.scope == "all" and real.tiles is not None:
            return (
                frame  # what is hidden is filled in from wherever something is known
            )
        on_object, on_real = self._radii_px(facts, scene, coc, real)
        if on_real > SHARP_PX:
            need = out.pad((3 if real.finite_planes else 1) * _margin_px(on_real))
        if on_object > SHARP_PX:
            # outside of an outline the radius goes on: light, its own continuation, and what that
            # is from
            box = object_box(facts, frame, 2 * on_object)
            need = need.union(out.clip(box).pad(3 * _margin_px(on_object)))
        return need.clip(frame)

    def _radii_px(
        self, facts: FrameFacts, scene: Scene, coc: CircleOfConfusion, real: Real
    ) -> tuple[float, float]:
        """Bounds of the blur's radius on the virtual object, 0 where none is in view, and on the
        real scene, 0 where it keeps its own blur."""
        on_object, on_real = object_radius_px(facts, coc), 0.0
        if self.params.scope == "all":
            on_real = coc.largest_px(real.dioptre_range(direction_grid(scene.camera)))
        return on_object, on_real

    def health(self, job: JobView) -> Iterator[Check]:
        """The lens of the blur: given, or measured from the footage's edges."""
        name = "lens of the blur"
        if self.params.lens != "footage":
            yield Check(name, "given", "given or measured", True, "")
            return
        fits = [f.lens for f in job.facts if f.lens is not None]
        known = [f for f in fits if f.known]
        reason = fits[0].reason if fits else "not measured"
        found, action = (
            "measured" if known else "refused",
            f"object stays sharp: {reason}",
        )
        yield Check(name, found, "measured", bool(known), action)
        if known:
            halves = [divide(f.px_per_dioptre_ci95, f.px_per_dioptre) for f in known]
            most, name = float(max(halves)), f"{name}, half width of its interval"
            yield Check(name, most, 0.5, most <= 0.5, "blur is a rough guess")

    def prepare(self, scene: Scene, level: str) -> Any:
        if level == "reference":
            from arfx.stages.dof.lens_rays import RayScene

            return RayScene(scene)
        return direction_grid(scene.camera)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray | Pixels]:
        now, facts, scene = view.layers, view.facts, view.scene
        if not facts.present or unknown_lens(self.params, facts):
            return {Layer.IMAGE: now[Layer.IMAGE].copy()}
        coc, real = self._frame(facts, scene)
        if view.level == "reference":
            from arfx.stages.dof.reference import render

            image = render(now, facts, scene, real, coc, self.params, prepared)
            return {Layer.IMAGE: image}
        layers = layers_of_light(now, facts, real, prepared, coc, self.params)
        how = view.out, LEVELS[view.level], self.params
        image = blurred(now[Layer.IMAGE], layers, *how)
        rows = Rect(now.rect.x0, view.out.y0, now.rect.x1, view.out.y1)
        return {Layer.IMAGE: Pixels(rows, image).clip(view.out)}

    def _frame(
        self, facts: FrameFacts, scene: Scene
    ) -> tuple[CircleOfConfusion, Real]:
        """The lens, and where the real scene stands."""
        real = real_scene(scene, facts.pose, self.params.background_m)
        if facts.real_depth is not None:
            real = replace(real, finite_planes=(), tiles=facts.real_depth.tiles)
        return circle_of_confusion(self.params, facts, scene), real


def blurred_rect(real: Real, grid: ndarray, coc: CircleOfConfusion) -> Rect:
    """Rectangle of the tiles with a blur circle of 1 px or more, and what their discs reach."""
    if real.tiles is not None:
        # the largest circle of a range is at one of its ends
        radius, side, node = coc.radius_px(real.tiles).max(0), TILE_PX, 0
    else:
        # a node stands for the tiles around it
        radius, side, node = coc.radius_px(real.dioptres(grid)), GRID_PX, GRID_PX
        for plane in real.finite_planes:
            positions = plane.positions(grid)
            own = coc.radius_px(np.maximum(positions[..., 2], 0))
            radius = np.maximum(
                radius, np.where(plane.within(positions, 4.0), own, 0)
            )
    box = box_of(radius > SHARP_PX)
    whole = Rect(*(side * v for v in box))
    return whole.pad(int(np.ceil(float(radius.max()))) + 1 + node)


def _margin_px(radius_px: float) -> int:
    """How far light goes, with interpolation between cells, which grow with the radius."""
    return int(np.ceil(2.5 * radius_px)) + 2 * GRID_PX
