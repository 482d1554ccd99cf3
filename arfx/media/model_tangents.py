"""Tangents of vertices that a normal texture needs, where a file brings none: those of MikkTSpace.

glTF 2.0 section 3.7.2.1 asks for them: programs that bake normal textures use them too. Corners
of one vertex (same place, normal and texture coordinates) are joined across edges to faces that
the picture covers the same way round. Each group gets the mean of its faces' directions along the
picture's rows, laid into the plane of the vertex normal and weighted by corner angle.
Source: Mikkelsen 2008, Simulation of Wrinkled Surfaces Revisited, chapter 2.

Leaves out: a face that the picture covers with no area joins no group, its tangents lie anyhow
across the normals (in MikkTSpace it takes after the neighbour that comes first)."""

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
    names = ("vertices", "normals", "uv", "second_uv", "colours")
    given = {name: getattr(part, name) for name in names}
    rows = {name: values[source] for name, values in given.items() if values is not None}
    rows["tangents"] = tangents[first[of_group]]
    return Part(faces=faces.astype(np.int32), material=part.material, **rows)


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
    normal = n.reshape(-1, 3)
    any_way = _in_plane(np.eye(3)[np.abs(normal).argmin(1)], normal)
    lacking = ~(tangents.any(1) & np.repeat(covered, 3))
    signed[lacking] = np.column_stack([any_way, np.ones(len(normal))])[lacking]
    return signed


def _in_plane(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))
