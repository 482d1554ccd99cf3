"""Level `reference`: Monte Carlo rays (embree) on the same scenes, two bounces; shares no kernel with the cones.

Object pixels: cosine-weighted rays for what is matt, microfacet normals (GGX) for gloss. Plane pixels: cosine-weighted
rays; only those that meet the object count, as what it sends less what it hides. Random numbers are keyed by pixel, sample
and dimension, so that a part of the picture gets the same as the whole. Not denoised: the error of a plane pixel falls with
the root of the samples. Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators); Heitz 2018 (Smith's G).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.stages.gi.frame_light import environment_cube
from arfx.stages.gi.plane_pixels import DARKEST, agrees, measured
from arfx.stages.gi.real_planes import ball_of
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings
from arfx.stages.gi.surroundings import Planes

BOUNCES = 2
_BATCH = 1 << 17  # pixels at once: bounds memory


def uniform(pixel: np.ndarray, sample: int, dimension: int, seed: int) -> np.ndarray:
    """Numbers in [0, 1) from pixels (n,) uint32: a hash (PCG output permutation of O'Neill 2014) of all arguments."""
    with np.errstate(over="ignore"):
        mix = np.uint32((sample * 0x9E3779B1 + dimension * 0x85EBCA77 + seed * 0xC2B2AE3D) & 0xFFFFFFFF)
        s = (pixel.astype(np.uint32) ^ mix) * np.uint32(747796405) + np.uint32(2891336453)
        s = ((s >> ((s >> np.uint32(28)) + np.uint32(4))) ^ s) * np.uint32(277803737)
        s = (s >> np.uint32(22)) ^ s
        s = (s ^ mix) * np.uint32(747796405) + np.uint32(2891336453)
        s = ((s >> ((s >> np.uint32(28)) + np.uint32(4))) ^ s) * np.uint32(277803737)
        s = (s >> np.uint32(22)) ^ s
    return np.asarray(s / 4294967296.0)


class Draw:
    """Random numbers of some pixels for one sample; every call takes new dimensions. strata : of the first pair"""

    def __init__(self, pixel: np.ndarray, sample: int, samples: int, seed: int, dimension: int = 0) -> None:
        self.pixel, self.sample, self.samples, self.seed, self.dimension = pixel, sample, samples, seed, dimension

    def pair(self) -> tuple[np.ndarray, np.ndarray]:
        d = self.dimension
        self.dimension += 2
        if d:
            return uniform(self.pixel, self.sample, d, self.seed), uniform(self.pixel, self.sample, d + 1, self.seed)
        # Fibonacci lattice, shifted by a number of the pixel's own (Cranley and Patterson)
        u = (self.sample + 0.5) / self.samples + uniform(self.pixel, 0, 1000, self.seed)
        v = self.sample * 0.6180339887498949 + uniform(self.pixel, 0, 1001, self.seed)
        return u % 1, v % 1

    def of(self, rows: np.ndarray) -> Draw:
        return Draw(self.pixel[rows], self.sample, self.samples, self.seed, self.dimension + 100)


def about(normals: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n, 3) x, y, z (n,) in a frame whose z is the unit normal (n, 3)."""
    side = np.where(np.abs(normals[:, :1]) > 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    u = normalise(np.cross(side, normals))
    v = np.cross(normals, u)
    return np.asarray(x[:, None] * u + y[:, None] * v + z[:, None] * normals)


def cosine_directions(normals: np.ndarray, draw: Draw) -> np.ndarray:
    """(n, 3) unit, with a density as their cosine to the normals (n, 3)."""
    u, v = draw.pair()
    r, phi = np.sqrt(u), 2 * np.pi * v
    return about(normals, r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u))


class Tracer:
    """Radiance along rays. light : WORLD axes, taken into the anchor's"""

    def __init__(self, rays: RayScene, around: Surroundings, light: Light, scene: Scene) -> None:
        self.rays, self.around = rays, around
        turn = scene.world_from_anchor.rotation
        self.lights = [(turn.T @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights]
        self.whole = [light.radiance(turn @ axes[3]) for axes in around.axes]

    def along(self, origins: np.ndarray, directions: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) radiance that comes from `directions`."""
        hit = self.rays.first(origins, directions)
        plane, distance = self.around.first_plane(origins, directions)
        on_object = hit.met & (hit.distance < distance)
        on_plane = (plane >= 0) & ~on_object
        out = np.zeros((len(origins), 3))
        sky = ~on_object & ~on_plane
        out[sky] = self.around.environment(directions[sky])
        rows = np.flatnonzero(on_object)
        if len(rows):
            out[rows] = self.leaves(hit.of(rows), -directions[rows], draw.of(rows), bounces)
        rows = np.flatnonzero(on_plane)
        if len(rows):
            places = origins[rows] + distance[rows, None] * directions[rows]
            out[rows] = self.around.picture(places, plane[rows]) * self.left(places, plane[rows], draw.of(rows), bounces)
        return out

    def leaves(self, hit: Hit, towards: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) that the object's surface sends `towards` a direction: emission, direct light, and one more bounce."""
        normal = np.where(((hit.normal * towards).sum(1) < 0)[:, None], -hit.normal, hit.normal)
        start = hit.place + self.rays.lift * normal
        arriving = self.direct(start, normal, draw)
        if bounces > 0:
            d = cosine_directions(normal, draw)
            arriving = arriving + self.along(start, d, draw, bounces - 1)
        else:
            arriving = arriving + self.around.even(normal)
        out = hit.emission + hit.matt * arriving
        if bounces > 0 and hit.mirrors.any():
            d = 2 * (normal * towards).sum(1, keepdims=True) * normal - towards
            out = out + hit.mirrors * self.along(start, d, draw, bounces - 1)
        elif hit.mirrors.any():
            out = out + hit.mirrors * self.around.even(normal)
        return np.asarray(out)

    def direct(self, points: np.ndarray, normals: np.ndarray, draw: Draw) -> np.ndarray:
        """(n, 3) of white surfaces, by one ray to each light's disc."""
        out = np.zeros((len(points), 3))
        for d, rgb, size_deg in self.lights:
            u, v = draw.pair()
            r, phi = np.tan(np.radians(size_deg / 2)) * np.sqrt(u), 2 * np.pi * v
            towards = normalise(about(np.broadcast_to(d, points.shape), r * np.cos(phi), r * np.sin(phi), np.ones(len(u))))
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
            u, v = draw.pair()
            r, phi = np.tan(np.radians(size_deg / 2)) * np.sqrt(u), 2 * np.pi * v
            towards = normalise(about(np.broadcast_to(d, places.shape), r * np.cos(phi), r * np.sin(phi), np.ones(len(u))))
            rows = np.flatnonzero(normals @ d > 0)
            if len(rows):
                lost[rows] += ((normals[rows] @ d) * self.rays.blocked(start[rows], towards[rows]))[:, None] * rgb
        return np.asarray(1 + divide(self.change(start, normals, draw, bounces) - lost, whole))

    def change(self, start: np.ndarray, normals: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) indirect light of a white plane with the object less without it, by one ray."""
        return self.change_along(start, cosine_directions(normals, draw), draw, bounces)

    def change_along(self, start: np.ndarray, d: np.ndarray, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) radiance from directions d with the object less without it."""
        hit = self.rays.first(start, d)
        out = np.zeros((len(start), 3))
        rows = np.flatnonzero(hit.met)
        if len(rows):
            plane, distance = self.around.first_plane(start[rows], d[rows])
            nearer = hit.distance[rows] < distance
            rows, plane, distance = rows[nearer], plane[nearer], distance[nearer]
        if len(rows):
            behind = self.around.environment(d[rows])
            other = np.flatnonzero(plane >= 0)
            behind[other] = self.around.picture(start[rows[other]] + distance[other, None] * d[rows[other]], plane[other])
            # the last bounce takes the light that nothing hides, instead of none: nearer the truth than a black object
            sent = self.leaves(hit.of(rows), -d[rows], draw.of(rows), max(bounces - 1, 0))
            out[rows] = sent - behind
        if bounces > 0 and len(self.around.axes) > 1:
            out += self._by_other_planes(start, d, hit, draw, bounces)
        return out

    def _by_other_planes(self, start: np.ndarray, d: np.ndarray, hit: Hit, draw: Draw, bounces: int) -> np.ndarray:
        """(n, 3) change of what rays that pass the object bring from another plane, which it shades or lights."""
        out = np.zeros((len(start), 3))
        plane, distance = self.around.first_plane(start, d)
        rows = np.flatnonzero((plane >= 0) & ~(hit.distance < distance))
        if len(rows):
            places = start[rows] + distance[rows, None] * d[rows]
            left = self.left(places, plane[rows], draw.of(rows), min(bounces - 1, 0))
            out[rows] = self.around.picture(places, plane[rows]) * (left - 1)
        return out


def trace_frame(
    now: Layers, scene: Scene, facts: FrameFacts, light: Light, planes: Planes, seen: Rect, disc: Rect, samples: int,
    strength: float, rng: np.random.Generator, gloss: tuple[float, float] = (0.0, 0.0), mirror: Rect = EMPTY,
    out: Rect | None = None,
) -> Mapping[Layer, np.ndarray]:  # fmt: skip
    """VIRTUAL and SHADOW with indirect light. seen : pixels of the picture that are looked at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness;  mirror : pixels that can mirror the object
    out : the pixels that are wanted, None = all
    """
    pose = facts.camera_from_world
    assert pose is not None
    seed = int(rng.integers(1 << 31))
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
    kept[(rect if out is None else out.clip(rect)).slices_in(rect)] = True
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
            total, mirrored = np.zeros((len(keep), 3)), np.zeros((len(keep), 3))
            for s in range(samples):
                total[matt] += tracer.change(start[matt], n[matt], Draw(key[at][matt], s, samples, seed), BOUNCES)
                if len(shiny):
                    draw = Draw(key[at][shiny], s, samples, seed ^ 0x27D4EB2F)
                    towards = -d[keep][shiny]
                    rows, lobe, weight = gloss_directions(n[shiny], towards, np.full((len(shiny), 3), gloss[0]), gloss[1], draw)
                    some = shiny[rows]
                    mirrored[some] += weight * tracer.change_along(start[some], lobe, draw.of(rows), BOUNCES)
            change = divide(total / samples, np.array(tracer.whole)[plane[keep]])
            base = np.maximum(now[Layer.PLATE][at] - np.array(facts.bias_rgb), DARKEST)
            change += np.maximum(mirrored / samples, -base) / base
            if real.size:
                depth = distance[keep] * (d[keep] @ (anchor.rotation @ pose.rotation.T)[:, 2])
                change *= np.array([agrees(real, j, i, z) for j, i, z in zip(*at, depth, strict=True)]).reshape(-1, 1)
            shadow[at] += (strength * change).astype(np.float32)
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.clip(shadow, 0, None)}


def gloss_directions(
    n: np.ndarray, v: np.ndarray, f0: np.ndarray, roughness: np.ndarray | float, draw: Draw
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows (m,), unit directions (m, 3), weights (m, 3)) of GGX microfacets about normals n, seen along v: rows (k, 3).

    Smith's height-correlated masking over that of the density n.h D / (4 v.h).
    """
    alpha = np.broadcast_to(np.clip(roughness, 0.02, 1) ** 2, len(n))
    u, w = draw.pair()
    tangent2 = alpha**2 * u / np.maximum(1 - u, 1e-9)
    cosine = 1 / np.sqrt(1 + tangent2)
    sine = np.sqrt(np.clip(1 - cosine**2, 0, None))
    half = about(n, sine * np.cos(2 * np.pi * w), sine * np.sin(2 * np.pi * w), cosine)
    vh = (v * half).sum(1)
    d = 2 * vh[:, None] * half - v
    nl, nv = (n * d).sum(1), np.clip((n * v).sum(1), 1e-4, None)
    rows = np.flatnonzero((nl > 1e-5) & (vh > 1e-5))
    a2, l_, e = alpha[rows] ** 2, nl[rows], nv[rows]
    root = l_ * np.sqrt(a2 + (1 - a2) * e**2) + e * np.sqrt(a2 + (1 - a2) * l_**2)
    weight = divide(2 * l_ * vh[rows], root * cosine[rows])
    f = f0[rows] + (1 - f0[rows]) * ((1 - np.clip(vh[rows], 0, 1)) ** 5)[:, None]
    return rows, d[rows], f * weight[:, None]


def _object_light(
    tracer: Tracer, places: np.ndarray, n: np.ndarray, v: np.ndarray, albedo: np.ndarray, material: np.ndarray,
    key: np.ndarray, samples: int, seed: int,
) -> np.ndarray:  # fmt: skip
    """(k, 3) indirect light that surfaces send along v (k, 3)."""
    start = places + tracer.rays.lift * n
    metal, rough = material[:, :1], np.clip(material[:, 1], 0.02, 1)
    f0 = 0.08 * material[:, 2:3] * (1 - metal) + albedo * metal
    shiny = f0.max(1) > 0
    total = np.zeros_like(places)
    for s in range(samples):
        draw = Draw(key, s, samples, seed)
        d = cosine_directions(n, draw)
        half = normalise(d + v)
        fresnel = np.where(shiny[:, None], f0 + (1 - f0) * (1 - np.clip((half * v).sum(1, keepdims=True), 0, 1)) ** 5, 0)
        matt = np.flatnonzero((albedo * (1 - metal)).max(1) > 0)
        if len(matt):
            got = tracer.along(start[matt], d[matt], draw.of(matt), BOUNCES)
            total[matt] += (albedo * (1 - metal) * (1 - fresnel))[matt] * got
        lobes = np.flatnonzero(shiny)
        draw = Draw(key[lobes], s, samples, seed ^ 0x5BD1E995)
        some, d, weight = gloss_directions(n[lobes], v[lobes], f0[lobes], rough[lobes], draw)
        rows = lobes[some]
        if len(rows):
            total[rows] += weight * tracer.along(start[rows], d, draw.of(some), BOUNCES)
    return total / samples


def _batches(rows: np.ndarray) -> Iterator[np.ndarray]:
    for a in range(0, len(rows), _BATCH):
        yield rows[a : a + _BATCH]
