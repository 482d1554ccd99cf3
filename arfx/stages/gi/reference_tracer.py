"""Paths of light through the object, the planes and their surroundings, for level `reference`.

A path is one ray after another. Where it meets the object it takes the lamps' light and goes on by
a random lobe of the material; its last ray takes the light of all around as if the object were not
in its way. Where it meets a plane it takes the picture, less the lamps' light
that the object hides there, and goes on with what the object changes of the plane's soft light:
such a ray counts for what the object sends less what it hides. Bright parts of the environment are
sampled as well.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering (estimators). Leaves out: lamps mirrored
on the way (caustics); samples of what glows: small things that glow are met by chance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide, normalise
from arfx.core.stage import View
from arfx.stages.gi.incoming import IncomingLight
from arfx.stages.gi.plane_change import sampled
from arfx.stages.gi.reference_lobes import (
    Lobes,
    MaterialLobes,
    PlaneLobes,
    dot,
    frames,
    from_frame,
    on_ball,
)
from arfx.stages.gi.reference_scene import RayScene
from arfx.stages.gi.reference_sky import Environment
from arfx.stages.light.surroundings import frame_surroundings

BOUNCES = 8  # places that a path meets, with its first and last
# random numbers of one place: which lobe and its direction, the lamps' discs and the environment
LOBE, LIGHT = slice(0, 3), slice(3, 5)
NUMBERS = 5


class Rays(NamedTuple):
    """Rays (n) under way. pixel (n,) : row of what they are drawn for, each once;  start (n, 3)
    weight (n, 3) : by which what they bring counts;  change (n, 1) bool : whether only what the
    object changes counts
    direction (n, 3);  wide (n, 3) : as `Environment.radiance` takes it
    sky (n, 1) : share of the environment's light that they bring, the rest is sampled"""

    pixel: ndarray
    start: ndarray
    weight: ndarray
    change: ndarray
    direction: ndarray
    wide: ndarray
    sky: ndarray

    def of(self, rows: ndarray) -> Rays:
        return Rays(*(values[rows] for values in self))


