"""Triangles that rays meet (embree): first hits, blocked rays, and the visible fraction of
a set of directions.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide
from arfx.core.parallel import parallel_map
from arfx.core.scene import Scene
from arfx.core.scene_mesh import SceneMesh, flatten

_BATCH = 1 << 19  # rays in flight: bounds memory to about 40 MB


class Triangles:
    """corners : (n, 3, 3), metres;  robust : no ray slips between two triangles that share
    an edge
    """

    def __init__(self, corners: ndarray, robust: bool = False) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene(robust=robust)
        self._mesh = TriangleMesh(
            self._scene, np.ascontiguousarray(corners, np.float32)
        )

    def first_hits(
        self, origins: ndarray, directions: ndarray
    ) -> Mapping[str, ndarray]:
        """primID (-1 = none), u, v, tfar of rays (n, 3)."""
        found: Mapping[str, ndarray] = self._asked(
            origins, directions, query="INTERSECT", output=True
        )
        return found

    def blocked(self, origins: ndarray, directions: ndarray) -> ndarray:
        """(n,) bool: whether rays (n, 3) meet anything."""
        return np.asarray(self._asked(origins, directions, query="OCCLUDED")) >= 0

    def _asked(self, *rays: ndarray, **query: Any) -> Any:
        parts = (np.ascontiguousarray(a, np.float32) for a in rays)
        return self._scene.run(*parts, **query)

    def visible_fraction(
        self,
        points: ndarray,
        directions: ndarray,
        normals: ndarray | None = None,
        first: int = 1,
    ) -> ndarray:
        """(n,) float64, 0..1: of `directions` (k, 3), unit, those in which nothing is met
        from each point (n, 3).

        normals : (n, 3), directions count by their cosine to them; 1 where all of them are
        below the surface
        first : every so manieth direction is asked first, the others where those do not agree
        """
        if first > 1:
            out = self.visible_fraction(
                points, directions[first // 2 :: first], normals
            )
            mixed = (out > 0) & (out < 1)
            out[mixed] = self.visible_fraction(
                points[mixed], directions, None if normals is None else normals[mixed]
            )
            return out

        k = len(directions)

        def one(part: slice) -> ndarray:
            starts = np.repeat(points[part], k, 0)
            along = np.tile(directions, (len(starts) // k, 1))
            seen = ~self.blocked(starts, along).reshape(-1, k)
            if normals is None:
                return np.asarray(seen.mean(1))
            weight = np.clip(normals[part] @ directions.T, 0, None)
            return divide((weight * seen).sum(1), weight.sum(1), where_zero=1.0)

        step = max(_BATCH // k, 1)
        parts = [slice(a, a + step) for a in range(0, len(points), step)]
        return np.concatenate([np.zeros(0), *parallel_map(one, parts)])


def anchor_mesh(scene: Scene) -> SceneMesh:
    """The scene's model in anchor axes."""
    anchor_from_world = scene.world_from_anchor.inverse().matrix
    return flatten(scene.model, anchor_from_world @ scene.world_from_model)
