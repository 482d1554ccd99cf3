"""Paths of light through the object, the planes and their surroundings, for level `reference`.

A path is one ray after another. Where it meets the object it takes the lamps' light and goes on by
a random lobe of the material; after BOUNCES places it takes the light of all around as if the
object were not in its way. Where it meets a plane it takes the picture, less the lamps' light that
the object hides there, and goes on with what the object changes of the plane's soft light: such a
ray counts for what the object sends less what it hides. Bright parts of the environment are sampled
as well.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators). Leaves out: lamps mirrored
on the way (caustics); samples of what glows: small things that glow are met by chance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene
from arfx.stages.gi.reference_lobes import (
    Lobes,
    MaterialLobes,
    PlaneLobes,
    dot,
    frames,
    on_ball,
)
from arfx.stages.gi.reference_scene import Met, RayScene, Surroundings

BOUNCES = 6  # places that a path meets
# random numbers of one place: which lobe and its direction, the lamps' discs, the environment
LOBE = slice(0, 3)
LAMP = slice(3, 5)
SKY = slice(5, 7)
NUMBERS = 7


class Rays(NamedTuple):
    """Rays (n) under way. pixel (n,) : row of what they are drawn for, each once;  start (n, 3)
    weight (n, 3) : by which what they bring counts;  change (n, 1) bool : whether only what the
    object changes counts
    direction (n, 3);  wide (n, 3) : as `Environment.radiance` takes it
    sky (n, 1) : share of the environment's light that they bring, the rest is sampled"""

    pixel: np.ndarray
    start: np.ndarray
    weight: np.ndarray
    change: np.ndarray
    direction: np.ndarray
    wide: np.ndarray
    sky: np.ndarray

    def of(self, rows: np.ndarray) -> Rays:
        return Rays(*(values[rows] for values in self))


