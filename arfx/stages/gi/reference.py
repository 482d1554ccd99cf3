"""Level `reference`: Monte Carlo rays (embree) on the same scenes, two bounces; shares no kernel with the cones.

Object pixels: cosine-weighted rays for diffuse light, microfacet normals (GGX) for gloss. Plane pixels: cosine-weighted
rays; only those that meet the object count, as what it sends less what it hides. Bright parts of the environment and what
glows are sampled as well (reference_sampling.py). Random numbers are keyed by pixel, sample and dimension, so that a part of
the picture gets the same as the whole. Not denoised: the error of a plane pixel falls with the root of the samples.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import View
from arfx.stages.gi.frame_light import surroundings_of
from arfx.stages.gi.plane_pixels import DARKEST, depth_agreement, measured
from arfx.stages.gi.real_planes import bounding_ball
from arfx.stages.gi.reference_sampling import Gloss, Lights, Sampler, balance_weight, cosine_directions, in_frame_of
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings
from arfx.stages.gi.surroundings import Planes

BOUNCES = 2
LEAST_LEFT = 0.05  # of a plane's light, beside other planes
Reflectance = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
_BATCH = 1 << 17  # pixels at once: bounds memory


class Tracer:
    """Radiance along rays. light : WORLD axes, taken into the anchor's"""

    def __init__(self, rays: RayScene, surroundings: Surroundings, light: Light, scene: Scene) -> None:
        self.rays, self.surroundings, self.sampled = rays, surroundings, Lights(rays, surroundings)
        turn = scene.world_from_anchor.rotation
        self.lights = [(turn.T @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights]
        self.plane_light = [light.radiance(turn @ axes[3]) for axes in surroundings.axes]

    def along(
        self, origins: np.ndarray, directions: np.ndarray, draw: Sampler, bounces: int, density: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3) radiance that comes from `directions`. density (n,) : with which they were drawn, where lights are
        sampled as well; None = they are not"""
        hit = self.rays.first(origins, directions)
        plane, distance = self.surroundings.first_plane(origins, directions)
        on_object = hit.met & (hit.distance < distance)
        on_plane = (plane >= 0) & ~on_object
        out = np.zeros((len(origins), 3))
        sky = ~on_object & ~on_plane
        out[sky] = self.sampled.environment(directions, density, sky)
        rows = np.flatnonzero(on_object)
        if len(rows):
            met = hit.of(rows)
            glow = balance_weight(density, rows, self.sampled.emitter_density(met, directions[rows]))
            out[rows] = self.outgoing_radiance(met, -directions[rows], draw.of(rows), bounces, glow)
        rows = np.flatnonzero(on_plane)
        if len(rows):
            positions = origins[rows] + distance[rows, None] * directions[rows]
            shadow_ratio = self.shadow_ratio(positions, plane[rows], draw.of(rows), bounces)
            out[rows] = self.surroundings.picture(positions, plane[rows]) * shadow_ratio
        return out

    def sampled_lights(self, start: np.ndarray, draw: Sampler, value: Reflectance, change: bool = False) -> np.ndarray:
        """(n, 3) light that samples of lights bring to positions (n, 3), weighed against the surface's own directions.

        value : reflectance times cosine (n, 3) or (n, 1), and the surface's density (n,), of unit directions (n, 3)
        change : with the object less without it, instead of with it"""
        out = np.zeros((len(start), 3))
        if self.sampled.bright:
            d, density = self.sampled.to_environment(len(start), draw)
            reflected, own = value(d)
            rows = np.flatnonzero(own > 0)
            plane, _ = self.surroundings.first_plane(start[rows], d[rows])
            hidden = self.rays.blocked(start[rows], d[rows])
            rows = rows[(plane < 0) & (hidden == change)]
            light = self.surroundings.environment(d[rows]) * (-1.0 if change else 1.0)
            out[rows] += light * reflected[rows] / (density + own)[rows, None]
        if self.sampled.glows:
            d, distance = self.sampled.to_emitters(start, draw)
            reflected, own = value(d)
            rows = np.flatnonzero(own > 0)
            plane, beyond = self.surroundings.first_plane(start[rows], d[rows])
            hit = self.rays.first(start[rows], d[rows])
            ok = (hit.distance > distance[rows] * (1 - 1e-3)) & hit.met & (beyond > distance[rows])
            rows, hit = rows[ok], hit.of(np.flatnonzero(ok))
            density = self.sampled.emitter_density(hit, d[rows])
            rows, hit, density = rows[density > 0], hit.of(np.flatnonzero(density > 0)), density[density > 0]
            out[rows] += hit.emission * reflected[rows] / (density + own[rows])[:, None]
        return out

    def outgoing_radiance(
        self, hit: Hit, towards: np.ndarray, draw: Sampler, bounces: int, glow: np.ndarray | float = 1.0
    ) -> np.ndarray:
        """(n, 3) that the object's surface sends `towards` a direction: emission, direct light, and one more bounce.

        glow : share (n, 1) of its emission that counts"""
        normal = np.where(((hit.normal * towards).sum(1) < 0)[:, None], -hit.normal, hit.normal)
        start = hit.position + self.rays.lift * normal
        arriving = self.direct(start, normal, draw)
        if bounces > 0:
            d = cosine_directions(normal, draw)
            arriving = arriving + self.along(start, d, draw, bounces - 1, cosine_density(normal, d))
            arriving = arriving + self.sampled_lights(start, draw, lambertian(normal))
        else:
            arriving = arriving + self.surroundings.unoccluded_irradiance(normal)
        out = glow * hit.emission + hit.diffuse * arriving
        if bounces > 0 and hit.specular.any():
            d = 2 * (normal * towards).sum(1, keepdims=True) * normal - towards
            out = out + hit.specular * self.along(start, d, draw, bounces - 1)
        elif hit.specular.any():
            out = out + hit.specular * self.surroundings.unoccluded_irradiance(normal)
        return out

    def direct(self, points: np.ndarray, normals: np.ndarray, draw: Sampler) -> np.ndarray:
        """(n, 3) of white surfaces, by one ray to each light's disc."""
        out = np.zeros((len(points), 3))
        for d, rgb, size_deg in self.lights:
            towards = _in_disc(d, size_deg, draw)
            facing = np.clip((normals * towards).sum(1), 0, None)
            rows = np.flatnonzero(facing > 0)
            if len(rows):
                plane, _ = self.surroundings.first_plane(points[rows], towards[rows])
                visible = ~self.rays.blocked(points[rows], towards[rows]) & (plane < 0)
                out[rows] += (facing[rows] * visible)[:, None] * rgb
        return out

    def shadow_ratio(self, positions: np.ndarray, plane: np.ndarray, draw: Sampler, bounces: int) -> np.ndarray:
        """(n, 3) share of a plane's light that is there with the object: what the picture on it is multiplied by."""
        normals = self.surroundings.axes[plane, 3]
        start = positions + self.rays.lift * normals
        plane_light = np.array(self.plane_light)[plane]
        hidden_light = np.zeros((len(positions), 3))
        for d, rgb, size_deg in self.lights:
            towards = _in_disc(d, size_deg, draw)
            rows = np.flatnonzero(normals @ d > 0)
            if len(rows):
                hidden_light[rows] += ((normals[rows] @ d) * self.rays.blocked(start[rows], towards[rows]))[:, None] * rgb
        return np.asarray(1 + divide(self.change(start, normals, draw, bounces) - hidden_light, plane_light))

    def change(self, start: np.ndarray, normals: np.ndarray, draw: Sampler, bounces: int) -> np.ndarray:
        """(n, 3) indirect light of a white plane with the object less without it, by one ray."""
        d = cosine_directions(normals, draw)
        sampled_lights = self.sampled_lights(start, draw, lambertian(normals), change=True)
        return sampled_lights + self.change_along(start, d, draw, bounces, cosine_density(normals, d))

    def from_other_planes(self, start: np.ndarray, normals: np.ndarray, draw: Sampler) -> np.ndarray:
        """(n, 3) light of a white plane that other planes give it less what they hide, without the object, by one ray."""
        out = np.zeros((len(start), 3))
        if len(self.surroundings.axes) > 1:
            d = cosine_directions(normals, draw)
            plane, distance = self.surroundings.first_plane(start, d)
            rows = np.flatnonzero(plane >= 0)
            positions = start[rows] + distance[rows, None] * d[rows]
            out[rows] = self.surroundings.picture(positions, plane[rows]) - self.surroundings.environment(d[rows])
        return out

    def change_along(
        self, start: np.ndarray, d: np.ndarray, draw: Sampler, bounces: int, density: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3) radiance from directions d with the object less without it. density : as for `along`"""
        hit = self.rays.first(start, d)
        out = np.zeros((len(start), 3))
        rows = np.flatnonzero(hit.met)
        if len(rows):
            plane, distance = self.surroundings.first_plane(start[rows], d[rows])
            nearer = hit.distance[rows] < distance
            rows, plane, distance = rows[nearer], plane[nearer], distance[nearer]
        if len(rows):
            background = self.sampled.environment(d, density, rows)
            other = np.flatnonzero(plane >= 0)
            positions = start[rows[other]] + distance[other, None] * d[rows[other]]
            background[other] = self.surroundings.picture(positions, plane[other])
            # the last bounce takes the light that nothing hides, instead of none: nearer the truth than a black object
            met = hit.of(rows)
            glow = balance_weight(density, rows, self.sampled.emitter_density(met, d[rows]))
            sent = self.outgoing_radiance(met, -d[rows], draw.of(rows), max(bounces - 1, 0), glow)
            out[rows] = sent - background
        if bounces > 0 and len(self.surroundings.axes) > 1:  # rays that pass the object meet planes that it changes
            plane, distance = self.surroundings.first_plane(start, d)
            rows = np.flatnonzero((plane >= 0) & ~(hit.distance < distance))
            if len(rows):
                positions = start[rows] + distance[rows, None] * d[rows]
                shadow_ratio = self.shadow_ratio(positions, plane[rows], draw.of(rows), 0)
                out[rows] += self.surroundings.picture(positions, plane[rows]) * (shadow_ratio - 1)
        return out


def trace_frame(
    view: View, planes: Planes, visible_rect: Rect, disc: Rect, samples: int, strength: float,
    gloss: tuple[float, float], mirror: Rect,
) -> Mapping[Layer, np.ndarray]:  # fmt: skip
    """VIRTUAL and SHADOW with indirect light. visible_rect : pixels of the picture that are looked at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness;  mirror : pixels that can mirror the object"""
    now, scene, facts, light, pose, seed = view.layers, view.scene, view.facts, view.light, view.pose, view.key
    rays = RayScene(scene)
    _, cube = surroundings_of(facts, scene, light)
    surroundings = Surroundings(now, visible_rect, scene, facts, cube, planes, bounding_ball(scene)[1])
    tracer = Tracer(rays, surroundings, light, scene)
    anchor = scene.world_from_anchor.inverse()
    eye = anchor.apply(pose.inverse().translation_m)
    rect = now.rect
    x, y = np.meshgrid(np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1))
    key = (y.astype(np.uint32) * np.uint32(65521) + x.astype(np.uint32)) * np.uint32(2654435761)
    virtual, shadow = now[Layer.VIRTUAL].copy(), now[Layer.SHADOW].copy()
    lengths = np.linalg.norm(now[Layer.NORMAL], axis=-1)
    requested = np.zeros((rect.height, rect.width), bool)
    requested[view.out.clip(rect).slices_in(rect)] = True
    for rows in _batches(np.argwhere((now[Layer.COVERAGE] > 0) & (lengths > 1e-3) & requested)):
        at = rows[:, 0], rows[:, 1]
        normals = normalise(now[Layer.NORMAL][at].astype(float)) @ anchor.rotation.T
        positions = anchor.apply(now[Layer.POSITION][at].astype(float))
        indirect = _object_light(
            tracer, positions, normals, normalise(eye - positions), now[Layer.ALBEDO][at].astype(float),
            now[Layer.MATERIAL][at].astype(float), key[at], samples, seed,
        )  # fmt: skip
        virtual[at] += (indirect * now[Layer.COVERAGE][at][:, None]).astype(np.float32)
    real = measured(now[Layer.REAL_DEPTH])
    if not disc.union(mirror).clip(rect).empty and strength > 0:
        wanted, glossy = np.zeros(shadow.shape[:2], bool), np.zeros(shadow.shape[:2], bool)
        for inside, mask in ((disc.clip(rect), wanted), (mirror.clip(rect), glossy)):
            if not inside.empty:
                mask[inside.slices_in(rect)] = True
        directions = scene.camera.directions(np.stack([x, y], -1).astype(float)) @ (anchor.rotation @ pose.rotation.T).T
        for rows in _batches(np.argwhere((wanted | glossy) & requested & np.isfinite(directions).all(-1))):
            at = rows[:, 0], rows[:, 1]
            d = normalise(directions[at])
            plane, distance = surroundings.first_plane(np.broadcast_to(eye, d.shape), d)
            keep = np.flatnonzero(plane >= 0)
            at = at[0][keep], at[1][keep]
            n = surroundings.axes[plane[keep], 3]
            start = eye + distance[keep, None] * d[keep] + rays.lift * n
            changed, shiny = np.flatnonzero(wanted[at]), np.flatnonzero(glossy[at])
            total, mirrored, others = (np.zeros((len(keep), 3)) for _ in range(3))
            for s in range(samples):
                surface = start[changed], n[changed]
                total[changed] += tracer.change(*surface, Sampler(key[at][changed], s, samples, seed), BOUNCES)
                others[changed] += tracer.from_other_planes(*surface, Sampler(key[at][changed], s, samples, seed))
                if len(shiny):
                    draw = Sampler(key[at][shiny], s, samples, seed ^ 0x27D4EB2F)
                    towards = -d[keep][shiny]
                    lobes = Gloss(n[shiny], towards, np.full((len(shiny), 3), gloss[0]), gloss[1])
                    rows, lobe, weight, _ = lobes.directions(draw)
                    subset = shiny[rows]
                    mirrored[subset] += weight * tracer.change_along(start[subset], lobe, draw.of(rows), BOUNCES)
            alone = np.array(tracer.plane_light)[plane[keep]]
            plane_light = np.maximum(alone + others / samples, LEAST_LEFT * alone)
            change = divide(total / samples, plane_light) - (1 - shadow[at]) * (divide(alone, plane_light, where_zero=1.0) - 1)
            base = np.maximum(now[Layer.PLATE][at] - np.array(facts.bias_rgb), DARKEST)
            change += np.maximum(mirrored / samples, -base) / base
            if real.size:
                depth = distance[keep] * (d[keep] @ (anchor.rotation @ pose.rotation.T)[:, 2])
                change *= np.array([depth_agreement(real, j, i, z) for j, i, z in zip(*at, depth, strict=True)]).reshape(-1, 1)
            shadow[at] += (strength * change).astype(np.float32)
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.clip(shadow, 0, None)}


def _in_disc(d: np.ndarray, size_deg: float, draw: Sampler) -> np.ndarray:
    """(n, 3) unit directions to points of a light's disc around d (3,)."""
    u, v = draw.pair()
    r, phi = np.tan(np.radians(size_deg / 2)) * np.sqrt(u), 2 * np.pi * v
    return normalise(in_frame_of(np.broadcast_to(d, (len(u), 3)), r * np.cos(phi), r * np.sin(phi), np.ones(len(u))))


def cosine_density(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) per steradian of `cosine_directions`."""
    return np.asarray(np.clip((normals * directions).sum(1), 0, None) / np.pi)


def lambertian(normals: np.ndarray) -> Reflectance:
    """What `Tracer.found` asks of a white diffuse surface: cosine over pi, both times."""

    def value(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = cosine_density(normals, directions)
        return density[:, None], density

    return value


def _object_light(
    tracer: Tracer, positions: np.ndarray, n: np.ndarray, v: np.ndarray, albedo: np.ndarray, material: np.ndarray,
    key: np.ndarray, samples: int, seed: int,
) -> np.ndarray:  # fmt: skip
    """(k, 3) indirect light that surfaces send along v (k, 3)."""
    start = positions + tracer.rays.lift * n
    metal = material[:, :1]
    f0 = 0.08 * material[:, 2:3] * (1 - metal) + albedo * metal
    shiny = f0.max(1) > 0
    diffuse_albedo = albedo * (1 - metal)
    matte, lobes = np.flatnonzero(diffuse_albedo.max(1) > 0), np.flatnonzero(shiny)
    gloss = Gloss(n[lobes], v[lobes], f0[lobes], material[lobes, 1])
    total = np.zeros_like(positions)

    def diffuse_fraction(d: np.ndarray) -> np.ndarray:
        """Of what arrives along d, reflected by what lies under the gloss."""
        half = normalise(d + v[matte])
        fresnel = f0[matte] + (1 - f0[matte]) * (1 - np.clip((half * v[matte]).sum(1, keepdims=True), 0, 1)) ** 5
        return np.asarray(diffuse_albedo[matte] * (1 - np.where(shiny[matte][:, None], fresnel, 0)))

    def diffuse_value(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = cosine_density(n[matte], d)
        return diffuse_fraction(d) * density[:, None], density

    for s in range(samples):
        if len(matte):
            draw = Sampler(key[matte], s, samples, seed)
            d = cosine_directions(n[matte], draw)
            incoming = tracer.along(start[matte], d, draw.of(np.arange(len(matte))), BOUNCES, cosine_density(n[matte], d))
            total[matte] += diffuse_fraction(d) * incoming + tracer.sampled_lights(start[matte], draw, diffuse_value)
        if len(lobes):
            draw = Sampler(key[lobes], s, samples, seed ^ 0x5BD1E995)
            subset, d, weight, density = gloss.directions(draw)
            total[lobes[subset]] += weight * tracer.along(start[lobes[subset]], d, draw.of(subset), BOUNCES, density)
            total[lobes] += tracer.sampled_lights(start[lobes], draw, lambda d: gloss.at(np.arange(len(lobes)), d))
    return total / samples


def _batches(rows: np.ndarray) -> Iterator[np.ndarray]:
    for a in range(0, len(rows), _BATCH):
        yield rows[a : a + _BATCH]
