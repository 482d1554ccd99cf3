"""Rays past the model (embree): for the ambient light, for penumbrae and for the object's shadow on itself."""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import divide
from arfx.stages.lightmap.caster import Caster
from arfx.stages.occlusion import Occluder

_BATCH = 1 << 19  # rays in flight: bounds memory to about 40 MB


class Rays(Occluder):
    """The caster's triangles, anchor axes."""

    def __init__(self, caster: Caster) -> None:
        super().__init__(caster.vertices, caster.faces)

    def weighted_share(self, points: np.ndarray, normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) float64, 0..1: visible share of `directions` (k, 3), unit, weighted by their cosine to the normals (n, 3);
        1 where all of them are below the surface."""
        k = len(directions)
        out = np.empty(len(points))
        d32, step = directions.astype(np.float32), max(_BATCH // k, 1)
        for a in range(0, len(points), step):
            p = points[a : a + step].astype(np.float32)
            weight = np.clip(normals[a : a + step] @ directions.T, 0, None)
            hit = self._scene.run(np.repeat(p, k, axis=0), np.tile(d32, (len(p), 1)), query="OCCLUDED")
            seen = np.asarray(hit).reshape(len(p), k) < 0
            out[a : a + step] = divide((weight * seen).sum(1), weight.sum(1), where_zero=1.0)
        return out
