"""Lightmap: the object in the light of the frame, and its shadow on itself and, as a ratio, on its plane.

The light comes from the facts (measured, given or refused: `Light.source`), or is the scene's. Shadows are kept by the
direction of their light: a still light costs nothing per frame but the look-up.
Soft light is hidden by what rays find once per clip: in `plane` and `self_occlusion`.
`draft` looks light and shadow up for every 2 x 2 pixels: `coarse`, `lookup`.
Cost: O(pixels of the shadow + covered pixels x taps); a light that moves adds O(directions x edges) a frame.
Leaves out: other real surfaces, shadows of unlike opacity, light from the plane onto the object, caustics.
Source: docs/methods/light.md#shadow, docs/methods/light.md#shading."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, neutral, packed
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View
from arfx.errors import require_within
from arfx.stages.light.split_sum import split_sum
from arfx.stages.light.surroundings import frame_environment
from arfx.stages.lightmap.beams import FrameLight, frame_light
from arfx.stages.lightmap.coarse import block_surface, blocks_around, colour
from arfx.stages.lightmap.coats import add_clear_coat, add_sheen
from arfx.stages.lightmap.lookup import coarse_shadow_ratio, shadow_ratio
from arfx.stages.lightmap.plane import (
    PLANE_LEVELS,
    SoftPicture,
    beam_texture,
    plane_shadow_texture,
    within_surface,
)
from arfx.stages.lightmap.region import SHAPED, ShadowRegion, shadow_region
from arfx.stages.lightmap.self_occlusion import (
    OCCLUSION_LEVELS,
    OcclusionGrid,
    soft_visibility,
    soft_visibility_by_rays,
)
from arfx.stages.lightmap.self_shadow import (
    SELF_LEVELS,
    depth_map,
    visibility_by_map,
    visibility_by_rays,
)
from arfx.stages.lightmap.shading import Lights, Surface, harmonic_terms, highlight_width, shade
from arfx.stages.viewing import direction_grid, seen_rect

COARSE = frozenset({"draft"})  # levels that look light and shadow up for every 2 x 2 pixels
_BEAM_STEP = np.radians(
    0.02
)  # lights nearer to each other than this cast the shadow that was made for the first


@dataclass(frozen=True)
class LightmapParams:
    """formula : corrected, or paper: Tan, Chen, Sun 2009 as printed
    shadow_strength : strength of the shadow on the plane: 0 = none, 1 = as computed
    self_shadow : strength of the object's shadow on itself: 0 = none, 1 = as computed
    faint : a shadow that takes less than this fraction of the plane's light is not drawn; up to 3 times that it fades out, 0..0.3
    plane_blocks : light from below the marker's plane does not reach the object
    ambient : include light without a direction; a job with gi turns this off, because gi computes that light itself"""

    formula: str = field(default="corrected", init=False)
    shadow_strength: float = 1.0
    self_shadow: float = 1.0
    faint: float = 0.02
    plane_blocks: bool = True
    ambient: bool = True

    def __post_init__(self) -> None:
        require_within("lightmap", self, shadow_strength=(0, 1), self_shadow=(0, 1), faint=(0, 0.3))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. ambient : on the plane;  occlusion : on the object, None = by rays;  grid : viewing
    directions"""

    region: ShadowRegion
    ambient: SoftPicture
    occlusion: OcclusionGrid | None
    grid: np.ndarray


