"""The model as the reference's rays meet it: triangles (embree), and what they show.

Axes are the anchor's; positions and directions are (n, 3) float64."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import normalise
from arfx.core.scene import Scene
from arfx.stages.light.planes import bounding_ball
from arfx.stages.light.surfels import shown_colours, texels_of
from arfx.stages.triangles import Triangles, anchor_mesh

LIFT = 1e-4  # of the object's size, by which rays start off a surface


class Met(NamedTuple):
    """What rays (n,) meet first. distance : metres, inf where nothing is
    triangle : -1 where nothing is;  u, v : on it"""

    distance: ndarray
    triangle: ndarray
    u: ndarray
    v: ndarray

    def of(self, rows: ndarray) -> Met:
        return Met(*(values[rows] for values in self))


class Surface(NamedTuple):
    """Places on the model. position, normal, emission, albedo (n, 3)
    metal, f0, roughness (n, 1) : f0 of what is no metal;  from albedo on as `MaterialLobes` takes
    them"""

    position: ndarray
    normal: ndarray
    emission: ndarray
    albedo: ndarray
    metal: ndarray
    f0: ndarray
    roughness: ndarray

    @property
    def diffuse(self) -> ndarray:
        """(n, 3) share of the light that is scattered evenly."""
        return self.albedo * (1 - self.metal) * (1 - self.f0)

    @property
    def reflectance(self) -> ndarray:
        """(n, 3) share of the light that is scattered or mirrored."""
        return self.diffuse + self.f0 + self.albedo * self.metal


class RayScene:
    """The model. lift : metres by which rays start off a surface
    centre (3,), radius : of a ball around it"""

    def __init__(self, scene: Scene) -> None:
        self._mesh = anchor_mesh(scene)
        self._triangles = Triangles(self._mesh.corners_m + self._mesh.centre_m)
        self.blocked = self._triangles.blocked
        self.centre, self.radius = bounding_ball(scene)
        self.lift = LIFT * 2 * self.radius

    def nearest(self, origins: ndarray, directions: ndarray) -> Met:
        """What each ray meets first. directions : of any length, by which distances count"""
        hits = self._triangles.first_hits(origins, directions)
        triangle = np.asarray(hits["primID"]).astype(np.int64)
        distance, u, v = (
            np.asarray(hits[name], float) for name in ("tfar", "u", "v")
        )
        distance = np.where(triangle >= 0, distance, np.inf)
        return Met(distance, triangle, u, v)

    def surface(self, met: Met, origins: ndarray, directions: ndarray) -> Surface:
        """Where rays met something; every ray has to."""
        position = origins + met.distance[:, None] * directions
        weights = np.stack([1 - met.u - met.v, met.u, met.v], -1)
        mesh = self._mesh
        corners, part = mesh.faces[met.triangle], mesh.part[met.triangle]
        normal = np.einsum("nk,nkc->nc", weights, mesh.normals[corners])
        albedo, emission, uv = shown_colours(mesh, corners, part, weights)
        of_parts = [(m.roughness, m.metallic, m.specular) for m in mesh.materials]
        roughness, metal, specular = np.array(of_parts)[part].T[..., None]
        texels = texels_of(mesh, "metallic_roughness_texture", part, uv) / 255
        roughness, metal = roughness * texels[:, 1:2], metal * texels[:, 2:3]
        f0 = 0.08 * specular * (1 - metal)
        shown = position, normalise(normal), emission, albedo
        return Surface(*shown, metal, f0, roughness)
