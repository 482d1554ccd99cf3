"""Level `reference`: Monte Carlo rays (embree) on the same scenes, two bounces; shares no kernel with the cones.

Object pixels: cosine-weighted rays for what is matt, microfacet normals (GGX) for gloss. Plane pixels: cosine-weighted
rays; only those that meet the object count, as what it sends less what it hides. Bright parts of the environment and what
glows are sampled as well (reference_sampling.py). Random numbers are keyed by pixel, sample and dimension, so that a part of
the picture gets the same as the whole. Not denoised: the error of a plane pixel falls with the root of the samples.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import View
from arfx.stages.gi.frame_light import environment_cube
from arfx.stages.gi.plane_pixels import DARKEST, agrees, measured
from arfx.stages.gi.real_planes import ball_of
from arfx.stages.gi.reference_sampling import Draw, Gloss, Lights, about, cosine_directions, shared
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings
from arfx.stages.gi.surroundings import Planes

BOUNCES = 2
LEAST_LEFT = 0.05  # of a plane's light, beside other planes
_BATCH = 1 << 17  # pixels at once: bounds memory


class Tracer:
    """Radiance along rays. light : WORLD axes, taken into the anchor's"""

    def __init__(self, rays: RayScene, around: Surroundings, light: Light, scene: Scene) -> None:
        self.rays, self.around, self.sampled = rays, around, Lights(rays, around)
        turn = scene.world_from_anchor.rotation
        self.lights = [(turn.T @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights]
        self.whole = [light.radiance(turn @ axes[3]) for axes in around.axes]

    def along(
        self, origins: np.ndarray, directions: np.ndarray, draw: Draw, bounces: int, density: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3) radiance that comes from `directions`. density (n,) : with which they were drawn by one who looks for lights
        as well; None = nobody does"""
        hit = self.rays.first(origins, directions)
        plane, distance = self.around.first_plane(origins, directions)
        on_object = hit.met & (hit.distance < distance)
        on_plane = (plane >= 0) & ~on_object
        out = np.zeros((len(origins), 3))
        sky = ~on_object & ~on_plane
        out[sky] = self.sampled.environment(directions, density, sky)
        rows = np.flatnonzero(on_object)
        if len(rows):
            met = hit.of(rows)
            glow = shared(density, rows, self.sampled.emitter_density(met, directions[rows]))
            out[rows] = self.leaves(met, -directions[rows], draw.of(rows), bounces, glow)
        rows = np.flatnonzero(on_plane)
        if len(rows):
            places = origins[rows] + distance[rows, None] * directions[rows]
            out[rows] = self.around.picture(places, plane[rows]) * self.left(places, plane[rows], draw.of(rows), bounces)
        return out

    def found(
        self, start: np.ndarray, draw: Draw, value: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], change: bool = False
    ) -> np.ndarray:
        """(n, 3) light that samples of lights bring to places (n, 3), weighed against the surface's own directions.

        value : share reflected times cosine (n, 3) or (n, 1), and the surface's density (n,), of unit directions (n, 3)
        change : with the object less without it, instead of with it
        """
        out = np.zeros((len(start), 3))
        if self.sampled.bright:
            d, density = self.sampled.to_environment(len(start), draw)
            reflected, own = value(d)
            rows = np.flatnonzero(own > 0)
            plane, _ = self.around.first_plane(start[rows], d[rows])
            hidden = self.rays.blocked(start[rows], d[rows])
            rows = rows[(plane < 0) & (hidden == change)]
            light = self.around.environment(d[rows]) * (-1.0 if change else 1.0)
            out[rows] += light * reflected[rows] / (density + own)[rows, None]
        if self.sampled.glows:
            d, distance = self.sampled.to_emitters(start, draw)
            reflected, own = value(d)
            rows = np.flatnonzero(own > 0)
            plane, beyond = self.around.first_plane(start[rows], d[rows])
            hit = self.rays.first(start[rows], d[rows])
            ok = (hit.distance > distance[rows] * (1 - 1e-3)) & hit.met & (beyond > distance[rows])
            rows, hit = rows[ok], hit.of(np.flatnonzero(ok))
            density = self.sampled.emitter_density(hit, d[rows])
            rows, hit, density = rows[density > 0], hit.of(np.flatnonzero(density > 0)), density[density > 0]
            out[rows] += hit.emission * reflected[rows] / (density + own[rows])[:, None]
        return out

    def leaves(self, hit: Hit, towards: np.ndarray, draw: Draw, bounces: int, glow: np.ndarray | float = 1.0) -> np.ndarray:
        """(n, 3) that the object's surface sends `towards` a direction: emission, direct light, and one more bounce.

        glow : share (n, 1) of its emission that counts
        """
        normal = np.where(((hit.normal * towards).sum(1) < 0)[:, None], -hit.normal, hit.normal)
        start = hit.place + self.rays.lift * normal
        arriving = self.direct(start, normal, draw)
        if bounces > 0:
            d = cosine_directions(normal, draw)
            arriving = arriving + self.along(start, d, draw, bounces - 1, matt_density(normal, d))
            arriving = arriving + self.found(start, draw, matt(normal))
        else:
            arriving = arriving + self.around.even(normal)
        out = glow * hit.emission + hit.matt * arriving
        if bounces > 0 and hit.mirrors.any():
            d = 2 * (normal * towards).sum(1, keepdims=True) * normal - towards
            out = out + hit.mirrors * self.along(start, d, draw, bounces - 1)
        elif hit.mirrors.any():
            out = out + hit.mirrors * self.around.even(normal)
        return out

    def direct(self, points: np.ndarray, normals: np.ndarray, draw: Draw) -> np.ndarray:
        """(n, 3) of white surfaces, by one ray to each light's disc."""
        out = np.zeros((len(points), 3))
        for d, rgb, size_deg in self.lights:
            towards = _in_disc(d, size_deg, draw)
            facing = np.clip((normals * towards).sum(1), 0, None)
            rows = np.flatnonzero(facing > 0)
            if len(rows):
                plane, _ = self.around.first_plane(points[rows], towards[rows])
                open_ = ~self.rays.blocked(points[rows], towards[rows]) & (plane < 0)
                out[rows] += (facing[rows] * open_)[:, None] * rgb
        return out

    def left(self, places: np.ndarray, plane: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) share of a plane's light that is there with the object: what the picture on it is multiplied by."""
        normals = self.around.axes[plane, 3]
        start = places + self.rays.lift * normals
        whole = np.array(self.whole)[plane]
        lost = np.zeros((len(places), 3))
        for d, rgb, size_deg in self.lights:
            towards = _in_disc(d, size_deg, draw)
            rows = np.flatnonzero(normals @ d > 0)
            if len(rows):
                lost[rows] += ((normals[rows] @ d) * self.rays.blocked(start[rows], towards[rows]))[:, None] * rgb
        return np.asarray(1 + divide(self.change(start, normals, draw, bounces) - lost, whole))

    def change(self, start: np.ndarray, normals: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) indirect light of a white plane with the object less without it, by one ray."""
        d = cosine_directions(normals, draw)
        found = self.found(start, draw, matt(normals), change=True)
        return found + self.change_along(start, d, draw, bounces, matt_density(normals, d))

    def by_others(self, start: np.ndarray, normals: np.ndarray, draw: Draw) -> np.ndarray:
        """(n, 3) light of a white plane that other planes give it less what they hide, without the object, by one ray."""
        out = np.zeros((len(start), 3))
        if len(self.around.axes) > 1:
            d = cosine_directions(normals, draw)
            plane, distance = self.around.first_plane(start, d)
            rows = np.flatnonzero(plane >= 0)
            places = start[rows] + distance[rows, None] * d[rows]
            out[rows] = self.around.picture(places, plane[rows]) - self.around.environment(d[rows])
        return out

    def change_along(
        self, start: np.ndarray, d: np.ndarray, draw: Draw, bounces: int, density: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, 3) radiance from directions d with the object less without it. density : as for `along`"""
        hit = self.rays.first(start, d)
        out = np.zeros((len(start), 3))
        rows = np.flatnonzero(hit.met)
        if len(rows):
            plane, distance = self.around.first_plane(start[rows], d[rows])
            nearer = hit.distance[rows] < distance
            rows, plane, distance = rows[nearer], plane[nearer], distance[nearer]
        if len(rows):
            behind = self.sampled.environment(d, density, rows)
            other = np.flatnonzero(plane >= 0)
            behind[other] = self.around.picture(start[rows[other]] + distance[other, None] * d[rows[other]], plane[other])
            # the last bounce takes the light that nothing hides, instead of none: nearer the truth than a black object
            met = hit.of(rows)
            glow = shared(density, rows, self.sampled.emitter_density(met, d[rows]))
            sent = self.leaves(met, -d[rows], draw.of(rows), max(bounces - 1, 0), glow)
            out[rows] = sent - behind
        if bounces > 0 and len(self.around.axes) > 1:  # rays that pass the object bring less or more from planes that it changes
            plane, distance = self.around.first_plane(start, d)
            rows = np.flatnonzero((plane >= 0) & ~(hit.distance < distance))
            if len(rows):
                places = start[rows] + distance[rows, None] * d[rows]
                left = self.left(places, plane[rows], draw.of(rows), 0)
                out[rows] += self.around.picture(places, plane[rows]) * (left - 1)
        return out


def trace_frame(
    view: View, planes: Planes, seen: Rect, disc: Rect, samples: int, strength: float,
    gloss: tuple[float, float], mirror: Rect,
) -> Mapping[Layer, np.ndarray]:  # fmt: skip
    """VIRTUAL and SHADOW with indirect light. seen : pixels of the picture that are looked at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness;  mirror : pixels that can mirror the object
    """
    now, scene, facts, light, pose, seed = view.layers, view.scene, view.facts, view.light, view.pose, view.key
    rays = RayScene(scene)
    cube, factor = environment_cube(facts, scene, light)
    around = Surroundings(now, seen, scene, facts, cube * factor, planes, ball_of(scene)[1])
    tracer = Tracer(rays, around, light, scene)
    anchor = scene.world_from_anchor.inverse()
    eye = anchor.apply(pose.inverse().translation_m)
    rect = now.rect
    x, y = np.meshgrid(np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1))
    key = (y.astype(np.uint32) * np.uint32(65521) + x.astype(np.uint32)) * np.uint32(2654435761)
    virtual, shadow = now[Layer.VIRTUAL].copy(), now[Layer.SHADOW].copy()
    lengths = np.linalg.norm(now[Layer.NORMAL], axis=-1)
    kept = np.zeros((rect.height, rect.width), bool)
    kept[view.out.clip(rect).slices_in(rect)] = True
    for rows in _batches(np.argwhere((now[Layer.COVERAGE] > 0) & (lengths > 1e-3) & kept)):
        at = rows[:, 0], rows[:, 1]
        normals = normalise(now[Layer.NORMAL][at].astype(float)) @ anchor.rotation.T
        places = anchor.apply(now[Layer.POSITION][at].astype(float))
        light_ = _object_light(
            tracer, places, normals, normalise(eye - places), now[Layer.ALBEDO][at].astype(float),
            now[Layer.MATERIAL][at].astype(float), key[at], samples, seed,
        )  # fmt: skip
        virtual[at] += (light_ * now[Layer.COVERAGE][at][:, None]).astype(np.float32)
    real = measured(now[Layer.REAL_DEPTH])
    if not disc.union(mirror).clip(rect).empty and strength > 0:
        wanted, glossy = np.zeros(shadow.shape[:2], bool), np.zeros(shadow.shape[:2], bool)
        for inside, mask in ((disc.clip(rect), wanted), (mirror.clip(rect), glossy)):
            if not inside.empty:
                mask[inside.slices_in(rect)] = True
        directions = scene.camera.directions(np.stack([x, y], -1).astype(float)) @ (anchor.rotation @ pose.rotation.T).T
        for rows in _batches(np.argwhere((wanted | glossy) & kept & np.isfinite(directions).all(-1))):
            at = rows[:, 0], rows[:, 1]
            d = normalise(directions[at])
            plane, distance = around.first_plane(np.broadcast_to(eye, d.shape), d)
            keep = np.flatnonzero(plane >= 0)
            at = at[0][keep], at[1][keep]
            n = around.axes[plane[keep], 3]
            start = eye + distance[keep, None] * d[keep] + rays.lift * n
            matt, shiny = np.flatnonzero(wanted[at]), np.flatnonzero(glossy[at])
            total, mirrored, others = (np.zeros((len(keep), 3)) for _ in range(3))
            for s in range(samples):
                total[matt] += tracer.change(start[matt], n[matt], Draw(key[at][matt], s, samples, seed), BOUNCES)
                others[matt] += tracer.by_others(start[matt], n[matt], Draw(key[at][matt], s, samples, seed))
                if len(shiny):
                    draw = Draw(key[at][shiny], s, samples, seed ^ 0x27D4EB2F)
                    towards = -d[keep][shiny]
                    lobes = Gloss(n[shiny], towards, np.full((len(shiny), 3), gloss[0]), gloss[1])
                    rows, lobe, weight, _ = lobes.directions(draw)
                    some = shiny[rows]
                    mirrored[some] += weight * tracer.change_along(start[some], lobe, draw.of(rows), BOUNCES)
            alone = np.array(tracer.whole)[plane[keep]]
            whole = np.maximum(alone + others / samples, LEAST_LEFT * alone)
            change = divide(total / samples, whole) - (1 - shadow[at]) * (divide(alone, whole, where_zero=1.0) - 1)
            base = np.maximum(now[Layer.PLATE][at] - np.array(facts.bias_rgb), DARKEST)
            change += np.maximum(mirrored / samples, -base) / base
            if real.size:
                depth = distance[keep] * (d[keep] @ (anchor.rotation @ pose.rotation.T)[:, 2])
                change *= np.array([agrees(real, j, i, z) for j, i, z in zip(*at, depth, strict=True)]).reshape(-1, 1)
            shadow[at] += (strength * change).astype(np.float32)
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.clip(shadow, 0, None)}


