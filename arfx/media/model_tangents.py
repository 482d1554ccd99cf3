"""Tangents of vertices that a normal texture needs, where a file brings none: those of MikkTSpace.

glTF 2.0 section 3.7.2.1 asks for them: programs that bake normal textures use them too. Corners
of one vertex (same place, normal and texture coordinates) are joined across edges to faces that
the picture covers the same way round. Each group gets the mean of its faces' directions along the
picture's rows, laid into the plane of the vertex normal and weighted by corner angle.
Source: Mikkelsen 2008, Simulation of Wrinkled Surfaces Revisited, chapter 2.

Leaves out: a face that the picture covers with no area joins no group (in MikkTSpace it takes after
the neighbour that comes first); its corners take after another corner of the vertex."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from arfx.core.model import Part
from arfx.core.numerics import angle_between, divide, normalise, same_rows
from arfx.media.model_normals import corner_groups, split_corners


def with_tangents(part: Part) -> Part:
    """The part with tangents if its material has a normal texture, with none if not.

    Tangents of the file are kept; for new ones vertices are split where they differ."""
    texture = part.material.normal_texture or part.material.clearcoat_normal_texture
    uv = None if texture is None else part.uv_on(texture)
    if uv is None:
        return replace(part, tangents=None)
    if part.tangents is not None:
        return part
    tangents = corner_tangents(part.vertices, part.faces, part.normals, uv)
    first, group = same_rows(tangents)
    faces, source, of_group = split_corners(part.faces, group)
    return Part(
        part.vertices[source],
        faces.astype(np.int32),
        part.normals[source],
        part.material,
        None if part.uv is None else part.uv[source],
        None if part.colours is None else part.colours[source],
        None if part.second_uv is None else part.second_uv[source],
        tangents[first[of_group]],
    )


def corner_tangents(
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    uv: np.ndarray,
) -> np.ndarray:
    """(3 m, 4) of the corners of faces (m, 3), as of core.model.Part.

    vertices : (n, 3);  normals : (n, 3) unit;  uv : (n, 2) on the normal texture, v = 0 on top"""
    p, n = vertices[faces], normals[faces]
    t = uv[faces] * (1, -1)  # v upwards, as the sign of a tangent counts it
    along, up = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    area = along[:, 0] * up[:, 1] - along[:, 1] * up[:, 0]
    side = np.asarray(np.sign(area))
    across = up[:, 1:] * (p[:, 1] - p[:, 0]) - along[:, 1:] * (p[:, 2] - p[:, 0])
    across = normalise(divide(side[:, None] * across, np.abs(across).max(1, keepdims=True)))
    covered = np.asarray(across.any(1))

    def joined(a: np.ndarray, b: np.ndarray, opposite: np.ndarray) -> np.ndarray:
        return np.asarray(opposite & (side[a] == side[b]) & covered[a] & covered[b])

    vertex = same_rows(np.concatenate([vertices, normals, uv], 1))[1][faces]
    count, group = corner_groups(vertex, joined)
    ahead, behind = (_in_plane(np.roll(p, -k, 1) - p, n) for k in (1, 2))
    weight = angle_between(ahead, behind) * covered[:, None]
    parts = (weight[..., None] * _in_plane(across[:, None], n)).reshape(-1, 3)
    sums = np.stack([np.bincount(group, parts[:, k], count) for k in range(3)], 1)
    tangents = normalise(sums)[group]
    signed = np.column_stack([tangents, np.repeat(side, 3)])
    return _filled(signed, vertex.ravel(), n.reshape(-1, 3))


def _in_plane(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))


def _filled(tangents: np.ndarray, vertex: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Corners without a tangent take that of another corner of their vertex, else any across the
    normal."""
    has = tangents[:, :3].any(1) & (tangents[:, 3] != 0)
    across = _in_plane(np.eye(3)[np.abs(normals).argmin(1)], normals)
    out = np.where(has[:, None], tangents, np.column_stack([across, np.ones(len(across))]))
    other = np.full(vertex.max() + 1, -1)
    other[vertex[has]] = np.flatnonzero(has)
    lacking = np.flatnonzero(~has & (other[vertex] >= 0))
    out[lacking] = out[other[vertex[lacking]]]
    return out
