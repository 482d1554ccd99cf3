"""Visibility of directions past the model, by rays (embree), and fixed sets of directions to ask for."""

from __future__ import annotations

import numpy as np

_BATCH = 1 << 19  # rays in flight: bounds memory to about 30 MB


class Occluder:
    """Triangles that block light. vertices : (n, 3) float, metres; faces : (m, 3) int."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene()
        triangles = np.ascontiguousarray(vertices[faces].astype(np.float32))
        self._mesh = TriangleMesh(self._scene, triangles)

    def visible_share(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) float64, 0..1: the share of `directions` (k, 3), unit, in which nothing is met from each point (n, 3)."""
        k = len(directions)
        out = np.empty(len(points))
        step = max(_BATCH // k, 1)
        d32 = directions.astype(np.float32)
        for a in range(0, len(points), step):
            p = points[a : a + step].astype(np.float32)
            origins = np.repeat(p, k, axis=0)
            hit = self._scene.run(origins, np.tile(d32, (len(p), 1)), query="OCCLUDED")
            out[a : a + step] = (np.asarray(hit).reshape(len(p), k) < 0).mean(1)
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
