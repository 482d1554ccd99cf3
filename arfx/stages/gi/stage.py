"""Gi: indirect light between the object, its surroundings and the real planes.

Occlusion, colour bleeding and reflections of the picture on the object, and what the object adds to and takes from the planes,
as a ratio. It replaces lightmap's ambient light.

Voxels are made once per clip, their light once per light; planes see the object by rays, once per clip, and are gathered in
their own texels, so a still light costs a frame only the object's own cones and a look-up. `reference` traces rays (embree)
and shares no kernel with the others.
Source: docs/methods/gi.md. Cost: O(covered pixels x cones). Leaves out: real things that are no plane,
caustics, refraction, light that the object sends through its own transparent parts."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, ClassVar

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, neutral, packed
from arfx.core.light import Light
from arfx.core.memo import memo_of
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Check, Demand, JobView, Stage, View
from arfx.errors import require_within
from arfx.stages.gi.cones import DiffuseCones, Lobes, diffuse_cones, lobes, mirror_tangent
from arfx.stages.gi.field import Field, VoxelModel, make_voxel_model
from arfx.stages.gi.frame_light import LevelSettings, frame_field, incoming_light, rounded
from arfx.stages.gi.health import furnace, seams
from arfx.stages.gi.pixels import (
    Anchor,
    Blocks,
    Limits,
    gather_points,
    interpolate,
    reflected_light,
    select_points,
    split_sum,
)
from arfx.stages.gi.plane_pixels import (
    DARKEST,
    PlaneChange,
    add_delta,
    cell_px,
    gloss_of,
    measured,
    mirror_in_planes,
    visible_radius_m,
)
from arfx.stages.gi.real_planes import (
    SHOWS,
    disc_radius_m,
    disc_rect,
    mirror_rect,
    planes_of,
    texel_positions,
)
from arfx.stages.gi.reference import trace_frame
from arfx.stages.gi.surroundings import Background, Planes
from arfx.stages.lightmap.shading import Surface
from arfx.stages.viewing import direction_grid, viewing

VOXELS_KEPT = 1  # of a model: one level on its planes
SMALL_PX = 6  # a grey matt object that changes no more than this lies within edge pixels with all of it
LEVELS = {
    "draft": LevelSettings(32, 64, 6, 128, 5, 0.0, 128),
    "standard": LevelSettings(128, 128, 16, 256, 3, 0.35, 256),
    "high": LevelSettings(128, 256, 16, 512, 2, 1.1, 384),
}


@dataclass(frozen=True)
class GiParams:
    """formula : corrected, or paper: Yao, Tao, Wu 2018 as printed
    strength : strength of the indirect light on the real planes: 0 = none, 1 = as computed
    plane_gloss : fraction of light that the real plane reflects like a mirror, seen from above: 0 = matt, .04 = varnish or glass
    plane_roughness : roughness of the plane's reflection, 0 (a mirror) to 1
    samples : paths per pixel at level reference: noise falls with their root, best at powers of two"""

    formula: str = field(default="corrected", init=False)
    strength: float = 1.0
    plane_gloss: float = 0.0
    plane_roughness: float = 0.1
    samples: int = 64

    def __post_init__(self) -> None:
        require_within("gi", self, strength=(0, 1), plane_gloss=(0, 1), plane_roughness=(0, 1), samples=(1, 65536))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. grid : viewing directions;  positions : of the texels of the picture on the planes"""

    planes: Planes
    grid: np.ndarray
    model: VoxelModel
    cones: DiffuseCones
    lobes: Lobes
    positions: np.ndarray


