"""Radiance along the rays of the reference, and how the object changes the light of a plane.

A ray's radiance has two parts: what its first meeting tells without a further bounce (the surroundings, the picture on a plane
less the shadows of lamps, a surface in the lamps and in all the light around as if nothing were in its way), and the rest, which
corrects that by further rays. The first costs less and has most of the noise: each can be sampled as often as it needs.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators); Arvo, Kirk 1990 (splitting)."""

from __future__ import annotations

from enum import Enum

import numpy as np

from arfx.core.light import Light
from arfx.core.numerics import divide
from arfx.core.scene import Scene
from arfx.stages.gi.reference_kernels import add_scaled, dots, facing, share_of_ball
from arfx.stages.gi.reference_sampling import (
    Lights,
    Reflectance,
    Sampler,
    balance_weight,
    cosine_density,
    cosine_directions,
    in_disc,
    lambertian,
    towards_ball,
)
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings
from arfx.stages.light.planes import bounding_ball

ASKED = 4.0  # times the share of the hemisphere that the object fills: how many places on planes are asked
LEAST_ASKED = 0.05
MIRRORS = 0.2  # a surface in the middle of a path that mirrors less of the light is asked for it as much less often


class Of(Enum):
    """Which part of a ray's radiance: FIRST without a further bounce, REST what that lacks, ALL both."""

    ALL = 0
    FIRST = 1
    REST = 2


