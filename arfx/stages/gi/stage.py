"""Gi: indirect light between the object, its surroundings and the real planes.

Occlusion, colour bleeding and reflections of the picture on the object, and what the object
adds to and takes from the planes, as a ratio. It replaces lightmap's soft light.

Rays say once a clip what each place gets from each other (`light.transport`); a light is a
few sparse products, a frame what the picture on the planes adds to them, look-ups, and a
ray for pixels that mirror the object in itself. `reference` traces paths (embree) and
shares nothing of that with the others.
Source: docs/methods/gi.md. Cost: O(covered pixels + pixels of the planes that change).
Leaves out: real things that are no
plane, caustics, refraction, light that the object sends through its own transparent parts.
"""

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, packed
from arfx.core.memo import memo_of
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, Settings, setting
from arfx.core.stage import Check, Demand, JobView, Stage, View
from arfx.stages.gi.background import behind_object
from arfx.stages.gi.gloss import gloss_weights, mirror_tangent
from arfx.stages.gi.health import furnace, seams
from arfx.stages.gi.incoming import (
    IncomingLight,
    in_steps,
    incoming_light,
    mean_in_steps,
    sky_radiance,
)
from arfx.stages.gi.plane_change import (
    DARKEST,
    add_change,
    change_textures,
    seen_places,
    visible_radius_m,
)
from arfx.stages.gi.reference import trace_frame
from arfx.stages.gi.reflections import Sight, reflected_light
from arfx.stages.light.bumps import share_above_surface, smooth_normal
from arfx.stages.light.plane_lookup import PlaneTexture
from arfx.stages.light.plane_shadow import PLANE_LEVELS, soft_pictures
from arfx.stages.light.planes import (
    SHOWS,
    disc_radius_m,
    disc_rect,
    mirror_rect,
    planes_of,
)
from arfx.stages.light.region import shadow_region
from arfx.stages.light.transport import Transport, TransportLevel
from arfx.stages.lightmap.shading import Surface
from arfx.stages.viewing import direction_grid

TRANSPORTS_KEPT = 1  # of a model: one level on its planes
PLANE_ROUGHNESS = 0.1  # of a plane's reflection, 0 = a mirror


@dataclass(frozen=True)
class GiLevel:
    """shows : share of a white surface's light from which on a pixel mirrors its surroundings;
    one that mirrors less shows the light that falls on it instead
    picture : texels a side of the picture on a plane"""

    transport: TransportLevel
    shows: float
    picture: int


# times that the light in steps is as bright as it is, at most: near 0 its steps are larger
_STEPS_MOST = 1.25
LEVELS = {
    "draft": GiLevel(TransportLevel(6000, 48, 32, 32, 3), 0.5, 64),
    "standard": GiLevel(TransportLevel(24_000, 96, 64, 64, 8), SHOWS, 128),
}


class GiParams(Settings):
    formula: str = setting(
        "corrected", "corrected, or paper: Yao, Tao, Wu 2018 as printed"
    )
    strength: Fraction = setting(
        1.0,
        "strength of the indirect light on the real planes: 0 = none, 1 = as computed",
    )
    plane_gloss: Fraction = setting(
        0.0,
        "fraction of light that the real plane reflects like a mirror, seen from above: 0 ="
        " matt, .04 = varnish or glass",
    )
    samples: int = setting(
        64,
        "paths per pixel at level reference: noise falls with their root, best at powers of"
        " two",
        ge=1,
        le=65536,
    )


@dataclass(frozen=True, eq=False)
class Prepared:
    """Of one clip, worker and level. grid : viewing directions;  soft : pictures of the
    first plane that add up"""

    grid: ndarray
    transport: Transport
    soft: tuple[PlaneTexture, ...]


@dataclass(frozen=True, eq=False)
class LitScene:
    """What is kept while the light stays within a step.

    left : of `Indirect`;  changes : of `change_textures`;  radius_m : within which they show
    received, sent (z, y, x, 3) : nodes of what falls on the object, and of what it sends
    mean (3,), sky (6 SKY^2, 3) : radiance of planes and sky, for which they are
    times (3,) : as bright as `received` the frame's light is"""

    left: ndarray
    changes: list[list[PlaneTexture]]
    radius_m: float
    received: ndarray
    sent: ndarray
    mean: ndarray
    sky: ndarray
    times: ndarray


