"""What the reference's rays meet: the model's triangles (embree), the real planes and the picture
on them.

Axes are the anchor's; positions and directions are (n, 3) float64."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene
from arfx.stages.gi.incoming import IncomingLight
from arfx.stages.gi.plane_change import sampled
from arfx.stages.gi.reference_sky import Environment
from arfx.stages.light.planes import ENDLESS
from arfx.stages.light.surfels import shown_colours, texels_of
from arfx.stages.triangles import Triangles, anchor_mesh

LIFT = 1e-4  # of the object's size, by which rays start off a surface


class Met(NamedTuple):
    """What rays (n,) meet first. distance : metres, inf where nothing is
    triangle : -1 where nothing is;  u, v : on it"""

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray

    def of(self, rows: np.ndarray) -> Met:
        return Met(*(values[rows] for values in self))


class Surface(NamedTuple):
    """Places on the model. position, normal, emission, albedo (n, 3)
    metal, f0, roughness (n, 1) : f0 of what is no metal;  from albedo on as `MaterialLobes` takes
    them"""

    position: np.ndarray
    normal: np.ndarray
    emission: np.ndarray
    albedo: np.ndarray
    metal: np.ndarray
    f0: np.ndarray
    roughness: np.ndarray

    @property
    def diffuse(self) -> np.ndarray:
        """(n, 3) share of the light that is scattered evenly."""
        return self.albedo * (1 - self.metal) * (1 - self.f0)

    @property
    def reflectance(self) -> np.ndarray:
        """(n, 3) share of the light that is scattered or mirrored."""
        return self.diffuse + self.f0 + self.albedo * self.metal


class RayScene:
    """The model. lift : metres by which rays start off a surface
    centre (3,), radius : of a ball around it"""

    def __init__(self, scene: Scene) -> None:
        self._mesh = anchor_mesh(scene)
        corners = self._mesh.corners_m + self._mesh.centre_m
        self._triangles = Triangles(corners)
        self.blocked = self._triangles.blocked
        points = corners.reshape(-1, 3)
        low, high = points.min(0), points.max(0)
        self.lift = LIFT * max(float((high - low).max()), 1e-9)
        self.centre = (low + high) / 2
        away = np.linalg.norm(points - self.centre, axis=1)
        self.radius = max(float(away.max()), 1e-6)

    def nearest(self, origins: np.ndarray, directions: np.ndarray) -> Met:
        """What each ray meets first. directions : of any length, by which distances count"""
        hits = self._triangles.first_hits(origins, directions)
        triangle = np.asarray(hits["primID"]).astype(np.int64)
        distance, u, v = (
            np.asarray(hits[name], float) for name in ("tfar", "u", "v")
        )
        distance = np.where(triangle >= 0, distance, np.inf)
        return Met(distance, triangle, u, v)

    def surface(
        self, met: Met, origins: np.ndarray, directions: np.ndarray
    ) -> Surface:
        """Where rays met something; every ray has to."""
        position = origins + met.distance[:, None] * directions
        weights = np.stack([1 - met.u - met.v, met.u, met.v], -1)
        mesh = self._mesh
        corners, part = mesh.faces[met.triangle], mesh.part[met.triangle]
        normal = np.einsum("nk,nkc->nc", weights, mesh.normals[corners])
        albedo, emission, uv = shown_colours(mesh, corners, part, weights)
        of_parts = [(m.roughness, m.metallic, m.specular) for m in mesh.materials]
        shine, specular = np.split(np.array(of_parts)[part], [2], 1)
        shiny = texels_of(mesh, "metallic_roughness_texture", part, uv)[:, 1:3] / 255
        roughness, metal = np.hsplit(shine * shiny, 2)
        f0 = 0.08 * specular * (1 - metal)
        shown = position, normalise(normal), emission, albedo
        return Surface(*shown, metal, f0, roughness)


class Surroundings:
    """Planes with the frame's picture on them, and environment."""

    def __init__(self, incoming: IncomingLight, environment: Environment) -> None:
        self.environment, self._incoming = environment, incoming
        planes = incoming.planes
        self.axes = planes.axes.astype(float)
        self._bounds = planes.bounds.astype(float)
        self._bounds[np.abs(self._bounds) >= ENDLESS] *= np.inf

    def first_plane(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(plane (n,), -1 = none; distance (n,), inf) of the nearest plane met from its front."""
        plane, nearest = np.full(len(origins), -1), np.full(len(origins), np.inf)
        for k, (origin, x, y, normal) in enumerate(self.axes):
            x0, y0, x1, y1 = self._bounds[k]
            start = origins - origin
            falls = -(directions @ normal)
            height = np.maximum(start @ normal, 0)
            t = np.where(falls > 1e-9, divide(height, falls), 0)
            met = start + t[:, None] * directions
            u, v = met @ x, met @ y
            within = (
                (x0 < u) & (u < x1) & (y0 < v) & (v < y1) & (t > 0) & (t < nearest)
            )
            plane[within], nearest[within] = k, t[within]
        return plane, nearest

    def picture(self, positions: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of the planes as the picture shows them; where it does not, as it is
        around."""
        out, incoming = np.empty((len(positions), 3)), self._incoming
        for k in np.unique(plane):
            rows, axes = np.flatnonzero(plane == k), self.axes[k]
            places = positions[rows][None]
            radiance, known = incoming.shown.radiance(places, axes)
            in_plane = (places - axes[0]) @ axes[1:3].T / incoming.planes.half_m
            around = sampled(incoming.picture[k], in_plane)
            out[rows] = np.where(known[..., None] > 0, radiance, around)[0]
        return out

    def radiance(
        self,
        starts: np.ndarray,
        directions: np.ndarray,
        plane: np.ndarray,
        distance: np.ndarray,
        wide: np.ndarray,
        sky: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """(n, 3) that is there without the object. plane, distance : of `first_plane`;  wide (n, 3)
        : as `Environment.radiance` takes it;  sky (n, 1) : share of its light that counts"""
        out = self.environment.radiance(directions, wide) * sky
        met = np.flatnonzero(plane >= 0)
        places = starts[met] + distance[met, None] * directions[met]
        out[met] = self.picture(places, plane[met])
        return out