class Tracer:
    """plane_light (planes, 3) : radiance of white planes with nothing in the light's way. light :
    WORLD axes"""

    def __init__(
        self,
        rays: RayScene,
        around: Surroundings,
        light: Light,
        scene: Scene,
    ) -> None:
        self.rays, self.around = rays, around
        turn = scene.world_from_anchor.rotation
        self._lamps = [(lamp, turn.T @ lamp.unit) for lamp in light.lights]
        normals = around.axes[:, 3] @ turn.T
        self.plane_light = light.radiance(normals)

    def plane_lobes(self, start: np.ndarray, normals: np.ndarray) -> PlaneLobes:
        several = len(self.around.axes) > 1
        return PlaneLobes(start, normals, self.rays.centre, self.rays.radius, several)

    def light(
        self,
        start: np.ndarray,
        lobes: Lobes,
        change: bool,
        numbers: np.ndarray,
    ) -> np.ndarray:
        """(n, 3) that surfaces at `start` (n, 3) send on by their lobes, of one path each, or what
        the object changes of it.

        numbers (n, BOUNCES + 1, NUMBERS) in [0, 1). Lamps that shine on the surfaces themselves are
        left out."""
        count = len(start)
        out, weight = np.zeros((count, 3)), np.ones((count, 3))
        whole = np.arange(count), start, weight, np.full((count, 1), change)
        rays = self._scattered(*whole, lobes, numbers[:, 0], out)
        for bounce in range(1, BOUNCES + 1):
            rays = self._met(rays, numbers[rays.pixel, bounce], out)
        rays = rays.of(np.flatnonzero(~rays.change))
        ends = self.around.first_plane(rays.start, rays.direction)
        out[rays.pixel] += rays.weight * self._behind(rays, *ends)
        return out

    def _met(self, rays: Rays, drawn: np.ndarray, out: np.ndarray) -> Rays:
        """Rays that go on where these end. out (pixels, 3) += what these bring;  drawn (n,
        NUMBERS)"""
        met = self.rays.nearest(rays.start, rays.direction)
        plane, plane_m = self.around.first_plane(rays.start, rays.direction)
        on_object = met.distance < plane_m
        rows = np.flatnonzero(on_object == rays.change[:, 0])  # hidden, or seen
        some = rays.of(rows)
        behind = self._behind(some, plane[rows], plane_m[rows])
        out[some.pixel] += np.where(some.change, -1, 1) * some.weight * behind
        rows = np.flatnonzero(on_object)
        of_object = self._from_object(rays.of(rows), met.of(rows), drawn[rows], out)
        rows = np.flatnonzero((plane >= 0) & ~on_object)
        on_plane = rays.of(rows), plane_m[rows], plane[rows], drawn[rows]
        going_on = of_object, self._from_plane(*on_plane, out)
        return Rays(*map(np.concatenate, zip(*going_on, strict=True)))

    def _behind(
        self, rays: Rays, plane: np.ndarray, plane_m: np.ndarray
    ) -> np.ndarray:
        """(n, 3) radiance that is there without the object, but for what is sampled."""
        ends = rays.start, rays.direction, plane, plane_m
        return self.around.radiance(*ends, rays.wide, rays.sky)

    def _from_object(
        self, rays: Rays, met: Met, drawn: np.ndarray, out: np.ndarray
    ) -> Rays:
        pixel, start, weight, change, direction, *_ = rays
        surface = self.rays.surface(met, start, direction)
        away = dot(surface.normal, direction) > 0
        normal = np.where(away, -surface.normal, surface.normal)
        start = surface.position + self.rays.lift * normal
        lamps, _ = self._lamp_light(start, normal, drawn[:, LAMP])
        out[pixel] += weight * (surface.emission + surface.diffuse * lamps)
        lobes = MaterialLobes(normal, -direction, *surface[3:])
        whole = pixel, start, weight, np.zeros_like(change)
        return self._scattered(*whole, lobes, drawn, out)

    def _from_plane(
        self,
        rays: Rays,
        distance: np.ndarray,
        plane: np.ndarray,
        drawn: np.ndarray,
        out: np.ndarray,
    ) -> Rays:
        pixel, start, weight, change, direction, *_ = rays
        positions = start + distance[:, None] * direction
        normal = self.around.axes[plane, 3]
        start = positions + self.rays.lift * normal
        _, hidden = self._lamp_light(start, normal, drawn[:, LAMP])
        picture = self.around.picture(positions, plane)
        weight = weight * divide(picture, self.plane_light[plane])
        out[pixel] -= weight * hidden
        whole = pixel, start, weight, np.ones_like(change)
        return self._scattered(*whole, self.plane_lobes(start, normal), drawn, out)

    def _scattered(
        self,
        pixel: np.ndarray,
        start: np.ndarray,
        weight: np.ndarray,
        change: np.ndarray,
        lobes: Lobes,
        drawn: np.ndarray,
        out: np.ndarray,
    ) -> Rays:
        """Rays by the surfaces' lobes. out += light of the environment's bright parts, by samples
        of their own."""
        sky = self.around.environment
        if sky.bright:
            direction = sky.samples(drawn[:, SKY])
            total, density, wide = lobes.at(direction)
            plane, _ = self.around.first_plane(start, direction)
            hidden = self.rays.blocked(start, direction)
            counts = (plane < 0) & (hidden == change[:, 0])
            light = sky.radiance(direction, wide) * counts[:, None]
            light *= divide(total, density + sky.density(direction))
            out[pixel] += np.where(change, -1, 1) * weight * light
        direction = lobes.directions(drawn[:, LOBE])
        total, density, wide = lobes.at(direction)
        weight = weight * divide(total, density)
        share = divide(density, density + sky.density(direction))
        rays = Rays(pixel, start, weight, change, direction, wide, share)
        return rays.of(np.flatnonzero(weight.any(1)))

    def _lamp_light(
        self,
        start: np.ndarray,
        normals: np.ndarray,
        numbers: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(light of white surfaces (n, 3), what the object hides of it (n, 3)), by one ray to each
        lamp's disc."""
        received, hidden = np.zeros((2, len(start), 3))
        u, v = numbers.T[:, :, None]
        on_disc = on_ball(np.sqrt(1 - u), v)[:, :2]
        for lamp, towards in self._lamps:
            across = frames(towards[None])[0, :2]
            size = np.tan(np.radians(lamp.angular_size_deg / 2))
            d = normalise(towards + size * on_disc @ across)
            cosine = dot(normals, d)
            rows = np.flatnonzero(cosine > 0)
            blocked = self.rays.blocked(start[rows], d[rows])[:, None]
            plane, _ = self.around.first_plane(start[rows], d[rows])
            light = cosine[rows] * np.maximum(lamp.rgb, 0)
            hidden[rows] += light * blocked
            received[rows] += light * (~blocked & (plane < 0)[:, None])
        return received, hidden
