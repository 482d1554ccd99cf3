"""Triangles that rays meet (embree): first hits, blocked rays, and the visible fraction of
a set of directions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numba
import numpy as np

from arfx.core.numerics import divide
from arfx.core.parallel import parallel_map
from arfx.core.scene import Scene
from arfx.core.scene_mesh import SceneMesh, flatten

_BATCH = 1 << 19  # rays in flight: bounds memory to about 40 MB
_SLACK = 1e-4  # of the extent, around the box outside which nothing is met


class Triangles:
    """corners : (n, 3, 3), metres;  robust : no ray slips between two triangles that share
    an edge
    """

    def __init__(self, corners: np.ndarray, robust: bool = False) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene(robust=robust)
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))
        low, high = (
            (corners.min((0, 1)), corners.max((0, 1)))
            if len(corners)
            else (np.ones(3), -np.ones(3))
        )
        slack = _SLACK * np.abs(high - low).max()
        self._box = np.array([low - slack, high + slack], np.float32)

    def first_hits(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> Mapping[str, np.ndarray]:
        """primID (-1 = none), u, v, tfar of rays (n, 3)."""
        o, d = (
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
        )
        return self._scene.run(o, d, query="INTERSECT", output=True)

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) bool: whether rays (n, 3) meet anything."""
        o, d = (
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
        )
        return np.asarray(self._scene.run(o, d, query="OCCLUDED")) >= 0

    def visible_fraction(
        self,
        points: np.ndarray,
        directions: np.ndarray,
        normals: np.ndarray | None = None,
        first: int = 1,
    ) -> np.ndarray:
        """(n,) float64, 0..1: of `directions` (k, 3), unit, those in which nothing is met
        from each point (n, 3).

        normals : (n, 3), directions count by their cosine to them; 1 where all of them are
        below the surface
        first : every so manieth direction is asked first, the others where those do not agree
        """
        if first > 1:
            out = self.visible_fraction(points, directions[first // 2 :: first], normals)
            mixed = (out > 0) & (out < 1)
            out[mixed] = self.visible_fraction(
                points[mixed], directions, None if normals is None else normals[mixed]
            )
            return out

        k, towards = len(directions), directions.astype(np.float32)

        def one(part: slice) -> np.ndarray:
            p = points[part].astype(np.float32)
            starts, along, number = (
                np.empty((len(p) * k, *more), kind) for more, kind in _RAYS
            )
            count = _through_box(p, towards, self._box, starts, along, number)
            seen = np.ones((len(p), k), bool)
            seen.flat[number[:count][self.blocked(starts[:count], along[:count])]] = False
            if normals is None:
                return np.asarray(seen.mean(1))
            weight = np.clip(normals[part] @ directions.T, 0, None)
            return divide((weight * seen).sum(1), weight.sum(1), where_zero=1.0)

        step = max(_BATCH // k, 1)
        parts = [slice(a, a + step) for a in range(0, len(points), step)]
        return np.concatenate([np.zeros(0), *parallel_map(one, parts)])


_RAYS = (((3,), np.float32), ((3,), np.float32), ((), np.int64))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _through_box(
    points, directions, box, starts, along, number
):  # pragma: no cover - compiled
    """How many of the rays from points (n, 3) in directions (k, 3) pass through a box (2,
    3): those, and their numbers, are written to the other arrays."""
    count, k, zero, far = 0, len(directions), np.float32(0), np.float32(1e30)
    for i in range(len(points)):
        for j in range(k):
            enters, leaves = zero, far
            for c in range(3):
                d = directions[j, c]
                inverse = np.float32(1) / d if d != zero else far
                a, b = (
                    (box[0, c] - points[i, c]) * inverse,
                    (box[1, c] - points[i, c]) * inverse,
                )
                enters, leaves = max(enters, min(a, b)), min(leaves, max(a, b))
            if enters <= leaves:
                for c in range(3):
                    starts[count, c], along[count, c] = points[i, c], directions[j, c]
                number[count] = i * k + j
                count += 1
    return count


def anchor_mesh(scene: Scene) -> SceneMesh:
    """The scene's model in anchor axes."""
    anchor_from_world = scene.world_from_anchor.inverse().matrix
    return flatten(scene.model, anchor_from_world @ scene.world_from_model)
