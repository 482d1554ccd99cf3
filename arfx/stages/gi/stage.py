"""Gi: indirect light between the object, its surroundings and the real planes.

The object in the light of its surroundings (occlusion, colour bleeding, reflections of the picture),
and what it adds to and takes from the real planes, as a ratio. Takes the place of lightmap's light without a direction.

Voxels are made once per clip, their light once per light; planes see the object by rays, once per clip, and are gathered in
their own texels, so a still light costs a frame only the object's own cones and a look-up. `reference` traces rays (embree)
and shares no kernel with the others.
Source: docs/methods/gi.md. Cost: O(covered pixels x cones). Leaves out: real things that are no plane,
caustics, refraction, light that the object sends through its own transparent parts.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.numerics import divide
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Check, Demand, JobView, Stage, View
from arfx.errors import require_within
from arfx.stages.gi.cones import mirror_tangent, six_cones, steps_of
from arfx.stages.gi.field import Body, Field, make_body
from arfx.stages.gi.frame_light import Around, LevelSettings, around, frame_field, rounded
from arfx.stages.gi.health import furnace, seams
from arfx.stages.gi.pixels import LOBES, Anchor, ConesAround, Limits, Lobes, Surface, chosen, light_points, reflected, spread
from arfx.stages.gi.plane_gloss import SHARPEST, Gloss, mirror_in_planes, mirror_rect
from arfx.stages.gi.plane_pixels import DARKEST, Change, add_delta, measured, shown_radius_m
from arfx.stages.gi.real_planes import SHOWS, disc_radius_m, disc_rect, planes_of, texture_places
from arfx.stages.gi.reference import trace_frame
from arfx.stages.gi.split_sum import split_sum
from arfx.stages.gi.surroundings import Planes
from arfx.stages.viewing import direction_grid, viewing

SMALL_PX = 6  # a grey matt object that changes no more than this lies within edge pixels with all of it
LEVELS = {
    "draft": LevelSettings(32, 64, 6, 128, 4, True, 2.0, 2.0),
    "standard": LevelSettings(64, 128, 16, 256, 3, True, 0.35, 0.0, 256),
    "high": LevelSettings(128, 256, 16, 512, 1, True, 1.1, 0.0, 384),
}


@dataclass(frozen=True)
class GiParams:
    """formula : corrected, or paper: Yao, Tao, Wu 2018 as printed
    strength : share of the computed change of the real planes that is shown, 0..1
    plane_gloss : of the real plane, share of light that it mirrors seen from above: 0 = matt, varnish and glass .04, 0..1
    plane_roughness : of its gloss, 0 (a mirror) to 1
    samples : rays per pixel of level reference
    """

    formula: str = field(default="corrected", init=False)
    strength: float = 1.0
    plane_gloss: float = 0.0
    plane_roughness: float = 0.1
    samples: int = 64

    def __post_init__(self) -> None:
        require_within("gi", self, strength=(0, 1), plane_gloss=(0, 1), plane_roughness=(0, 1), samples=(1, 65536))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. body : voxels, None at level reference"""

    planes: Planes
    grid: np.ndarray
    body: Body | None
    lobes: np.ndarray
    counts: np.ndarray
    tangents: np.ndarray
    steps: np.ndarray
    places: np.ndarray


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
        if size_px := self._unseen_px(facts, scene):
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
        frame = scene.camera.rect
        return out.pad(2 * block).align(block, block).union(self._seen(facts, scene, frame)).clip(frame)

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """The voxels' light is made for each light and its surroundings, both rounded."""
        if facts.light is None:
            return {"new_lights": None}
        return {"new_lights": (repr(rounded(facts.light)), facts.environment)}

    def health(self, job: JobView) -> Iterator[Check]:
        yield from seams(job)
        yield from furnace(job)

    def prepare(self, scene: Scene, level: str) -> Prepared:
        planes = planes_of(scene)
        grid = direction_grid(scene.camera)
        empty = np.zeros(0, np.float32)
        if level == "reference":
            return Prepared(planes, grid, None, empty, empty, empty, empty, empty)
        at = self.settings[level]
        body = make_body(scene, at.voxels, planes, at.plane_side, at.plane_cones, at.plane_rays, at.coarser)
        tangents = mirror_tangent(np.linspace(0, 1, LOBES))
        rows = [steps_of(float(t), at.voxels) for t in tangents]
        lobes = np.zeros((LOBES, max(len(r) for r in rows), 3), np.float32)
        for k, r in enumerate(rows):
            lobes[k, : len(r)] = r
        return Prepared(
            planes, grid, body, lobes, np.array([len(r) for r in rows]), tangents.astype(np.float32),
            steps_of(six_cones()[2], at.voxels), texture_places(planes, _texture_side(scene, at)),
        )  # fmt: skip

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray]:
        facts, now, scene, pose = view.facts, view.layers, view.scene, view.pose
        frame = scene.camera.rect
        if self._unseen_px(facts, scene):
            return even_light(view)
        disc = self._disc(facts, scene, frame)[0]
        if view.level == "reference":
            return trace_frame(
                view, prepared.planes, self._seen(facts, scene, frame), disc, self.params.samples, self.params.strength,
                (self.params.plane_gloss, self.params.plane_roughness), self._mirror_rect(facts, scene, frame),
            )  # fmt: skip
        at = self.settings[view.level]
        made = around(view, self._seen(facts, scene, frame), prepared.planes, prepared.places)
        whole = frame_field(view, prepared.body, prepared.planes, made, at)
        virtual = self._virtual(view, prepared, at, made.lit(whole))
        shadow, real = now[Layer.SHADOW], measured(now[Layer.REAL_DEPTH])
        radius = shown_radius_m(whole.delta, prepared.body.places, prepared.planes.axes, SHOWS, self._radius_m(view.light, scene))
        if not disc.empty and radius > 0:
            disc = disc_rect(scene, prepared.planes, radius, pose, frame)
            anchor_from_camera = (pose @ scene.world_from_anchor).inverse()
            nodes = (prepared.grid @ anchor_from_camera.rotation.T).astype(np.float32)

            def added(layer: np.ndarray, delta: np.ndarray, weight: float) -> np.ndarray:
                """The layer and `weight` times what lies on the planes."""
                changed: np.ndarray = add_delta(
                    layer, now.rect.x0, now.rect.y0, np.array(disc.to_json()), nodes,
                    anchor_from_camera.translation_m.astype(np.float32), prepared.planes.axes,
                    Change(delta, whole.deeper, np.float32(prepared.planes.half_m), np.float32(radius), np.float32(weight)), real,
                )  # fmt: skip
                return changed

            virtual, shadow = self.on_planes(whole, virtual, shadow, view, added)
        if self.params.plane_gloss > 0 and self.params.strength > 0:
            virtual, shadow = self._mirrored(view, prepared, made.lit(whole), virtual, shadow, real)
        return {Layer.VIRTUAL: virtual, Layer.SHADOW: shadow.copy() if shadow is now[Layer.SHADOW] else shadow}

    def on_planes(
        self, field: Field, virtual: np.ndarray, shadow: np.ndarray, view: View,
        added: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """VIRTUAL and SHADOW with what the object does to the planes: a share of the pixel."""
        return virtual, added(shadow, field.delta, self.params.strength)

    def in_mirrors(
        self, change: np.ndarray, light: np.ndarray, virtual: np.ndarray, shadow: np.ndarray, view: View, within: Rect
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """The same of its mirror image, by which the planes' light changes within a rectangle."""
        out, at = shadow.copy(), within.slices_in(view.rect)
        out[at] = np.clip(out[at] + change / np.maximum(light, DARKEST), 0, None)
        return virtual, out

    def _virtual(self, view: View, prepared: Prepared, at: LevelSettings, back: Around) -> np.ndarray:
        now, out = view.layers, view[Layer.VIRTUAL].copy()
        block = at.block
        box = view.facts.raster_box.align(block, block).clip(now.rect)
        if box.empty:
            return out
        part = now.crop(box)
        assert prepared.body is not None and back.atlas is not None
        anchor = view.scene.world_from_anchor.inverse()
        f32, volume = np.float32, prepared.body.voxels.volume
        directions, weights, tan_half = six_cones()
        surface = Surface(*(part[name] for name in (Layer.COVERAGE, Layer.NORMAL, Layer.POSITION, Layer.ALBEDO, Layer.MATERIAL)))
        eye = anchor.apply(view.pose.inverse().translation_m).astype(f32)
        axes = Anchor(anchor.rotation.astype(f32), anchor.translation_m.astype(f32), eye)
        cones: Any = (
            back.atlas.bricks, np.array(volume.low_m, f32), f32(volume.voxel_m),
            ConesAround(directions, weights, f32(tan_half), f32(np.degrees(np.arctan(tan_half))), prepared.steps),
            Lobes(prepared.lobes, prepared.tangents, prepared.counts), back.back,
        )  # fmt: skip
        limits = Limits(f32(at.sharp), f32(at.gloss_floor), f32(SHOWS * divide(back.soft, back.brightest)), split_sum())
        points, light = np.zeros((0, 7), f32), np.zeros((0, 6), f32)
        index = np.zeros((0, 0), np.int32)
        if block > 1:
            points, wanted, index = chosen(surface, box.x0, box.y0, block, axes, limits)
            light = light_points(points, wanted, eye, *cones)
        near: Any = surface, box.x0, box.y0, block if block > 1 else 0, axes, limits, f32(volume.voxel_m), points, light, index
        spread_light, points, wanted, pixels = spread(*near)
        fresh = light_points(points, wanted, eye, *cones)
        out[box.slices_in(now.rect)] += reflected(surface, axes, limits, spread_light, fresh, wanted, pixels)
        return out

    def _mirrored(
        self, view: View, prepared: Prepared, back: Around, virtual: np.ndarray, shadow: np.ndarray, real: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        now, facts, scene, rect = view.layers, view.facts, view.scene, view.rect
        assert prepared.body is not None and back.atlas is not None
        within = self._mirror_rect(facts, scene, scene.camera.rect).clip(rect)
        if within.empty:
            return virtual, shadow
        f32, volume = np.float32, prepared.body.voxels.volume
        lobe = round(max(self.params.plane_roughness, SHARPEST) * (LOBES - 1))
        anchor_from_camera = (view.pose @ scene.world_from_anchor).inverse()
        rays = viewing(prepared.grid @ anchor_from_camera.rotation.T, within)
        bias = np.array(facts.bias_rgb, f32)
        plate = np.ascontiguousarray(now.crop(within)[Layer.PLATE])
        gloss = Gloss(
            f32(self.params.plane_gloss), f32(self.params.plane_roughness), split_sum(),
            prepared.lobes[lobe, : prepared.counts[lobe]], prepared.tangents[lobe], f32(SHOWS),
        )  # fmt: skip
        arguments: Any = (
            plate, rays, anchor_from_camera.translation_m.astype(f32), bias, gloss, back.atlas.bricks,
            np.array(volume.low_m, f32), f32(volume.voxel_m), back.back,
            real if not real.size else np.ascontiguousarray(real[within.slices_in(rect)]),
        )  # fmt: skip
        change = self.params.strength * mirror_in_planes(*arguments)
        return self.in_mirrors(change, plate - bias, virtual, shadow, view, within)

    def _mirror_rect(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Rect:
        """Pixels in which glossy planes can mirror the object."""
        pose = facts.camera_from_world
        if pose is None or self.params.plane_gloss <= 0 or self.params.strength <= 0:
            return EMPTY
        return mirror_rect(scene, planes_of(scene), float(mirror_tangent(self.params.plane_roughness)), pose, frame)

    def _disc(self, facts: FrameFacts, scene: Scene, frame: Rect) -> tuple[Rect, str]:
        """Pixels of the real planes that may change, and why those or none."""
        pose = facts.camera_from_world
        if pose is None or self.params.strength <= 0:
            return EMPTY, "planes left alone"
        radius = self._radius_m(scene.light_of(facts), scene)
        if radius <= 0:
            return EMPTY, "no indirect light on the plane"
        rect = disc_rect(scene, planes_of(scene), radius, pose, frame)
        if rect.empty:
            return rect, "plane out of view or seen from behind"
        return rect, f"plane changes by half a grey level within {100 * radius:.0f} cm"

    def _radius_m(self, light: Light, scene: Scene) -> float:
        """Of the disc on the planes; 0 where there is no indirect light at all."""
        up = scene.world_from_anchor.rotation[:, 2]
        soft, whole = light.soft_radiance(up).max(), light.radiance(up).max()
        materials = [p.material for p in scene.model.parts]
        glow = max(max(m.emissive) for m in materials)
        peak = float(soft) + sum(max(li.rgb) for li in light.lights) + glow
        if peak <= 0:
            return 0.0
        share = max(float(soft), peak) / max(float(whole), 1e-3)
        return disc_radius_m(scene, planes_of(scene), share)

    def _unseen_px(self, facts: FrameFacts, scene: Scene) -> int:
        """Size of all that cones could tell, where nobody could see it, else 0: the planes change by half a grey level within
        a few pixels only, and the object neither colours nor mirrors anything."""
        pose = facts.camera_from_world
        if pose is None or facts.model_box.empty or self.params.plane_gloss > 0 or not plain(scene):
            return 0
        radius = self._radius_m(scene.light_of(facts), scene)
        wide = facts.model_box.union(disc_rect(scene, planes_of(scene), radius, pose, scene.camera.rect))
        size = max(wide.width, wide.height)
        return size if size <= SMALL_PX else 0

    def _seen(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Rect:
        """Pixels of the picture that the object may reflect."""
        pose = facts.camera_from_world
        planes = planes_of(scene)
        return EMPTY if pose is None else disc_rect(scene, planes, planes.half_m, pose, frame)


def _texture_side(scene: Scene, at: LevelSettings) -> int:
    """Texels of the picture on a plane: few where nothing mirrors sharply enough to show more."""
    materials = [p.material for p in scene.model.parts]
    sharp = [m.roughness < 0.5 or m.metallic_roughness_texture is not None for m in materials]
    mirrors = [0.08 * m.specular * (1 - m.metallic) + m.metallic > at.gloss_floor for m in materials]
    return at.texture_side if any(a and b for a, b in zip(sharp, mirrors, strict=True)) else min(at.texture_side, 64)


def plain(scene: Scene) -> bool:
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


def even_light(now: View) -> Mapping[Layer, np.ndarray]:
    """VIRTUAL with the light's soft part on the object as if nothing were in its way, SHADOW as it is."""
    soft = now.light.soft_radiance(now[Layer.NORMAL]) * now[Layer.ALBEDO] * now[Layer.COVERAGE][..., None]
    return {Layer.VIRTUAL: now[Layer.VIRTUAL] + soft.astype(np.float32), Layer.SHADOW: now[Layer.SHADOW].copy()}
