"""Lightmap: the object in the light of the frame, and its shadow on itself and, as a ratio,
on its plane.

The light comes from the facts (measured, given or refused: `Light.source`), or is the
scene's. Shadows are kept by the direction of their lamp: a still light costs nothing per
frame but the look-up. Soft light is hidden by what silhouettes (on the plane) and rays (on
the object) find once a clip.
Cost: O(pixels of the shadow + covered pixels x taps); a lamp that moves adds O(directions x
edges) a frame.
Leaves out: other real surfaces, shadows of unlike opacity, light from the plane onto the
object, caustics.
Source: docs/methods/light.md#shadow, docs/methods/light.md#shading."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, neutral, packed
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, Settings, setting
from arfx.core.stage import Demand, Stage, View
from arfx.stages.light.beams import Beam, FrameLight, frame_light
from arfx.stages.light.bumps import share_above_surface, smooth_normal
from arfx.stages.light.plane_lookup import PlaneTexture, PlaneView, shadow_ratio
from arfx.stages.light.plane_shadow import (
    PLANE_LEVELS,
    beam_textures,
    plane_shadow_texture,
    under_light,
    within_surface,
)
from arfx.stages.light.region import (
    ShadowRegion,
    darkest,
    plane_rect,
    shadow_region,
    unevenness,
)
from arfx.stages.light.soft_visibility import (
    SoftVisibility,
    soft_visibility,
    visible_fraction,
    visible_fraction_by_rays,
)
from arfx.stages.light.split_sum import split_sum
from arfx.stages.light.surroundings import frame_environment
from arfx.stages.lightmap.coats import add_clear_coat, add_sheen
from arfx.stages.lightmap.self_shadow import (
    depth_map,
    visibility_by_map,
    visibility_by_rays,
)
from arfx.stages.lightmap.shading import (
    Lights,
    Surface,
    harmonic_terms,
    highlight_width,
    shade,
)
from arfx.stages.viewing import direction_grid

_BEAM_STEP = np.radians(
    0.02
)  # lights nearer to each other than this cast the shadow that was made for the first

# times `faint`: what is left of it, faded, is .0036 of the light, half a level of a grey
# plane
_SHOWS_FAINTS = 1.45
_SOFT_STEPS = 32


class LightmapParams(Settings):
    formula: str = setting(
        "corrected", "corrected, or paper: Tan, Chen, Sun 2009 as printed"
    )
    shadow_strength: Fraction = setting(
        1.0, "strength of the shadow on the plane: 0 = none, 1 = as computed"
    )
    self_shadow: Fraction = setting(
        1.0, "strength of the object's shadow on itself: 0 = none, 1 = as computed"
    )
    plane_blocks: bool = setting(
        True, "light from below the marker's plane does not reach the object"
    )


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level.

    soft : pictures of the plane that add up;  visibility : on the object, None = by rays;
    grid : viewing directions
    """

    region: ShadowRegion
    soft: tuple[PlaneTexture, ...]
    visibility: SoftVisibility | None
    grid: ndarray


