"""Directions in even steps: the icosahedron, its faces cut into four again and again, all
vertices on the unit sphere.

All triangles are acute, so the vertex nearest to a direction is a corner of the triangle
that holds it: a k-d tree and at most six candidate faces locate a direction. Vertex
spacing: 16, 8, 4 and 2 degrees at levels 2 to 5."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from arfx.core.numerics import normalise

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

LEVELS = range(6)


@dataclass(frozen=True, eq=False)
class Icosphere:
    """vertices : (v, 3) float64 unit, v = 10 * 4^level + 2;  faces : (20 * 4^level, 3)
    vertex numbers, counter-clockwise
    seen from outside. Arrays are read-only."""

    level: int
    vertices: np.ndarray
    faces: np.ndarray

    @cached_property
    def centres(self) -> np.ndarray:
        """(f, 3) unit, the faces' middles."""
        return normalise(self.vertices[self.faces].mean(1))

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        return cKDTree(self.vertices)

    @cached_property
    def _around(self) -> np.ndarray:
        """(v, 6) faces at each vertex; the first is repeated where there are five."""
        from trimesh import Trimesh

        found = Trimesh(self.vertices, self.faces, process=False).vertex_faces
        return np.where(found < 0, found[:, :1], found)

    @cached_property
    def _inverse(self) -> np.ndarray:
        """(f, 3, 3): direction to the weights of its face's corners, before they are scaled
        to the sum 1.
        """
        return np.linalg.inv(np.swapaxes(self.vertices[self.faces], 1, 2))

    def nearest(self, directions: np.ndarray) -> np.ndarray:
        """(...) number of the nearest vertex for directions (..., 3), which need not be of
        unit length.

        -1 where a direction is zero or not finite."""
        d = normalise(np.asarray(directions, float))
        fine = np.asarray(d.any(-1))
        found = self._tree.query(np.where(fine[..., None], d, self.vertices[0]))[1]
        return np.where(fine, found, -1)

    def locate(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(face (...), weights (..., 3) >= 0 of its corners, sum 1) for directions (..., 3).

        The weights are those of the point where the direction meets the flat face. Face -1
        and weights 0 where a direction is zero or not finite."""
        d = normalise(np.asarray(directions, float))
        shape = d.shape[:-1]
        d = d.reshape(-1, 3)
        near = self.nearest(d)
        faces = self._around[np.maximum(near, 0)]
        weights = np.einsum("nkij,nj->nki", self._inverse[faces], d)
        best = weights.min(-1).argmax(-1)
        rows = np.arange(len(d))
        w = np.clip(weights[rows, best], 0, None)
        total = w.sum(-1, keepdims=True)
        w = np.where((near >= 0)[:, None], w / np.where(total > 0, total, 1), 0)
        return np.where(near >= 0, faces[rows, best], -1).reshape(shape), w.reshape(
            *shape, 3
        )


@lru_cache(maxsize=8)
def icosphere(level: int) -> Icosphere:
    """The icosahedron cut `level` times (0 to 5).

    Raises ValueError beyond. Made once per process.
    """
    if level not in LEVELS:
        raise ValueError(f"icosphere level {level} is not one of 0 to {LEVELS[-1]}")
    from trimesh.creation import icosphere as ball

    mesh = ball(subdivisions=level)
    vertices, faces = normalise(np.array(mesh.vertices)), np.array(mesh.faces)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Icosphere(level, vertices, faces)