class Lightmap(Stage):
    name = "lightmap"
    reads = frozenset(
        {
            Layer.COVERAGE,
            Layer.NORMAL,
            Layer.POSITION,
            Layer.ALBEDO,
            Layer.MATERIAL,
            Layer.EMISSIVE,
            Layer.OCCLUSION,
            Layer.COAT,
            Layer.SHEEN,
        }
    )
    writes = frozenset({Layer.VIRTUAL, Layer.SHADOW})
    levels: ClassVar[tuple[str, ...]] = ("draft", "standard", "high", "reference")
    facts = frozenset({"pose", "light", "environment"})
    Params = LightmapParams
    hard: ClassVar[bool] = False  # lights have no size
    always = True
    terms = ("frames", "mpx", "object_mpx", "lamps", "lamp_mpx", "new_directions")

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        model = facts.raster_box.clip(frame)
        light = self._light(facts, scene)
        shadow, why = self._shadow_rect(facts, scene, frame, light)
        if model.empty and shadow.empty:
            return Demand(EMPTY, f"model out of view; {why}")
        lit = (
            f"model lit ({scene.light_of(facts).source})"
            if not model.empty
            else "model out of view"
        )
        return Demand(model.union(shadow), f"{lit}; {why}")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return blocks_around(out) if level in COARSE else out

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """Shadows are made for each direction of a light, to within a step."""
        if facts.light is None:
            return {"new_directions": None}
        lights = [li for li in facts.light.lights if any(c > 0 for c in li.rgb)]
        key = tuple(
            (*np.round(li.unit / _BEAM_STEP).astype(int).tolist(), round(li.angular_size_deg, 1))
            for li in lights
        )
        return {"new_directions": key} if key else {}

    def prepare(self, scene: Scene, level: str) -> Prepared:
        region = shadow_region(scene)
        grid = direction_grid(scene.camera, 2 if level in COARSE else 1).astype(np.float32)
        ambient = region.ambient_picture(self.params.faint, PLANE_LEVELS[level])
        by_grid = self._soft_occluded and OCCLUSION_LEVELS[level].cells > 0
        return Prepared(
            region,
            ambient,
            region.occlusion_grid(OCCLUSION_LEVELS[level]) if by_grid else None,
            grid,
        )

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        light = self._light(view.facts, view.scene)
        lit = view.layers.crop(view.facts.raster_box.clip(view.rect))
        return {
            Layer.VIRTUAL: Pixels(lit.rect, self._virtual(lit, view, prepared, light)),
            Layer.SHADOW: self._shadow(view, prepared, light),
        }

    def _virtual(
        self, now: Layers, view: View, prepared: Prepared, light: FrameLight
    ) -> np.ndarray:
        """now : its part with the object"""
        if now.rect.empty:
            return neutral(Layer.VIRTUAL, now.rect)
        surface = Surface(*(packed(now[Layer(name)]) for name in Surface._fields))
        eye = view.pose.inverse().translation_m
        reaching = [k for k in range(len(light.beams)) if light.on_object[k] > 0]
        if view.level not in COARSE:
            hidden = self._visibilities(surface, view, prepared, light, reaching, eye)
            if not now.extent(Layer.OCCLUSION).empty:
                hidden = np.minimum(hidden[0], now[Layer.OCCLUSION]), hidden[1]
            return self.shaded(surface, *hidden, reaching, light, view, now)
        at = now.rect.y0, now.rect.x0
        black = block_surface(surface, *at)
        hidden = self._visibilities(black, view, prepared, light, reaching, eye)
        both = (black._replace(albedo=np.full_like(black.albedo, v)) for v in (1, 0))
        made = (self.shaded(blocks, *hidden, reaching, light, view, None) for blocks in both)
        return colour(surface, *at, black.coverage, *made)

    def _visibilities(
        self,
        surface: Surface,
        view: View,
        prepared: Prepared,
        light: FrameLight,
        reaching: Sequence[int],
        eye: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) and (k, h, w): shares of the soft light, and of the lights `reaching`, that the object leaves itself."""
        seen = surface.coverage, surface.normal, surface.position
        visibility = np.ones((len(reaching), *surface.coverage.shape), np.float32)
        if self.params.self_shadow > 0:
            anchor_from_world = view.scene.world_from_anchor.inverse()
            level, caster = SELF_LEVELS[view.level], prepared.region.caster
            for i, k in enumerate(reaching):
                beam = light.beams[k]
                by_map = None
                if level.texels:
                    depths = view.memo.of_light.get(
                        ("depth", beam), partial(depth_map, caster, beam, level)
                    )
                    by_map = visibility[i] = visibility_by_map(
                        *seen, depths, anchor_from_world, level
                    )
                if level.rays:
                    visibility[i] = visibility_by_rays(
                        *seen,
                        prepared.region.rays,
                        caster,
                        beam,
                        anchor_from_world,
                        level,
                        eye,
                        by_map,
                    )
            if self.params.self_shadow < 1:
                visibility = 1 + np.float32(self.params.self_shadow) * (visibility - 1)
        return self._soft_visibility(surface, view, prepared, light), visibility

    def _soft_visibility(
        self, surface: Surface, view: View, prepared: Prepared, light: FrameLight
    ) -> np.ndarray:
        """(h, w) share of the soft light that the object leaves itself."""
        seen = surface.coverage, surface.normal, surface.position
        if not self._soft_occluded:
            return np.ones(surface.coverage.shape, np.float32)
        anchor_from_world, region, grid = (
            view.scene.world_from_anchor.inverse(),
            prepared.region,
            prepared.occlusion,
        )
        if grid is None:
            caster, count = region.caster, OCCLUSION_LEVELS[view.level].rays
            visible = soft_visibility_by_rays(
                *seen,
                region.rays,
                region.soft_picture,
                caster,
                anchor_from_world,
                light.shape,
                count,
            )
        else:
            nodes = view.memo.of_light.get(
                ("object", light.shape), lambda: grid.under(light.shape), "soft"
            )
            visible = soft_visibility(*seen, grid, nodes, anchor_from_world, light.shape)
        strength = np.float32(self.params.self_shadow)
        return visible if strength == 1 else 1 + strength * (visible - 1)

    @property
    def _soft_occluded(self) -> bool:
        return self.params.ambient and self.params.self_shadow > 0 and not self.hard

    def shaded(
        self,
        surface: Surface,
        soft_visibility: np.ndarray,
        visibility: np.ndarray,
        reaching: Sequence[int],
        light: FrameLight,
        view: View,
        now: Layers | None,
    ) -> np.ndarray:
        """VIRTUAL. soft_visibility (h, w), visibility (k, h, w) : of the soft light and of each of the lights `reaching`, past
        the object;  now : the layers of the surface's rectangle, for its coats"""
        f32 = np.float32
        rgb = (light.rgb * light.on_object[:, None])[reaching].astype(f32)
        widths = highlight_width(light.sizes_deg[reaching])
        towards = light.towards[reaching].astype(f32)
        lights = Lights(towards, rgb, widths, visibility, soft_visibility)
        soft_share = f32(self.params.ambient)
        soft = soft_share * harmonic_terms(light.soft, light.ambient)
        environment = frame_environment(view.facts, view.scene, view.light, view.memo.of_light)
        eye = view.pose.inverse().translation_m.astype(f32)
        bias = np.array(view.facts.bias_rgb, f32)
        mirrored = environment, soft_share, split_sum()
        out = shade(surface, eye, lights, soft, *mirrored, bias)
        if now is not None and not now.extent(Layer.SHEEN).empty:
            add_sheen(out, surface, packed(now[Layer.SHEEN]), eye, lights, soft, bias)
        if now is not None and not now.extent(Layer.COAT).empty:
            add_clear_coat(out, surface, packed(now[Layer.COAT]), eye, lights, *mirrored, bias)
        return out

    def _shadow(self, view: View, prepared: Prepared, light: FrameLight) -> Pixels:
        scene = view.scene
        anchor_from_camera = (view.pose @ scene.world_from_anchor).inverse()
        strength = self.params.shadow_strength * prepared.region.caster.opacity
        if (
            anchor_from_camera.translation_m[2] <= 0
            or strength * _darkest(light, scene) <= self.params.faint
        ):
            return Pixels(view.out, neutral(Layer.SHADOW, view.out))
        make_soft = lambda: within_surface(prepared.ambient.under(light.shape), scene.surface_m)  # noqa: E731
        soft = view.memo.of_light.get(("plane", light.shape), make_soft, "soft")
        textures, fractions = [soft], [np.float32(self.params.ambient) * light.ambient_fraction]
        for beam, fraction in zip(light.beams, light.direct_fractions, strict=True):
            if beam.direction[2] > 0 and fraction.max() > 0:
                make = lambda b=beam: within_surface(  # noqa: E731
                    beam_texture(prepared.region.caster, b, PLANE_LEVELS[view.level], self.hard),
                    scene.surface_m,
                )
                textures.append(view.memo.of_light.get(("plane", beam), make))
                fractions.append(fraction)
        real = view.facts.plane_shadow
        blocked = None if real is None else plane_shadow_texture(real, light.ambient_fraction)
        what = (
            anchor_from_camera,
            textures,
            np.array(fractions),
            blocked,
            self.params.faint,
            strength,
        )
        if view.level in COARSE:
            return Pixels(
                view.out, coarse_shadow_ratio(view.out, scene.camera.rect, prepared.grid, *what)
            )
        return Pixels(view.out, shadow_ratio(view.out, prepared.grid, *what))

    def _shadow_rect(
        self, facts: FrameFacts, scene: Scene, frame: Rect, light: FrameLight
    ) -> tuple[Rect, str]:
        """Pixels in which the shadow may show, and why those or none."""
        faint = self.params.faint
        eye = scene.world_from_anchor.inverse().apply(facts.pose.inverse().translation_m)
        if eye[2] <= 0:
            return EMPTY, "no shadow: plane seen from behind"
        most = (
            self.params.shadow_strength
            * shadow_region(scene).caster.opacity
            * _darkest(light, scene)
        )
        if most <= faint:
            return (
                EMPTY,
                f"no shadow: the object takes at most {100 * most:.1f} % of the plane's light",
            )
        beams = [
            (b, float(s.max())) for b, s in zip(light.beams, light.direct_fractions, strict=True)
        ]
        soft = float(light.ambient_fraction.max()) * _unevenness(light)
        outline = shadow_region(scene).outline_m(soft, beams, faint)
        if not len(outline):
            return (
                EMPTY,
                f"no shadow: nowhere does the object take {100 * faint:.1f} % of the plane's light",
            )
        rect = _plane_rect(outline, facts, scene).clip(frame)
        if scene.surface_m is not None:
            x0, y0, x1, y1 = scene.surface_m
            rect = rect.clip(
                _plane_rect(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), facts, scene)
            )
        return (
            rect,
            f"shadow takes up to {100 * most:.0f} % of the plane's light"
            if not rect.empty
            else "shadow out of view",
        )

    def _light(self, facts: FrameFacts, scene: Scene) -> FrameLight:
        return frame_light(
            scene.light_of(facts), scene.world_from_anchor, self.hard, self.params.plane_blocks
        )


def _plane_rect(points_m: np.ndarray, facts: FrameFacts, scene: Scene) -> Rect:
    """Pixels that hold points (n, 2) of the anchor's plane; the whole frame where some are not before the camera."""
    points = np.column_stack([points_m, np.zeros(len(points_m))])
    return seen_rect(scene.camera, facts.pose.apply(scene.world_from_anchor.apply(points)), 1.0)


def _darkest(light: FrameLight, scene: Scene) -> float:
    """The largest share of the plane's light, 0..1, that the object can take: every directional light, and of the ambient
    one what it hides where it hides most."""
    hidden = float(shadow_region(scene).hidden.max())
    hidden = min(hidden * _unevenness(light), 1.0)
    return float((light.ambient_fraction * hidden + light.direct_fractions.sum(0)).max())


def _unevenness(light: FrameLight) -> float:
    """How many times as bright as its mean over the plane's hemisphere the soft light is at most, as far as pictures hold it."""
    return min((1 + float(np.linalg.norm(light.shape))) / (1 + 2 / 3 * light.shape[2]), SHAPED)
