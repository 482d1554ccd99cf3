"""Directions in even steps: the icosahedron, its faces cut into four again and again, all
vertices on the unit sphere.

Vertex spacing: 16, 8, 4 and 2 degrees at levels 2 to 5."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from arfx.core.numerics import normalise, same_rows

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class Icosphere:
    """vertices : (v, 3) float64 unit, v = 10 * 4^level + 2;  faces : (20 * 4^level, 3)
    vertex numbers, counter-clockwise
    seen from outside. Arrays are read-only."""

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

    def nearest(self, directions: np.ndarray) -> np.ndarray:
        """(...) number of the nearest vertex for directions (..., 3), which need not be of
        unit length.

        -1 where a direction is zero or not finite."""
        d = normalise(np.asarray(directions, float))
        fine = np.asarray(d.any(-1))
        found = self._tree.query(np.where(fine[..., None], d, self.vertices[0]))[1]
        return np.where(fine, found, -1)


@lru_cache(maxsize=8)
def icosphere(level: int) -> Icosphere:
    """The icosahedron cut `level` times. Made once per process.

    Not trimesh's: its import takes half a second of every job."""
    vertices, faces = _cut(icosphere(level - 1)) if level else _icosahedron()
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Icosphere(vertices, faces)


def _icosahedron() -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial import ConvexHull

    golden = (1 + np.sqrt(5)) / 2
    corners = [(i, j * golden, 0.0) for j in (1, -1) for i in (-1, 1)]
    vertices = normalise(np.array([np.roll(c, k) for k in range(3) for c in corners]))
    faces = ConvexHull(vertices).simplices.astype(int)
    inwards = np.linalg.det(vertices[faces]) < 0
    faces[inwards] = faces[inwards, ::-1]
    return vertices, faces


def _cut(coarse: Icosphere) -> tuple[np.ndarray, np.ndarray]:
    """Each face in four, at the middles of its sides."""
    old, (a, b, c) = coarse.vertices, coarse.faces.T
    sides = np.sort(np.stack([(a, b), (b, c), (c, a)]), 1)
    rows = sides.transpose(2, 0, 1).reshape(-1, 2)
    first, which = same_rows(rows)
    ab, bc, ca = which.reshape(-1, 3).T + len(old)
    faces = np.stack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)], 1)
    return np.concatenate([old, normalise(old[rows[first]].sum(1))]), faces.reshape(3, -1).T