def _in_disc(d: np.ndarray, size_deg: float, draw: Draw) -> np.ndarray:
    """(n, 3) unit directions to points of a light's disc around d (3,)."""
    u, v = draw.pair()
    r, phi = np.tan(np.radians(size_deg / 2)) * np.sqrt(u), 2 * np.pi * v
    return normalise(about(np.broadcast_to(d, (len(u), 3)), r * np.cos(phi), r * np.sin(phi), np.ones(len(u))))


def matt_density(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) per steradian of `cosine_directions`."""
    return np.asarray(np.clip((normals * directions).sum(1), 0, None) / np.pi)


def matt(normals: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """What `Tracer.found` asks of a white diffuse surface: cosine over pi, both times."""

    def value(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = matt_density(normals, directions)
        return density[:, None], density

    return value


def _object_light(
    tracer: Tracer, places: np.ndarray, n: np.ndarray, v: np.ndarray, albedo: np.ndarray, material: np.ndarray,
    key: np.ndarray, samples: int, seed: int,
) -> np.ndarray:  # fmt: skip
    """(k, 3) indirect light that surfaces send along v (k, 3)."""
    start = places + tracer.rays.lift * n
    metal = material[:, :1]
    f0 = 0.08 * material[:, 2:3] * (1 - metal) + albedo * metal
    shiny = f0.max(1) > 0
    body = albedo * (1 - metal)
    dull, lobes = np.flatnonzero(body.max(1) > 0), np.flatnonzero(shiny)
    gloss = Gloss(n[lobes], v[lobes], f0[lobes], material[lobes, 1])
    total = np.zeros_like(places)

    def body_share(d: np.ndarray) -> np.ndarray:
        """Of what arrives along d, reflected by what lies under the gloss."""
        half = normalise(d + v[dull])
        fresnel = f0[dull] + (1 - f0[dull]) * (1 - np.clip((half * v[dull]).sum(1, keepdims=True), 0, 1)) ** 5
        return np.asarray(body[dull] * (1 - np.where(shiny[dull][:, None], fresnel, 0)))

    def dull_value(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = matt_density(n[dull], d)
        return body_share(d) * density[:, None], density

    for s in range(samples):
        if len(dull):
            draw = Draw(key[dull], s, samples, seed)
            d = cosine_directions(n[dull], draw)
            got = tracer.along(start[dull], d, draw.of(np.arange(len(dull))), BOUNCES, matt_density(n[dull], d))
            total[dull] += body_share(d) * got + tracer.found(start[dull], draw, dull_value)
        if len(lobes):
            draw = Draw(key[lobes], s, samples, seed ^ 0x5BD1E995)
            some, d, weight, density = gloss.directions(draw)
            total[lobes[some]] += weight * tracer.along(start[lobes[some]], d, draw.of(some), BOUNCES, density)
            total[lobes] += tracer.found(start[lobes], draw, lambda d: gloss.at(np.arange(len(lobes)), d))
    return total / samples


def _batches(rows: np.ndarray) -> Iterator[np.ndarray]:
    for a in range(0, len(rows), _BATCH):
        yield rows[a : a + _BATCH]
