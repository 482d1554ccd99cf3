"""Triangles that rays meet (embree): first hits, blocked rays, and the visible fraction of a set of directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from arfx.core.numerics import divide

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

        normals : (n, 3), directions count by their cosine to them; 1 where all of them are below the surface
        """
        k = len(directions)
        out = np.empty(len(points))
        step = max(_BATCH // k, 1)
        d32 = directions.astype(np.float32)
        for a in range(0, len(points), step):
            p = points[a : a + step].astype(np.float32)
            seen = ~self.blocked(np.repeat(p, k, axis=0), np.tile(d32, (len(p), 1))).reshape(len(p), k)
            if normals is None:
                out[a : a + step] = seen.mean(1)
            else:
                weight = np.clip(normals[a : a + step] @ directions.T, 0, None)
                out[a : a + step] = divide((weight * seen).sum(1), weight.sum(1), where_zero=1.0)
        return out


def _spiral(n: int) -> tuple[np.ndarray, np.ndarray]:
    """n points of equal area on the unit disc: radius squared and angle (Vogel's spiral)."""
    i = np.arange(n) + 0.5
    return i / n, i * np.pi * (3 - np.sqrt(5))


def hemisphere(n: int) -> np.ndarray:
    """(n, 3) unit directions around +z whose mean visibility is the cosine-weighted one (Malley's method)."""
    r2, phi = _spiral(n)
    r = np.sqrt(r2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - r2)], -1)
