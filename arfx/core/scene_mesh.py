"""The one flattening of a model: all its parts as one set of triangles in world axes."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.model import Material, Model
from arfx.core.numerics import normalise, same_rows

_CREASE_COS = np.cos(
    np.radians(20.0)
)  # edges sharper than this are visible inside the silhouette


class Edges(NamedTuple):
    """Edges between positions.

    vertices : (e, 2) int32, its ends;  faces : (e, 2) int32, its sides, the second -1 where
    there is
    one alone. An edge of more than two faces is listed once for each, as an edge of that face alone
    sharp : (e,) bool, it shows from whatever side it is seen"""

    vertices: ndarray
    faces: ndarray
    sharp: ndarray


@dataclass(frozen=True, eq=False)
class SceneMesh:
    """Triangles of all parts together, metres. Positions are relative to `centre_m`, which keeps
    float32 exact enough.

    centre_m : (3,) float64, world
    vertices : (n, 3) float64;  normals : (n, 3) float32;  colours : (n, 4) float32, linear RGBA
    uv : (n, 4) float32, both sets of texture coordinates, v = 0 at a picture's top row
    has_uv : (p, 2) bool, which of them a part has;  tangents : (n, 4) float32 as of `Part`, else 0
    faces : (m, 3) int32;  part : (m,) int32, of each face;  face_normal : (m, 3) float32, unit
    materials : of each part
    """

    centre_m: ndarray
    vertices: ndarray
    normals: ndarray
    colours: ndarray
    uv: ndarray
    has_uv: ndarray
    tangents: ndarray
    faces: ndarray
    part: ndarray
    face_normal: ndarray
    materials: tuple[Material, ...]

    @cached_property
    def corners_m(self) -> ndarray:
        """(m, 3, 3) float64, corners of the faces, relative to `centre_m`."""
        return np.asarray(self.vertices[self.faces])

    @cached_property
    def hidden_behind(self) -> ndarray:
        """(m,) bool, faces that are not shown from behind."""
        one_sided = [not material.double_sided for material in self.materials]
        return np.array(one_sided, bool)[self.part]

    @cached_property
    def edges(self) -> Edges:
        """Of faces that may join in any way."""
        return _edges(self)


def across(corners: ndarray) -> ndarray:
    """(m, 3) out of triangles (m, 3, 3), as long as twice their area."""
    return np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0))


def flatten(model: Model, world_from_model: ndarray) -> SceneMesh:
    """world_from_model : (4, 4), rigid times a uniform scale"""
    linear, shift_m = world_from_model[:3, :3], world_from_model[:3, 3]
    rotation = linear / np.cbrt(abs(np.linalg.det(linear)))
    parts = model.parts
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    centre = model.bounds.mean(0) @ linear.T + shift_m
    vertices = np.concatenate(
        [p.vertices @ linear.T + shift_m - centre for p in parts]
    )
    faces = np.concatenate([p.faces + n for p, n in zip(parts, starts, strict=False)])

    def rows(name: str, otherwise: ndarray) -> ndarray:
        """Of all parts end to end; `otherwise` for each vertex of a part that has none."""
        given = [(getattr(p, name), len(p.vertices)) for p in parts]
        return np.concatenate(
            [np.tile(otherwise, (n, 1)) if own is None else own for own, n in given]
        )

    none = np.zeros(2)
    tangents = rows("tangents", np.zeros(4))
    tangents[:, :3] = tangents[:, :3] @ rotation.T
    return SceneMesh(
        centre_m=centre,
        vertices=vertices,
        normals=(rows("normals", np.zeros(3)) @ rotation.T).astype(np.float32),
        colours=rows("colours", np.ones(4)).astype(np.float32),
        uv=np.column_stack([rows("uv", none), rows("second_uv", none)]).astype("f4"),
        has_uv=np.array([(p.uv is not None, p.second_uv is not None) for p in parts]),
        tangents=tangents.astype(np.float32),
        faces=faces.astype(np.int32),
        part=np.repeat(
            np.arange(len(parts), dtype=np.int32), [len(p.faces) for p in parts]
        ),
        face_normal=normalise(across(vertices[faces])).astype(np.float32),
        materials=tuple(p.material for p in parts),
    )


def _edges(mesh: SceneMesh) -> Edges:
    first, position = same_rows(mesh.vertices.astype(np.float32))
    corner = position[mesh.faces]
    # from first corners to second ones, from second to third, from third to first
    ends = np.stack([corner, np.roll(corner, -1, 1)]).T.reshape(-1, 2)
    ends = np.sort(ends, axis=1)
    owner = np.tile(np.arange(len(mesh.faces)), 3)
    one, edge = same_rows(ends)
    other = one.copy()
    other[edge] = np.arange(len(edge))  # the last of each
    count = np.bincount(edge)
    a, b = owner[one[count == 2]], owner[other[count == 2]]
    flat = (mesh.face_normal[a] * mesh.face_normal[b]).sum(1) > _CREASE_COS
    order = np.argsort(edge, kind="stable")
    alone = order[count[edge[order]] != 2]
    single = np.stack([owner[alone], np.full(len(alone), -1)], 1)
    sides = np.concatenate([np.stack([a, b], 1), single])
    sharp = np.r_[~flat | (mesh.part[a] != mesh.part[b]), np.ones(len(alone), bool)]
    vertices = first[ends[np.r_[one[count == 2], alone]]]
    return Edges(vertices.astype(np.int32), sides.astype(np.int32), sharp)
