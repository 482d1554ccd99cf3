"""Level `reference`: Monte Carlo rays (embree) on the same scenes, two bounces; shares no kernel with the cones.

Object pixels: cosine-weighted rays for diffuse light, microfacet normals (GGX) for gloss. Plane pixels: rays towards the ball
around the object, as only those that meet it count, as what it sends less what it hides. Bright parts of the environment and
what glows are sampled as well (reference_sampling.py). What the clip never saw is as bright as the width of a ray's lobe asks:
a mirror looks through between lamps that a matt surface sees. Samples end where the noise is below what shows, or at
`gi.samples` (reference_noise.py). Random numbers are keyed by pixel, sample and dimension, so that a part of the picture
gets the same as the whole. Not denoised. Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from arfx.core.layers import Layer
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.core.stage import View
from arfx.stages.gi.frame_light import surroundings_of
from arfx.stages.gi.gloss import mirror_tangent
from arfx.stages.gi.plane_change import DARKEST, SAME_DEPTH, measured
from arfx.stages.gi.reference_noise import NOISE, grey_slope, settled
from arfx.stages.gi.reference_sampling import Gloss, Sampler, cosine_density, cosine_directions
from arfx.stages.gi.reference_scene import RayScene, Surroundings
from arfx.stages.gi.reference_tracer import Of, Tracer
from arfx.stages.gi.surroundings import NARROW_DEG, WIDE_DEG
from arfx.stages.holdout import on_plane
from arfx.stages.light.planes import Planes, bounding_ball

BOUNCES = 2
LEAST_LEFT = 0.05  # of a plane's light, beside other planes
SPREAD = 0.4  # of the largest change of a plane, by which rays towards the object differ
DIM, DIM_F0 = (
    4,
    0.1,
)  # gloss of what mirrors less than this goes on to further bounces in one of so many samples
_BATCH = 1 << 14  # pixels at once: bounds memory


def trace_frame(
    view: View,
    planes: Planes,
    visible_rect: Rect,
    disc: Rect,
    samples: int,
    strength: float,
    gloss: tuple[float, float],
    mirror: Rect,
) -> Mapping[Layer, np.ndarray]:
    """VIRTUAL and SHADOW with indirect light. visible_rect : pixels of the picture that are looked at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness;  mirror : pixels that can mirror the object"""
    now, scene, facts, light, pose, seed = (
        view.layers,
        view.scene,
        view.facts,
        view.light,
        view.pose,
        view.key,
    )
    rays = RayScene(scene)
    cubes = surroundings_of(facts, scene, light)
    surroundings = Surroundings(
        now, visible_rect, scene, facts, cubes, planes, bounding_ball(scene)[1]
    )
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
    layers = {
        name: now[name]
        for name in (Layer.NORMAL, Layer.POSITION, Layer.ALBEDO, Layer.MATERIAL, Layer.COVERAGE)
    }

    def object_pixels(rows: np.ndarray) -> None:
        at = rows[:, 0], rows[:, 1]
        part = {name: layer[at].astype(float) for name, layer in layers.items()}
        normals = normalise(part[Layer.NORMAL]) @ anchor.rotation.T
        positions = anchor.apply(part[Layer.POSITION])
        indirect = _object_light(
            tracer,
            positions,
            normals,
            normalise(eye - positions),
            part[Layer.ALBEDO],
            part[Layer.MATERIAL],
            key[at],
            samples,
            seed,
        )
        virtual[at] += (indirect * part[Layer.COVERAGE][:, None]).astype(np.float32)

    parallel_map(
        object_pixels,
        _batches(np.argwhere((now[Layer.COVERAGE] > 0) & (lengths > 1e-3) & requested)),
    )
    real = measured(now)
    if not disc.union(mirror).clip(rect).empty and strength > 0:
        wanted, glossy = np.zeros(shadow.shape[:2], bool), np.zeros(shadow.shape[:2], bool)
        for inside, mask in ((disc.clip(rect), wanted), (mirror.clip(rect), glossy)):
            if not inside.empty:
                mask[inside.slices_in(rect)] = True
        directions = (
            scene.camera.directions(np.stack([x, y], -1).astype(float))
            @ (anchor.rotation @ pose.rotation.T).T
        )
        several, picture = len(planes.axes) > 1, now[Layer.PLATE]

        def plane_pixels(rows: np.ndarray) -> None:
            at = rows[:, 0], rows[:, 1]
            d = normalise(directions[at])
            plane, distance = surroundings.first_plane(np.broadcast_to(eye, d.shape), d)
            keep = np.flatnonzero(plane >= 0)
            at, d, distance, plane = (
                (at[0][keep], at[1][keep]),
                d[keep],
                distance[keep],
                plane[keep],
            )
            n = surroundings.axes[plane, 3]
            start = eye + distance[:, None] * d + rays.lift * n
            alone, plate = (
                tracer.plane_light[plane],
                np.maximum(picture[at] - np.array(facts.bias_rgb), DARKEST),
            )

            def draw(rows: np.ndarray, s: int) -> np.ndarray:
                """(n, 9) change, light of other planes, and what is mirrored, by one sample."""
                out = np.zeros((len(rows), 9))
                changed, shiny = np.flatnonzero(wanted[at][rows]), np.flatnonzero(glossy[at][rows])
                subset = rows[changed]
                out[changed, :3] = tracer.change(
                    start[subset], n[subset], Sampler(key[at][subset], s, seed), BOUNCES
                )
                if several:
                    out[changed, 3:6] = tracer.from_other_planes(
                        start[subset], n[subset], Sampler(key[at][subset], s, seed)
                    )
                if len(shiny):
                    subset = rows[shiny]
                    sampler = Sampler(key[at][subset], s, seed ^ 0x27D4EB2F)
                    lobes = Gloss(
                        n[subset], -d[subset], np.full((len(subset), 3), gloss[0]), gloss[1]
                    )
                    left, lobe, weight, _ = lobes.directions(sampler)
                    inner, wide = start[subset[left]], np.full(len(left), _width(gloss[1]))
                    change = tracer.change_along(inner, lobe, sampler.of(left), BOUNCES, wide)
                    if several:
                        change = change + tracer.change_of_planes(inner, lobe, sampler.of(left))
                    out[shiny[left], 6:] = weight * change
                return out

            def noticed(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
                return (
                    strength
                    * grey_slope(plate[rows])
                    * (values[:, :3] / alone[rows] * plate[rows] + values[:, 6:])
                )

            # what rays towards the ball bring differs by SPREAD of the largest change that the object can make
            away = np.maximum(np.linalg.norm(start - tracer.ball[0], axis=1), tracer.ball[1])
            facing = ((tracer.ball[0] - start) * n).sum(1) / away + tracer.ball[1] / away
            largest = (
                (grey_slope(plate) * plate).max(1)
                * (tracer.ball[1] / away) ** 2
                * np.clip(facing, 0, 1)
            )
            few = np.ceil((SPREAD * largest / NOISE) ** 2).clip(1, samples).astype(int)
            most = np.where(
                several | tracer.sampled.glows | tracer.sampled.bright | glossy[at], samples, few
            )
            total, others, mirrored = np.split(settled(draw, noticed, most, 9), 3, axis=1)
            plane_light = np.maximum(alone + others, LEAST_LEFT * alone)
            change = divide(total, plane_light) - (1 - shadow[at]) * (
                divide(alone, plane_light, where_zero=1.0) - 1
            )
            change += np.maximum(mirrored, -plate) / plate
            if real.size:
                depth = distance * (d @ (anchor.rotation @ pose.rotation.T)[:, 2])
                change *= on_plane(real[at], 1 / depth, SAME_DEPTH)[:, None]
            shadow[at] += (strength * change).astype(np.float32)

        parallel_map(
            plane_pixels,
            _batches(np.argwhere((wanted | glossy) & requested & np.isfinite(directions).all(-1))),
        )
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.clip(shadow, 0, None)}


def _object_light(
    tracer: Tracer,
    positions: np.ndarray,
    n: np.ndarray,
    v: np.ndarray,
    albedo: np.ndarray,
    material: np.ndarray,
    key: np.ndarray,
    samples: int,
    seed: int,
) -> np.ndarray:
    """(k, 3) indirect light that surfaces send along v (k, 3)."""
    start = positions + tracer.rays.lift * n
    metal = material[:, :1]
    matt_f0 = 0.08 * material[:, 2:3] * (1 - metal)
    f0 = matt_f0 + albedo * metal
    diffuse_albedo = albedo * (1 - metal)
    matte, lobes = np.flatnonzero(diffuse_albedo.max(1) > 0), np.flatnonzero(f0.max(1) > 0)
    gloss = Gloss(n[lobes], v[lobes], f0[lobes], material[lobes, 1])
    width = _width(material[lobes, 1])

    def diffuse_fraction(d: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Of what arrives along d, reflected by what lies under the gloss."""
        grazing = (1 - np.clip((normalise(d + v[rows]) * v[rows]).sum(1, keepdims=True), 0, 1)) ** 5
        fresnel = matt_f0[rows] + (matt_f0[rows] > 0) * (1 - matt_f0[rows]) * grazing
        return np.asarray(diffuse_albedo[rows] * (1 - fresnel))

    def diffuse_value(d: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = cosine_density(n[rows], d)
        return diffuse_fraction(d, rows) * density[:, None], density

    shines = (f0[lobes].max(1) > DIM_F0) | (samples % DIM > 0)
    bright, dim = np.flatnonzero(shines), np.flatnonzero(~shines)

    def draw_sample(rows: np.ndarray, s: int) -> np.ndarray:
        inside = np.zeros(len(positions), bool)
        inside[rows] = True
        out = np.zeros_like(positions)
        of = np.flatnonzero(inside[matte])
        if len(of):
            m = matte[of]
            draw = Sampler(key[m], s, seed)
            d = cosine_directions(n[m], draw)
            ones = np.ones(len(m))
            incoming = tracer.along(
                start[m], d, draw.of(np.arange(len(m))), BOUNCES, ones, cosine_density(n[m], d)
            )
            lights = tracer.sampled_lights(start[m], draw, lambda d: diffuse_value(d, m), ones)
            out[m] += diffuse_fraction(d, m) * incoming + lights
        # what hardly shines is asked every time what its gloss meets, and now and then for the rest of that
        for some, part, share in ((bright, Of.ALL, 1), (dim, Of.FIRST, 1), (dim, Of.REST, DIM)):
            of = some[inside[lobes[some]]]
            if s % share == 0 and len(of):
                at, lobe = lobes[of], gloss.of(of)
                draw = Sampler(key[at], s // share, seed ^ 0x5BD1E995 ^ part.value)
                left, d, weight, density = lobe.directions(draw)
                from_lobe = tracer.along(
                    start[at[left]], d, draw.of(left), BOUNCES, width[of[left]], density, part
                )
                out[at[left]] += share * weight * from_lobe
                if part is not Of.REST:
                    out[at] += tracer.sampled_lights(
                        start[at], draw, partial(lobe.at, ...), width[of]
                    )
        return out[rows]

    return settled(
        draw_sample,
        lambda values, rows: grey_slope(values) * values,
        np.full(len(positions), samples),
    )


def _width(roughness: np.ndarray | float) -> np.ndarray:
    """What `Surroundings.environment` takes as `wide`, of a lobe."""
    return np.asarray(
        np.interp(np.degrees(np.arctan(mirror_tangent(roughness))), (NARROW_DEG, WIDE_DEG), (0, 1))
    )


def _batches(rows: np.ndarray) -> Iterator[np.ndarray]:
    for a in range(0, len(rows), _BATCH):
        yield rows[a : a + _BATCH]