class Tracer:
    """axes (planes, 4, 3);  plane_light (planes, 3) : radiance of white planes with nothing in the
    light's way"""

    def __init__(self, view: View, incoming: IncomingLight) -> None:
        scene, light = view.scene, view.light
        turn = scene.world_from_anchor.rotation
        self.rays, self._incoming = RayScene(scene), incoming
        self.axes = incoming.planes.axes.astype(float)
        self._lamps = [(lamp, turn.T @ lamp.unit) for lamp in light.lights]
        self.plane_light = light.radiance(self.axes[:, 3] @ turn.T)
        known = frame_surroundings(view.facts, scene, light)
        self._sky = Environment(known.cubes(), known.axes @ turn)

    def over_plane(self, plane: int, places: ndarray) -> tuple[ndarray, ndarray]:
        """(starts, normals) of rays from places (n, 3) of a plane."""
        normals = np.broadcast_to(self.axes[plane, 3], places.shape)
        return places + self.rays.lift * normals, normals

    def plane_lobes(self, start: ndarray, normals: ndarray) -> PlaneLobes:
        several = len(self.axes) > 1
        return PlaneLobes(start, normals, self.rays.centre, self.rays.radius, several)

    def light(
        self,
        start: ndarray,
        lobes: Lobes,
        change: bool,
        numbers: ndarray,
    ) -> ndarray:
        """(n, 3) that surfaces at `start` (n, 3) send on by their lobes, of one path each, or what
        the object changes of it.

        numbers (n, BOUNCES, NUMBERS) in [0, 1). Lamps that shine on the surfaces themselves are
        left out."""
        pixel, out = np.arange(len(start)), np.zeros(start.shape)
        counts = np.ones(start.shape), np.full((len(start), 1), change)
        rays = Rays(pixel, start, *counts, start, start, start)
        rays = self._scattered(rays, lobes, numbers[:, 0], out)
        for bounce in range(1, BOUNCES):
            ends = bounce == BOUNCES - 1
            rays = self._met(rays, numbers[rays.pixel, bounce], ends, out)
        return out

    def of_other_planes(
        self, start: ndarray, normals: ndarray, numbers: ndarray
    ) -> ndarray:
        """(n, 3) light of white planes that other planes give them less what they hide, without the
        object; of one direction each, numbers as of `light`."""
        u, v = numbers[:, 0, :2].T[:, :, None]
        d = from_frame(frames(normals), on_ball(np.sqrt(1 - u), v))
        plane, plane_m = self._incoming.planes.first_met(start, d)
        hidden = (plane >= 0)[:, None] * self._sky.radiance(d, np.ones_like(d))
        return self._picture(start, d, plane, plane_m) - hidden

    def _picture(
        self,
        start: ndarray,
        direction: ndarray,
        plane: ndarray,
        distance: ndarray,
    ) -> ndarray:
        """(n, 3) radiance of the planes that rays meet as the picture shows them, and where it does
        not, as it is around; 0 where they meet none. plane, distance : of `Planes.first_met`"""
        out, incoming = np.zeros(start.shape), self._incoming
        for k in np.unique(plane[plane >= 0]):
            rows, axes = np.flatnonzero(plane == k), self.axes[k]
            places = start[rows] + distance[rows, None] * direction[rows]
            radiance, known = incoming.shown.radiance(places[None], axes)
            on_plane = incoming.planes.texture_places(places, plane[rows])
            around = sampled(incoming.picture[k], on_plane[None])
            out[rows] = np.where(known[..., None] > 0, radiance, around)[0]
        return out

    def _met(self, rays: Rays, drawn: ndarray, last: bool, out: ndarray) -> Rays:
        """Rays that go on where these end. out (pixels, 3) += what these bring, of the last ones as
        if the object were not in their way;  drawn (n, NUMBERS)"""
        met = self.rays.nearest(rays.start, rays.direction)
        ends = rays.start, rays.direction
        plane, plane_m = self._incoming.planes.first_met(*ends)
        on_object = (met.distance < plane_m) & (not last)
        picture = self._picture(*ends, plane, plane_m)
        # what is there without the object is hidden, or seen
        some = np.flatnonzero(on_object == rays.change[:, 0])
        of_sky = self._sky.radiance(rays.direction[some], rays.wide[some])
        behind = np.where(
            plane[some, None] >= 0, picture[some], of_sky * rays.sky[some]
        )
        sign = np.where(rays.change[some], -1, 1)
        out[rays.pixel[some]] += sign * rays.weight[some] * behind
        rows = np.flatnonzero(on_object)
        here = rays.of(rows)
        surface = self.rays.surface(met.of(rows), here.start, here.direction)
        away = dot(surface.normal, here.direction) > 0
        normal = np.where(away, -surface.normal, surface.normal)
        start = surface.position + self.rays.lift * normal
        lamps, _ = self._lamp_light(start, normal, drawn[rows])
        out[here.pixel] += here.weight * (surface.emission + surface.diffuse * lamps)
        lobes = MaterialLobes(normal, -here.direction, *surface[3:])
        here = here._replace(start=start, change=here.change & False)
        of_object = self._scattered(here, lobes, drawn[rows], out)
        rows = np.flatnonzero((plane >= 0) & ~on_object)
        here, normal = rays.of(rows), self.axes[plane[rows], 3]
        start = here.start + plane_m[rows, None] * here.direction
        start += self.rays.lift * normal
        _, hidden = self._lamp_light(start, normal, drawn[rows])
        weight = here.weight * divide(picture[rows], self.plane_light[plane[rows]])
        out[here.pixel] -= weight * hidden
        here = here._replace(start=start, weight=weight, change=here.change | True)
        lobes_of_plane = self.plane_lobes(start, normal)
        of_plane = self._scattered(here, lobes_of_plane, drawn[rows], out)
        return Rays(*map(np.concatenate, zip(of_object, of_plane, strict=True)))

    def _scattered(
        self, rays: Rays, lobes: Lobes, drawn: ndarray, out: ndarray
    ) -> Rays:
        """Rays on from their starts by the surfaces' lobes. out += light of the environment's
        bright parts, by samples of their own."""
        pixel, start, weight, change, *_ = rays
        sky = self._sky
        if sky.bright:
            direction = sky.samples(drawn[:, LIGHT])
            total, density, wide = lobes.at(direction)
            plane, _ = self._incoming.planes.first_met(start, direction)
            hidden = self.rays.blocked(start, direction)
            counts = (plane < 0) & (hidden == change[:, 0])
            light = sky.radiance(direction, wide) * counts[:, None]
            light *= divide(total, density + sky.density(direction))
            out[pixel] += np.where(change, -1, 1) * weight * light
        direction = lobes.directions(drawn[:, LOBE])
        total, density, wide = lobes.at(direction)
        weight = weight * divide(total, density)
        share = divide(density, density + sky.density(direction))
        on = rays._replace(weight=weight, direction=direction, wide=wide, sky=share)
        return on.of(np.flatnonzero(weight.any(1)))

    def _lamp_light(
        self,
        start: ndarray,
        normals: ndarray,
        drawn: ndarray,
    ) -> tuple[ndarray, ndarray]:
        """(light of white surfaces (n, 3), what the object hides of it (n, 3)), by one ray to each
        lamp's disc."""
        received, hidden = np.zeros((2, len(start), 3))
        u, v = drawn[:, LIGHT].T[:, :, None]
        on_disc = on_ball(np.sqrt(1 - u), v)[:, :2]
        for lamp, towards in self._lamps:
            across = frames(towards[None])[0, :2]
            size = np.tan(np.radians(lamp.angular_size_deg / 2))
            d = normalise(towards + size * on_disc @ across)
            light = np.maximum(dot(normals, d), 0) * np.maximum(lamp.rgb, 0)
            blocked = self.rays.blocked(start, d)
            plane, _ = self._incoming.planes.first_met(start, d)
            hidden += light * blocked[:, None]
            received += light * (~blocked & (plane < 0))[:, None]
        return received, hidden