class Gi(Stage):
    name = "gi"
    levels: ClassVar[tuple[str, ...]] = ("draft", "standard", "reference")
    facts = frozenset({"pose", "light", "environment", "depth"})
    Params = GiParams
    terms = ("frames", "mpx", "object_mpx", "lamps", "new_lights")

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        model = facts.raster_box.clip(frame)
        disc, why = self._disc(facts, scene, frame)
        mirror = self._mirror_rect(facts, scene)
        if model.empty and disc.empty and mirror.empty:
            return Demand(EMPTY, f"model out of view; {why}")
        if not mirror.empty:
            why += f", and mirrors {self.params.plane_gloss:g} of the light"
        seen = "model" if not model.empty else "no model"
        return Demand(model.union(disc).union(mirror), f"{seen} in view; {why}")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """The picture that the object reflects lies on the planes around it; a pixel's
        neighbours say how it bends.
        """
        return out.pad(1).union(_reflected_rect(facts, scene)).clip(scene.camera.rect)

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """What bounces is made for each light and its surroundings, both rounded."""
        if facts.light is None:
            return {"new_lights": None}
        known = in_steps(facts, facts.light)
        around = known.seen_environment, known.environment
        return {"new_lights": (repr(known.light), *around)}

    def health(self, job: JobView) -> Iterable[Check]:
        return chain(seams(job), furnace(job))

    def prepare(self, scene: Scene, level: str) -> Prepared | None:
        if level == "reference":
            return None
        planes, region = planes_of(scene), shadow_region(scene)

        def make() -> tuple[Transport, tuple[PlaneTexture, ...]]:
            middle, half = planes.axes[0, 0, :2].astype(float), planes.half_m
            box = middle - half, middle + half
            soft = soft_pictures(region.caster, *box, PLANE_LEVELS["standard"])
            return Transport(
                scene, planes, region.rays, LEVELS[level].transport
            ), soft

        key = (scene.placed_by, *planes.key, level)
        transport, soft = memo_of(scene.model).get(
            key, make, "transport", TRANSPORTS_KEPT
        )
        return Prepared(direction_grid(scene.camera), transport, soft)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray | Pixels]:
        facts, scene, frame = view.facts, view.scene, view.scene.camera.rect
        disc, _ = self._disc(facts, scene, frame)
        mirror, seen = self._mirror_rect(facts, scene), _reflected_rect(facts, scene)
        if view.level == "reference":
            gloss = self.params.plane_gloss, PLANE_ROUGHNESS
            options = self.params.samples, self.params.strength, gloss, mirror
            return trace_frame(view, planes_of(scene), seen, disc, *options)
        side = LEVELS[view.level].picture
        incoming = incoming_light(view, seen, prepared.transport.planes, side)
        lit = self._lit(view, prepared, incoming)
        anchor = scene.world_from_anchor.inverse()
        # light without a direction, and no radiance that is mirrored is greater
        soft = view.light.soft_radiance(scene.world_from_anchor.rotation[:, 2]).min()
        mirrored = incoming.environment.texels, incoming.picture, lit.sent
        brightest = max(radiance.max() for radiance in mirrored)
        sight = Sight(
            anchor,
            anchor.apply(view.pose.inverse().translation_m),
            incoming.background(lit.left),
            prepared.transport,
            lit.sent,
            LEVELS[view.level].shows * float(divide(soft, brightest)),
        )
        virtual = self._virtual(view, incoming, lit, sight)
        if not disc.empty and lit.radius_m > 0:
            disc = disc_rect(scene, incoming.planes, lit.radius_m, view.pose, frame)
        else:
            disc = EMPTY
        shadow = self._shadow(view, prepared, lit, sight, disc, mirror)
        return {Layer.VIRTUAL: virtual, Layer.SHADOW: shadow}

    def _lit(
        self, view: View, prepared: Prepared, incoming: IncomingLight
    ) -> LitScene:
        """Kept by light, environment and mean of the planes in steps; the light's colour and
        brightness are those of the frame."""
        scene = view.scene
        known = in_steps(view.facts, view.light)
        light = scene.light_of(known)
        up = scene.world_from_anchor.rotation[:, 2]
        exact, stepped = (a.soft_radiance(up) for a in (view.light, light))
        times = divide(exact, stepped, where_zero=1.0)
        times = np.clip(times, 1 / _STEPS_MOST, _STEPS_MOST)
        mean = mean_in_steps(divide(incoming.mean, times))
        around = known.seen_environment, known.environment
        key = repr(light), *around, mean.tobytes()

        def make() -> LitScene:
            transport, planes = prepared.transport, incoming.planes
            sky = sky_radiance(known, scene, light)
            picture = np.broadcast_to(mean, transport.texels.shape)
            indirect = transport.solve(scene, light, picture, sky)
            changes = change_textures(
                indirect, transport.hidden, planes, prepared.soft
            )
            positions = transport.texels.reshape(*transport.hidden.shape, 3)
            radius_m = visible_radius_m(indirect, planes, positions)
            received, sent = map(
                transport.grid.nodes, (indirect.received, indirect.sent)
            )
            of_planes = indirect.left, changes, radius_m
            return LitScene(*of_planes, received, sent, mean, sky, times)

        kept: LitScene = view.memo.of_light.get(key, make)
        sent, mean, sky = (
            a * times.astype(a.dtype) for a in (kept.sent, kept.mean, kept.sky)
        )
        return replace(kept, sent=sent, mean=mean, sky=sky, times=times)

    def _virtual(
        self,
        view: View,
        incoming: IncomingLight,
        lit: LitScene,
        sight: Sight,
    ) -> Pixels:
        now, model = view.layers, view.facts.raster_box
        part = now.extent(Layer.VIRTUAL).union(model).clip(view.out)
        out = now.crop(part)[Layer.VIRTUAL].copy()
        box = model.clip(view.out).pad(1).clip(model).clip(now.rect)
        if box.empty:
            return Pixels(part, out)
        here, transport = now.crop(box), sight.transport
        surface = Surface(*(packed(here[Layer(name)]) for name in Surface._fields))
        left, sky = lit.left, sky_radiance(view.facts, view.scene, view.light)
        change = incoming.change(lit.mean, left)
        more = transport.more_from_around(change, sky - lit.sky)
        nodes = lit.received + transport.grid.nodes(more / lit.times)
        layers = surface.coverage, surface.normal, surface.position
        light = transport.grid.read(nodes, *layers, sight.anchor_from_world)
        light *= lit.times.astype(np.float32)
        smooth = smooth_normal(surface.normal, here)
        if smooth is not surface.normal:
            light *= share_above_surface(surface.normal, smooth)[..., None]
        added, both = reflected_light(surface, light, sight), box.clip(part)
        out[both.slices_in(part)] += added[both.slices_in(box)]
        return Pixels(part, out)

    def _shadow(
        self,
        view: View,
        prepared: Prepared,
        lit: LitScene,
        sight: Sight,
        disc: Rect,
        mirror: Rect,
    ) -> Pixels:
        now, scene = view.layers, view.scene
        part = now.extent(Layer.SHADOW).union(disc).union(mirror).clip(view.out)
        shadow = now.crop(part)[Layer.SHADOW].copy()
        anchor_from_camera = (view.pose @ scene.world_from_anchor).inverse()
        changed, strength = disc.clip(part), self.params.strength
        if not changed.empty:
            add_change(
                shadow[changed.slices_in(part)],
                now.crop(changed),
                prepared.grid,
                anchor_from_camera,
                sight.transport.planes,
                lit.changes,
                strength,
            )
        mirror = mirror.clip(part)
        if not mirror.empty:
            self._mirror(
                shadow[mirror.slices_in(part)], view, prepared, sight, mirror
            )
        return Pixels(part, shadow)

    def _mirror(
        self,
        shadow: ndarray,
        view: View,
        prepared: Prepared,
        sight: Sight,
        rect: Rect,
    ) -> None:
        """The planes' mirror image of the object, less what it hides of theirs, as a share
        of the pixel.
        """
        layers, gloss = view.layers.crop(rect), self.params.plane_gloss
        light = layers[Layer.PLATE] - np.array(view.facts.bias_rgb, np.float32)
        planes, lift_m = sight.transport.planes, sight.transport.rays.lift_m
        for k, rows, shown, d, places in seen_places(
            view, layers, prepared.grid, planes
        ):
            normal = planes.axes[k, 3].astype(float)
            along = d @ normal
            a, b = gloss_weights(PLANE_ROUGHNESS, -along)
            weight = self.params.strength * (gloss * a + b) * shown
            towards = d - 2 * along[:, None] * normal
            met, sent = sight.of_object(places + lift_m * normal, towards)
            rough = np.full(len(met), PLANE_ROUGHNESS)
            behind = behind_object(sight.background, places[met], towards[met], rough)
            here = rows[0][met], rows[1][met]
            change = weight[met, None] * (sent - behind)
            change /= np.maximum(light[here], DARKEST)
            shadow[here] = np.clip(shadow[here] + change, 0, None)

    def _mirror_rect(self, facts: FrameFacts, scene: Scene) -> Rect:
        """Pixels in which glossy planes can mirror the object."""
        if self.params.plane_gloss <= 0 or self.params.strength <= 0:
            return EMPTY
        tangent, frame = float(mirror_tangent(PLANE_ROUGHNESS)), scene.camera.rect
        return mirror_rect(scene, planes_of(scene), tangent, facts.pose, frame)

    def _disc(self, facts: FrameFacts, scene: Scene, frame: Rect) -> tuple[Rect, str]:
        """Pixels of the real planes that may change, and why those or none."""
        if self.params.strength <= 0:
            return EMPTY, "planes left alone"
        light, planes = scene.light_of(facts), planes_of(scene)
        up = scene.world_from_anchor.rotation[:, 2]
        soft, total = light.soft_radiance(up).max(), light.radiance(up).max()
        glow = max(max(p.material.emissive) for p in scene.model.parts)
        peak = float(soft) + sum(max(li.rgb) for li in light.lights) + glow
        if peak <= 0:
            return EMPTY, "no indirect light on the plane"
        radius = disc_radius_m(scene, planes, peak / max(float(total), 1e-3))
        rect = disc_rect(scene, planes, radius, facts.pose, frame)
        if rect.empty:
            return rect, "plane out of view or seen from behind"
        return (
            rect,
            f"plane changes by half a grey level within {100 * radius:.0f} cm",
        )


def _reflected_rect(facts: FrameFacts, scene: Scene) -> Rect:
    """Pixels of the picture that the object may reflect."""
    planes = planes_of(scene)
    return disc_rect(scene, planes, planes.half_m, facts.pose, scene.camera.rect)