class Tracer:
    """Radiance along rays. light : WORLD axes, taken into the anchor's"""

    def __init__(
        self, rays: RayScene, surroundings: Surroundings, light: Light, scene: Scene
    ) -> None:
        self.rays, self.surroundings, self.sampled = rays, surroundings, Lights(rays, surroundings)
        turn = scene.world_from_anchor.rotation
        self.lights = [
            (turn.T @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights
        ]
        self.plane_light = np.array([light.radiance(turn @ axes[3]) for axes in surroundings.axes])
        self.ball = bounding_ball(scene)
        self._ball = np.append(*self.ball)

    def along(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        draw: Sampler,
        bounces: int,
        wide: np.ndarray,
        density: np.ndarray | None = None,
        of: Of = Of.ALL,
    ) -> np.ndarray:
        """(n, 3) radiance that comes from `directions`, or a part `of` it. density (n,) : with which they were drawn, where
        lights are sampled as well; None = they are not"""
        hit = self.rays.nearest(origins, directions)
        plane, distance = self.surroundings.first_plane(origins, directions)
        on_object = hit.distance < distance
        on_plane = (plane >= 0) & ~on_object
        out = np.zeros((len(origins), 3))
        if of is not Of.REST:
            rows = np.flatnonzero(~on_object & ~on_plane)
            out[rows] = self.sampled.environment(directions, density, rows, wide)
        rows = np.flatnonzero(on_object)
        if len(rows):
            met = self.rays.hit(hit, rows, origins, directions)
            glow = balance_weight(
                density, rows, self.sampled.emitter_density(met, directions[rows])
            )
            out[rows] = self.outgoing_radiance(
                met, -directions[rows], draw.of(rows), bounces, glow, of
            )
        rows = np.flatnonzero(on_plane)
        if len(rows):
            positions = origins[rows] + distance[rows, None] * directions[rows]
            shadow_ratio = self.shadow_ratio(positions, plane[rows], draw.of(rows), bounces, of)
            out[rows] = self.surroundings.picture(positions, plane[rows]) * shadow_ratio
        return out

    def sampled_lights(
        self,
        start: np.ndarray,
        draw: Sampler,
        value: Reflectance,
        wide: np.ndarray,
        change: bool = False,
    ) -> np.ndarray:
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
            light = self.surroundings.environment(d[rows], wide[rows]) * (-1.0 if change else 1.0)
            out[rows] += light * reflected[rows] / (density + own)[rows, None]
        if self.sampled.glows:
            d, distance = self.sampled.to_emitters(start, draw)
            reflected, own = value(d)
            rows = np.flatnonzero(own > 0)
            plane, beyond = self.surroundings.first_plane(start[rows], d[rows])
            met = self.rays.nearest(start[rows], d[rows])
            ok = (
                (met.distance > distance[rows] * (1 - 1e-3))
                & np.isfinite(met.distance)
                & (beyond > distance[rows])
            )
            hit, rows = self.rays.hit(met, np.flatnonzero(ok), start[rows], d[rows]), rows[ok]
            density = self.sampled.emitter_density(hit, d[rows])
            rows, hit, density = (
                rows[density > 0],
                hit.of(np.flatnonzero(density > 0)),
                density[density > 0],
            )
            out[rows] += hit.emission * reflected[rows] / (density + own[rows])[:, None]
        return out

    def outgoing_radiance(
        self,
        hit: Hit,
        towards: np.ndarray,
        draw: Sampler,
        bounces: int,
        glow: np.ndarray | float = 1.0,
        of: Of = Of.ALL,
    ) -> np.ndarray:
        """(n, 3) that the object's surface sends `towards` a direction: emission, direct light, and one more bounce, or a part
        `of` it. Where a path ends, the light around is taken as if nothing were in its way.

        glow : share (n, 1) of its emission that counts"""
        normal, start, mirror = facing(hit.normal, towards, hit.position, self.rays.lift)
        bounce, specular = bounces > 0 and of is not Of.FIRST, hit.specular.any()
        out, arriving = np.zeros((len(normal), 3)), np.zeros((len(normal), 3))
        if of is not Of.REST:
            out, arriving = glow * hit.emission, self.direct(start, normal, draw)
        if bounce == (of is Of.REST):  # the end of a path, or what it would have been
            unoccluded = self.surroundings.unoccluded_irradiance(normal) * (-1.0 if bounce else 1.0)
            arriving = arriving + unoccluded
            if specular:
                out = out + hit.specular * unoccluded
        if bounce:
            d = cosine_directions(normal, draw)
            arriving = arriving + self.along(
                start, d, draw, bounces - 1, np.ones(len(d)), cosine_density(normal, d)
            )
            arriving = arriving + self.sampled_lights(
                start, draw, lambertian(normal), np.ones(len(d))
            )
        out = out + hit.diffuse * arriving
        if (
            bounce and specular
        ):  # Russian roulette: what hardly mirrors is asked for it now and then
            asked = np.minimum(hit.specular.max(1) / MIRRORS, 1)
            rows = np.flatnonzero(draw.single() < asked)
            mirrored = self.along(
                start[rows], mirror[rows], draw.of(rows), bounces - 1, np.zeros(len(rows))
            )
            out[rows] += hit.specular[rows] / asked[rows, None] * mirrored
        return out

    def direct(self, points: np.ndarray, normals: np.ndarray, draw: Sampler) -> np.ndarray:
        """(n, 3) of white surfaces, by one ray to each light's disc."""
        out = np.zeros((len(points), 3))
        for d, rgb, size_deg in self.lights:
            towards = in_disc(d, size_deg, draw)
            cosine = dots(normals, towards)
            rows = np.flatnonzero(cosine > 0)
            if len(rows):
                plane, _ = self.surroundings.first_plane(points[rows], towards[rows])
                visible = ~self.rays.blocked(points[rows], towards[rows]) & (plane < 0)
                add_scaled(out, rows, cosine[rows] * visible, rgb)
        return out

    def shadow_ratio(
        self, positions: np.ndarray, plane: np.ndarray, draw: Sampler, bounces: int, of: Of = Of.ALL
    ) -> np.ndarray:
        """(n, 3) share of a plane's light that is there with the object, or a part `of` it: what the picture on it is
        multiplied by."""
        normals = self.surroundings.axes[plane, 3]
        start = positions + self.rays.lift * normals
        plane_light = self.plane_light[plane]
        hidden_light = np.zeros((len(positions), 3))
        for d, rgb, size_deg in self.lights if of is not Of.REST else ():
            towards = in_disc(d, size_deg, draw)
            cosine = normals @ d
            rows = np.flatnonzero(cosine > 0)
            if len(rows):
                add_scaled(
                    hidden_light,
                    rows,
                    cosine[rows] * self.rays.blocked(start[rows], towards[rows]),
                    rgb,
                )
        if of is Of.FIRST:
            return np.asarray(1 - divide(hidden_light, plane_light))
        # Russian roulette: the less of the hemisphere the object may fill, the fewer are asked
        asked = share_of_ball(start, self._ball, ASKED, LEAST_ASKED)
        rows = np.flatnonzero(draw.single() < asked)
        change = np.zeros((len(start), 3))
        change[rows] = (
            self.change(start[rows], normals[rows], draw.of(rows), bounces) / asked[rows, None]
        )
        return np.asarray((of is Of.ALL) + divide(change - hidden_light, plane_light))

    def change(
        self, start: np.ndarray, normals: np.ndarray, draw: Sampler, bounces: int
    ) -> np.ndarray:
        """(n, 3) indirect light of a white plane with the object less without it, by one ray towards the object, and where
        there are other planes, which it changes too, one towards those."""
        d, density, near = towards_ball(start, normals, *self.ball, draw)
        wide = np.ones(len(start))

        def value(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            cosine = cosine_density(normals, directions)
            return cosine[:, None], np.where(near, cosine, density)

        weight = divide(cosine_density(normals, d), density)[:, None]
        out = self.sampled_lights(start, draw, value, wide, change=True)
        out = out + weight * self.change_along(start, d, draw, bounces, wide, density)
        if bounces > 0 and len(self.surroundings.axes) > 1:
            out = out + self.change_of_planes(start, cosine_directions(normals, draw), draw)
        return np.asarray(out)

    def from_other_planes(
        self, start: np.ndarray, normals: np.ndarray, draw: Sampler
    ) -> np.ndarray:
        """(n, 3) light of a white plane that other planes give it less what they hide, without the object, by one ray."""
        out = np.zeros((len(start), 3))
        if len(self.surroundings.axes) > 1:
            d = cosine_directions(normals, draw)
            plane, distance = self.surroundings.first_plane(start, d)
            rows = np.flatnonzero(plane >= 0)
            positions = start[rows] + distance[rows, None] * d[rows]
            sky = self.surroundings.environment(d[rows], np.ones(len(rows)))
            out[rows] = self.surroundings.picture(positions, plane[rows]) - sky
        return out

    def change_along(
        self,
        start: np.ndarray,
        d: np.ndarray,
        draw: Sampler,
        bounces: int,
        wide: np.ndarray,
        density: np.ndarray | None = None,
    ) -> np.ndarray:
        """(n, 3) radiance from directions d with the object less without it. density : as for `along`"""
        hit = self.rays.nearest(start, d)
        out = np.zeros((len(start), 3))
        rows = np.flatnonzero(np.isfinite(hit.distance))
        if len(rows):
            plane, distance = self.surroundings.first_plane(start[rows], d[rows])
            nearer = hit.distance[rows] < distance
            rows, plane, distance = rows[nearer], plane[nearer], distance[nearer]
        if len(rows):
            background = self.sampled.environment(d, density, rows, wide)
            other = np.flatnonzero(plane >= 0)
            positions = start[rows[other]] + distance[other, None] * d[rows[other]]
            background[other] = self.surroundings.picture(positions, plane[other])
            # the last bounce takes the light that nothing hides, instead of none: nearer the truth than a black object
            met = self.rays.hit(hit, rows, start, d)
            glow = balance_weight(density, rows, self.sampled.emitter_density(met, d[rows]))
            sent = self.outgoing_radiance(met, -d[rows], draw.of(rows), max(bounces - 1, 0), glow)
            out[rows] = sent - background
        return out

    def change_of_planes(self, start: np.ndarray, d: np.ndarray, draw: Sampler) -> np.ndarray:
        """(n, 3) radiance from directions d of planes that the object changes, with it less without it, where it hides none."""
        out = np.zeros((len(start), 3))
        plane, distance = self.surroundings.first_plane(start, d)
        rows = np.flatnonzero(plane >= 0)
        rows = rows[~(self.rays.nearest(start[rows], d[rows]).distance < distance[rows])]
        if len(rows):
            positions = start[rows] + distance[rows, None] * d[rows]
            shadow_ratio = self.shadow_ratio(positions, plane[rows], draw.of(rows), 0)
            out[rows] = self.surroundings.picture(positions, plane[rows]) * (shadow_ratio - 1)
        return out
