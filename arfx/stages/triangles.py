"""Triangles that rays meet (embree): first hits, blocked rays, and the visible fraction of a set of directions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from arfx.core.numerics import divide
from arfx.core.scene import Scene

_BATCH = 1 << 19  # rays in flight: bounds memory to about 40 MB


class Triangles:
    """corners : (n, 3, 3), metres;  robust : no ray slips between two triangles that share an edge"""

    def __init__(self, corners: np.ndarray, robust: bool = False) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene(robust=robust)
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> Mapping[str, np.ndarray]:
        """primID (-1 = none), u, v, tfar of rays (n, 3)."""
        o, d = np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
        return self._scene.run(o, d, query="INTERSECT", output=True)

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) bool: whether rays (n, 3) meet anything."""
        o, d = np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
        return np.asarray(self._scene.run(o, d, query="OCCLUDED")) >= 0

    def visible_fraction(self, points: np.ndarray, directions: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """(n,) float64, 0..1: of `directions` (k, 3), unit, those in which nothing is met from each point (n, 3).

        normals : (n, 3), directions count by their cosine to them; 1 where all of them are below the surface"""
        out = np.empty(len(points))
        for part, seen in self._unblocked(points, directions):
            if normals is None:
                out[part] = seen.mean(1)
            else:
                weight = np.clip(normals[part] @ directions.T, 0, None)
                out[part] = divide((weight * seen).sum(1), weight.sum(1), where_zero=1.0)
        return out

    def visible_sum(self, points: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(n, c) float64: sum of the weights (k, c) of those `directions` in which nothing is met from each point."""
        out = np.empty((len(points), weights.shape[1]))
        for part, seen in self._unblocked(points, directions):
            out[part] = seen @ weights
        return out

    def _unblocked(self, points: np.ndarray, directions: np.ndarray) -> Iterator[tuple[slice, np.ndarray]]:
        """Points in turn, and for each (m, k) bool whether nothing is met."""
        k, d32 = len(directions), directions.astype(np.float32)
        step = max(_BATCH // k, 1)
        for a in range(0, len(points), step):
            p = points[a : a + step].astype(np.float32)
            met = self.blocked(np.repeat(p, k, axis=0), np.tile(d32, (len(p), 1)))
            yield slice(a, a + len(p)), ~met.reshape(len(p), k)


def model_triangles(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(corners (f, 3, 3) metres, normals of the corners (f, 3, 3), part (f,), face of the part (f,)) of the scene's model in
    anchor axes; triangles that are not finite are left out. Normals have the length that the model's scale gives them."""
    anchor = scene.world_from_anchor.inverse().matrix @ scene.world_from_model
    parts = scene.model.parts
    corners = np.concatenate([(p.vertices @ anchor[:3, :3].T + anchor[:3, 3])[p.faces] for p in parts])
    normals = np.concatenate([(p.normals @ anchor[:3, :3].T)[p.faces] for p in parts])
    part = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])
    face = np.concatenate([np.arange(len(p.faces)) for p in parts])
    good = np.isfinite(corners).all((1, 2))
    return corners[good], normals[good], part[good], face[good]


def disc(n: int) -> np.ndarray:
    """(n, 2) points of equal area on the unit disc (Vogel's spiral)."""
    i = np.arange(n) + 0.5
    r, phi = np.sqrt(i / n), i * np.pi * (3 - np.sqrt(5))
    return np.stack([r * np.cos(phi), r * np.sin(phi)], -1)


def hemisphere(n: int) -> np.ndarray:
    """(n, 3) unit directions around +z whose mean visibility is the cosine-weighted one (Malley's method)."""
    return np.column_stack([disc(n), np.sqrt(1 - (np.arange(n) + 0.5) / n)])