class Lightmap(Stage):
    name = "lightmap"
    soft = True  # it gives the light without a direction: in a job with gi, that does
    levels: ClassVar[tuple[str, ...]] = ("standard", "reference")
    facts = frozenset({"pose", "light", "environment"})
    Params = LightmapParams
    hard: ClassVar[bool] = False  # lights have no size
    # A shadow that takes less than this share of the plane's light is not drawn; up to 3
    # times that it fades out.
    faint: ClassVar[float] = 0.02
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

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """Shadows are made for each direction of a light, to within a step."""
        if facts.light is None:
            return {"new_directions": None}
        lights = [li for li in facts.light.lights if any(c > 0 for c in li.rgb)]
        key = tuple(
            (
                *np.round(li.unit / _BEAM_STEP).astype(int).tolist(),
                round(li.angular_size_deg, 1),
            )
            for li in lights
        )
        return {"new_directions": key} if key else {}

    def prepare(self, scene: Scene, level: str) -> Prepared:
        region = shadow_region(scene)
        soft = region.soft_pictures(PLANE_LEVELS[level], self._shows_from)
        visibility = None
        if self._soft_occluded and level != "reference":
            visibility = soft_visibility(scene, region.rays, region.soft)
        return Prepared(region, soft, visibility, direction_grid(scene.camera))

    def run(self, view: View, prepared: Any) -> Mapping[Layer, Pixels]:
        light = self._light(view.facts, view.scene)
        lit = view.layers.crop(view.facts.raster_box.clip(view.rect))
        return {
            Layer.VIRTUAL: Pixels(
                lit.rect, self._virtual(lit, view, prepared, light)
            ),
            Layer.SHADOW: self._shadow(view, prepared, light),
        }

    def _virtual(
        self, now: Layers, view: View, prepared: Prepared, light: FrameLight
    ) -> ndarray:
        """now : its part with the object"""
        if now.rect.empty:
            return neutral(Layer.VIRTUAL, now.rect)
        surface = Surface(*(packed(now[Layer(name)]) for name in Surface._fields))
        reaching = [k for k in range(len(light.beams)) if light.on_object[k] > 0]
        smooth = smooth_normal(surface.normal, now)
        even = surface._replace(normal=smooth)
        left = self._visibilities(even, view, prepared, light, reaching)
        if smooth is not surface.normal:
            turned = smooth @ light.towards[reaching].astype(np.float32).T
            left[0] *= share_above_surface(surface.normal, smooth)
            left[1:] *= np.moveaxis(turned, -1, 0) > 0
        if not now.extent(Layer.OCCLUSION).empty:
            left[0] = np.minimum(left[0], now[Layer.OCCLUSION])
        return self.shaded(surface, left[0], left[1:], reaching, light, view, now)

    def _visibilities(
        self,
        surface: Surface,
        view: View,
        prepared: Prepared,
        light: FrameLight,
        reaching: Sequence[int],
    ) -> ndarray:
        """(1 + k, h, w) float32: shares of the soft light, and of the lights `reaching`, that
        the object leaves itself."""
        seen = surface.coverage, surface.normal, surface.position
        region, soft = prepared.region, prepared.visibility
        anchor_from_world = view.scene.world_from_anchor.inverse()
        out = np.ones((1 + len(reaching), *surface.coverage.shape), np.float32)
        strength, memo = np.float32(self.params.self_shadow), view.memo.of_light
        if strength <= 0:
            return out
        if self._soft_occluded and soft is None:
            plane = region.rays, region.soft
            out[0] = visible_fraction_by_rays(
                seen, *plane, anchor_from_world, light.shape
            )
        elif soft is not None:
            key = "object", light.shape
            nodes = memo.get(key, partial(soft.under, light.shape), "soft")
            out[0] = visible_fraction(
                seen, soft, nodes, anchor_from_world, light.shape
            )
        for visible, k in zip(out[1:], reaching, strict=True):
            beam, caster = light.beams[k], region.caster
            if view.level == "reference":
                eye = view.pose.inverse().translation_m
                rays = region.rays.triangles, caster, beam
                visible[:] = visibility_by_rays(*seen, *rays, anchor_from_world, eye)
            else:
                depths = memo.get(("depth", beam), partial(depth_map, caster, beam))
                visible[:] = visibility_by_map(*seen, depths, anchor_from_world)
        return out if strength == 1 else 1 + strength * (out - 1)

    @property
    def _soft_occluded(self) -> bool:
        return self.soft and self.params.self_shadow > 0 and not self.hard

    def shaded(
        self,
        surface: Surface,
        soft_visibility: ndarray,
        visibility: ndarray,
        reaching: Sequence[int],
        light: FrameLight,
        view: View,
        now: Layers,
    ) -> ndarray:
        """VIRTUAL. soft_visibility (h, w), visibility (k, h, w) : of the soft light and of
        each of the lights `reaching`, past
        the object;  now : the layers of the surface's rectangle, for its coats"""
        f32 = np.float32
        rgb = (light.rgb * light.on_object[:, None])[reaching].astype(f32)
        widths = highlight_width(light.sizes_deg[reaching])
        towards = light.towards[reaching].astype(f32)
        lights = Lights(towards, rgb, widths, visibility, soft_visibility)
        soft_share = f32(self.soft)
        soft = soft_share * harmonic_terms(light.soft, light.ambient)
        environment = frame_environment(view.facts, view.scene, view.light)
        eye = view.pose.inverse().translation_m.astype(f32)
        bias = np.array(view.facts.bias_rgb, f32)
        mirrored = environment, soft_share, split_sum()
        out = shade(surface, eye, lights, soft, *mirrored, bias)
        if not now.extent(Layer.SHEEN).empty:
            add_sheen(out, surface, packed(now[Layer.SHEEN]), eye, lights, soft, bias)
        if not now.extent(Layer.COAT).empty:
            even = surface._replace(normal=smooth_normal(surface.normal, now))
            coat = packed(now[Layer.COAT])
            add_clear_coat(out, even, coat, eye, lights, *mirrored, bias)
        return out

    def _shadow(self, view: View, prepared: Prepared, light: FrameLight) -> Pixels:
        scene = view.scene
        anchor_from_camera = (view.pose @ scene.world_from_anchor).inverse()
        strength = self.params.shadow_strength * prepared.region.caster.opacity
        if (
            anchor_from_camera.translation_m[2] <= 0
            or strength * darkest(light, scene) <= self._shows_from
        ):
            return Pixels(view.out, neutral(Layer.SHADOW, view.out))
        memo = view.memo.of_light

        def textures(
            key: Beam | tuple[float, ...],
            make: Callable[[], Iterable[PlaneTexture]],
            kind: str = "",
        ) -> list[PlaneTexture]:
            """Kept by what casts the shadow, within the surface."""
            kept: list[PlaneTexture] = memo.get(
                ("plane", key), lambda: within_surface(make(), scene.surface_m), kind
            )
            return kept

        shape, caster = light.shape, prepared.region.caster
        level = PLANE_LEVELS[view.level]
        soft = textures(
            shape, lambda: (under_light(p, shape) for p in prepared.soft), "soft"
        )
        ambient = np.float32(self.soft) * light.ambient_fraction
        lamps: list[PlaneTexture] = []
        weights = [ambient] * len(soft)
        for beam, fraction in zip(light.beams, light.direct_fractions, strict=True):
            if beam.direction[2] > 0 and fraction.max() > 0:
                make = partial(beam_textures, caster, beam, level)
                lamps += (found := textures(beam, make))
                weights += [fraction] * len(found)
        real = view.facts.plane_shadow
        blocked = (
            None
            if real is None
            else plane_shadow_texture(real, light.ambient_fraction)
        )
        seen = PlaneView(view.out, prepared.grid, anchor_from_camera)
        shares = np.reshape(weights, (-1, 3))
        ratio = shadow_ratio(
            seen, soft, lamps, shares, ambient, blocked, self.faint, strength
        )
        return Pixels(view.out, ratio)

    def _shadow_rect(
        self, facts: FrameFacts, scene: Scene, frame: Rect, light: FrameLight
    ) -> tuple[Rect, str]:
        """Pixels in which the shadow may show, and why those or none."""
        region, least = shadow_region(scene), self._shows_from
        eye = scene.world_from_anchor.inverse().apply(
            facts.pose.inverse().translation_m
        )
        if eye[2] <= 0:
            return EMPTY, "no shadow: plane seen from behind"
        most = (
            self.params.shadow_strength
            * region.caster.opacity
            * darkest(light, scene)
        )
        light_of_plane = "% of the plane's light"
        if most <= least:
            return (
                EMPTY,
                f"no shadow: the object takes at most {100 * most:.1f} {light_of_plane}",
            )
        fractions = light.direct_fractions.max(1)
        beams = tuple(
            beam
            for beam, fraction in zip(light.beams, fractions, strict=True)
            if fraction > self.faint and beam.direction[2] > 0
        )
        soft = float(light.ambient_fraction.max()) * unevenness(light)
        # so that frames of a like light share an outline
        steps = max(np.ceil(soft * _SOFT_STEPS), 1)
        outline = region.outline_m(least * _SOFT_STEPS / steps, beams)
        if not len(outline):
            part = f"{100 * least:.1f} {light_of_plane}"
            return EMPTY, f"no shadow: nowhere does the object take {part}"
        rect = plane_rect(outline, facts, scene).clip(frame)
        if scene.surface_m is not None:
            x0, y0, x1, y1 = scene.surface_m
            corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            rect = rect.clip(plane_rect(corners, facts, scene))
        if rect.empty:
            return rect, "shadow out of view"
        return rect, f"shadow takes up to {100 * most:.0f} {light_of_plane}"

    @property
    def _shows_from(self) -> float:
        """The least darkening of which, faded, half a grey level remains."""
        return _SHOWS_FAINTS * self.faint

    def _light(self, facts: FrameFacts, scene: Scene) -> FrameLight:
        return frame_light(
            scene.light_of(facts),
            scene.world_from_anchor,
            self.hard,
            self.params.plane_blocks,
        )