class Gi(Stage):
    name = "gi"
    reads = frozenset(
        {
            Layer.PLATE, Layer.COVERAGE, Layer.NORMAL, Layer.POSITION, Layer.ALBEDO, Layer.MATERIAL, Layer.EMISSIVE,
            Layer.VIRTUAL, Layer.SHADOW, Layer.REAL_DEPTH,
        }
    )  # fmt: skip
    writes = frozenset({Layer.VIRTUAL, Layer.SHADOW})
    levels: ClassVar[tuple[str, ...]] = ("draft", "standard", "high", "reference")
    facts = frozenset({"pose", "light", "environment"})
    Params = GiParams
    terms = ("frames", "mpx", "object_mpx", "lamps", "new_lights")
    settings: ClassVar[Mapping[str, LevelSettings]] = LEVELS  # of every level but `reference`
    overrides: ClassVar = {"lightmap": {"ambient": False}}  # gi gives all light without a direction

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        model = facts.raster_box.clip(frame)
        if size_px := self._imperceptible_px(facts, scene):
            return Demand(model, f"no cones: the model is matt and grey, and what it changes is {size_px} px wide; even light")
        disc, why = self._disc(facts, scene, frame)
        mirror = self._mirror_rect(facts, scene, frame)
        if model.empty and disc.empty and mirror.empty:
            return Demand(EMPTY, f"model out of view; {why}")
        if not mirror.empty:
            why += f", and mirrors {self.params.plane_gloss:g} of the light"
        return Demand(model.union(disc).union(mirror), f"{'model' if not model.empty else 'no model'} in view; {why}")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """The picture that the object reflects lies on the planes around it; blocks of pixels are whole."""
        block = self.settings[level].block if level in self.settings else 1
        return out.pad(2 * block).align(block, block).union(_reflected_rect(facts, scene)).clip(scene.camera.rect)

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """The voxels' light is made for each light and its surroundings, both rounded."""
        if facts.light is None:
            return {"new_lights": None}
        return {"new_lights": (repr(rounded(facts.light)), facts.environment)}

    def health(self, job: JobView) -> Iterable[Check]:
        return chain(seams(job), furnace(job))

    def prepare(self, scene: Scene, level: str) -> Prepared | None:
        if level == "reference":
            return None
        planes, at = planes_of(scene), self.settings[level]
        shape = at.voxels, at.plane_side, at.plane_cones, at.plane_rays
        model = memo_of(scene.model).get(
            (scene.placed_by, *planes.key, *shape), lambda: make_voxel_model(scene, shape[0], planes, *shape[1:]), "voxels",
            VOXELS_KEPT,
        )  # fmt: skip
        return Prepared(
            planes, direction_grid(scene.camera), model, diffuse_cones(at.voxels), lobes(at.voxels),
            texel_positions(planes, _texture_side(scene, at)),
        )  # fmt: skip

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray | Pixels]:
        facts, now, scene, pose, frame = view.facts, view.layers, view.scene, view.pose, view.scene.camera.rect
        if self._imperceptible_px(facts, scene):  # the light's soft part on the object as if nothing were in its way
            soft = view.light.soft_radiance(now[Layer.NORMAL]) * now[Layer.ALBEDO] * now[Layer.COVERAGE][..., None]
            return {Layer.VIRTUAL: now[Layer.VIRTUAL] + soft.astype(np.float32), Layer.SHADOW: now[Layer.SHADOW].copy()}
        disc, mirror = self._disc(facts, scene, frame)[0], self._mirror_rect(facts, scene, frame)
        if view.level == "reference":
            return trace_frame(
                view, planes_of(scene), _reflected_rect(facts, scene), disc, self.params.samples, self.params.strength,
                (self.params.plane_gloss, self.params.plane_roughness), mirror,
            )  # fmt: skip
        at, planes, f32 = self.settings[view.level], prepared.planes, np.float32
        incoming = incoming_light(view, _reflected_rect(facts, scene), planes, prepared.positions)
        indirect = frame_field(view, prepared.model, planes, incoming, at)
        background = incoming.background_with(indirect, prepared.model.visibility)
        virtual = self._virtual(view, prepared, indirect, background, incoming.soft)
        radius = visible_radius_m(indirect.delta, prepared.model.positions, planes.axes, self._radius_m(view.light, scene))
        disc = disc_rect(scene, planes, radius, pose, frame) if radius > 0 and not disc.empty else EMPTY
        part = now.extent(Layer.SHADOW).union(disc).union(mirror).clip(view.out).clip(now.rect)
        shadow, here = _written(now, Layer.SHADOW, part), now.crop(part)
        real = measured(here)
        anchor_from_camera = (pose @ scene.world_from_anchor).inverse()
        eye = anchor_from_camera.translation_m.astype(f32)
        if not disc.clip(part).empty:
            nodes = (prepared.grid @ anchor_from_camera.rotation.T).astype(f32)
            px_per_m = scene.camera.matrix[0, 0] / max(float(np.linalg.norm(eye - planes.axes[0, 0])), 1e-9)
            cell = np.int64(cell_px(px_per_m, planes.half_m, at.plane_side))
            change = PlaneChange(
                indirect.delta, indirect.extra_occlusion, f32(planes.half_m), f32(radius), f32(self.params.strength), cell
            )  # fmt: skip
            add_delta(shadow, part.x0, part.y0, np.array(disc.to_json()), nodes, eye, planes.axes, change, real)
        if not (mirror := mirror.clip(part)).empty:
            plate, bias = np.ascontiguousarray(now.crop(mirror)[Layer.PLATE]), np.array(facts.bias_rgb, f32)
            gloss = gloss_of(self.params.plane_gloss, self.params.plane_roughness, prepared.lobes)
            rays, at_mirror = viewing(prepared.grid @ anchor_from_camera.rotation.T, mirror), mirror.slices_in(part)
            mirrored = self.params.strength * mirror_in_planes(
                plate, rays, eye, bias, gloss, prepared.model.placed(indirect.atlas), background,
                np.ascontiguousarray(real[at_mirror]) if real.size else real,
            )  # fmt: skip
            shadow[at_mirror] = np.clip(shadow[at_mirror] + mirrored / np.maximum(plate - bias, DARKEST), 0, None)
        return {Layer.VIRTUAL: virtual, Layer.SHADOW: Pixels(now.rect, shadow, part=part)}

    def _virtual(self, view: View, prepared: Prepared, field: Field, background: Background, soft: float) -> Pixels:
        """soft : least channel of the light without a direction, of a white surface on the plane"""
        now, at = view.layers, self.settings[view.level]
        block, shown = at.block, view.facts.raster_box.clip(view.out)
        part = now.extent(Layer.VIRTUAL).clip(view.out).union(shown).clip(now.rect)
        out = _written(now, Layer.VIRTUAL, part)
        box = EMPTY if shown.empty else shown.pad(block).align(block, block).clip(view.facts.raster_box.align(block, block))
        if (box := box.clip(now.rect)).empty:
            return Pixels(now.rect, out, part=part)
        here = now.crop(box)
        anchor, f32 = view.scene.world_from_anchor.inverse(), np.float32
        surface = Surface(*(packed(here[Layer(name)]) for name in Surface._fields))
        eye = anchor.apply(view.pose.inverse().translation_m).astype(f32)
        axes = Anchor(anchor.rotation.astype(f32), anchor.translation_m.astype(f32), eye)
        cones = prepared.model.placed(field.atlas), prepared.cones, prepared.lobes, background
        brightest = max(float(background.maps.max()), float(background.textures.max()), field.brightest)
        limits = Limits(f32(at.sharp), f32(SHOWS * divide(soft, brightest)), split_sum())
        points, light, index = np.zeros((0, 8), f32), np.zeros((0, 6), f32), np.zeros((0, 0), np.int32)
        if block > 1:
            points, gather, index = select_points(surface, box.x0, box.y0, block, axes, limits)
            light = gather_points(points, gather, eye, *cones)
        voxel_m = f32(prepared.model.voxels.volume.voxel_m)
        blocks = Blocks(block if block > 1 else 0, voxel_m, points, light, index)
        interpolated, points, gather, pixels = interpolate(surface, box.x0, box.y0, blocks, axes, limits)
        gathered = gather_points(points, gather, eye, *cones)
        both = box.clip(part)
        added = reflected_light(surface, axes, limits, interpolated, gathered, gather, pixels)
        out[both.slices_in(part)] += added[both.slices_in(box)]
        return Pixels(now.rect, out, part=part)

    def _mirror_rect(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Rect:
        """Pixels in which glossy planes can mirror the object."""
        if self.params.plane_gloss <= 0 or self.params.strength <= 0:
            return EMPTY
        return mirror_rect(scene, planes_of(scene), float(mirror_tangent(self.params.plane_roughness)), facts.pose, frame)

    def _disc(self, facts: FrameFacts, scene: Scene, frame: Rect) -> tuple[Rect, str]:
        """Pixels of the real planes that may change, and why those or none."""
        if self.params.strength <= 0:
            return EMPTY, "planes left alone"
        radius = self._radius_m(scene.light_of(facts), scene)
        if radius <= 0:
            return EMPTY, "no indirect light on the plane"
        rect = disc_rect(scene, planes_of(scene), radius, facts.pose, frame)
        if rect.empty:
            return rect, "plane out of view or seen from behind"
        return rect, f"plane changes by half a grey level within {100 * radius:.0f} cm"

    def _radius_m(self, light: Light, scene: Scene) -> float:
        """Of the disc on the planes; 0 where there is no indirect light at all."""
        up = scene.world_from_anchor.rotation[:, 2]
        soft, total = light.soft_radiance(up).max(), light.radiance(up).max()
        materials = [p.material for p in scene.model.parts]
        glow = max(max(m.emissive) for m in materials)
        peak = float(soft) + sum(max(li.rgb) for li in light.lights) + glow
        if peak <= 0:
            return 0.0
        ratio = max(float(soft), peak) / max(float(total), 1e-3)
        return disc_radius_m(scene, planes_of(scene), ratio)

    def _imperceptible_px(self, facts: FrameFacts, scene: Scene) -> int:
        """Size of all that cones could change, where it is imperceptible, else 0: the planes change by half a grey level within
        a few pixels only, and the object neither colours nor mirrors anything."""
        if facts.model_box.empty or self.params.plane_gloss > 0 or not is_plain_grey(scene):
            return 0
        radius = self._radius_m(scene.light_of(facts), scene)
        wide = facts.model_box.union(disc_rect(scene, planes_of(scene), radius, facts.pose, scene.camera.rect))
        size = max(wide.width, wide.height)
        return size if size <= SMALL_PX else 0


def _written(layers: Layers, name: Layer, part: Rect) -> np.ndarray:
    """A copy of a layer over a part of it, to be written to."""
    written = layers.extent(name).clip(part)
    if written == part:
        return layers.crop(part)[name].copy()
    out = neutral(name, part)
    if not written.empty:
        out[written.slices_in(part)] = layers.crop(written)[name]
    return out


def _reflected_rect(facts: FrameFacts, scene: Scene) -> Rect:
    """Pixels of the picture that the object may reflect."""
    planes = planes_of(scene)
    return disc_rect(scene, planes, planes.half_m, facts.pose, scene.camera.rect)


def _texture_side(scene: Scene, at: LevelSettings) -> int:
    """Texels of the picture on a plane: few where nothing mirrors sharply enough to show more."""
    materials = [p.material for p in scene.model.parts]
    sharp = [m.roughness < 0.5 or m.metallic_roughness_texture is not None for m in materials]
    mirrors = [0.08 * m.specular * (1 - m.metallic) + m.metallic > 0 for m in materials]
    return at.texture_side if any(a and b for a, b in zip(sharp, mirrors, strict=True)) else min(at.texture_side, 64)


def is_plain_grey(scene: Scene) -> bool:
    """Whether the model is matt and grey all over: nothing glows, mirrors more than half a grey level, or has a colour."""
    for part in scene.model.parts:
        m = part.material
        if m.base_texture is not None or m.metallic_roughness_texture is not None or part.colours is not None:
            return False
        if max(m.emissive) > 0 or 0.08 * m.specular * (1 - m.metallic) + m.metallic > SHOWS:
            return False
        if max(m.base_colour[:3]) - min(m.base_colour[:3]) > SHOWS:
            return False
    return True
