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
from arfx.media.model_normals import corner_groups, split_corners, sums_by_group


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

    vertices : (n, 3);  normals : (n, 3) unit;  uv : (n, 2) on the normal texture, v = 0 on top
    """
    p, n = vertices[faces], normals[faces]
    t = uv[faces] * (1, -1)  # v upwards, as the sign of a tangent counts it
    u1, v1 = (t[:, 1] - t[:, 0]).T
    u2, v2 = (t[:, 2] - t[:, 0]).T
    side = np.asarray(np.sign(u1 * v2 - v1 * u2))
    edge1, edge2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    along_u = side[:, None] * (v2[:, None] * edge1 - v1[:, None] * edge2)
    size = np.abs(along_u).max(1, keepdims=True)
    along_u = normalise(divide(along_u, size))
    covered = np.asarray(along_u.any(1))

    def joined(a: np.ndarray, b: np.ndarray, opposite: np.ndarray) -> np.ndarray:
        alike = (side[a] == side[b]) & covered[a] & covered[b]
        return np.asarray(opposite & alike)

    _, number = same_rows(np.concatenate([vertices, normals, uv], 1))
    count, group = corner_groups(number[faces], joined)
    ahead = _in_plane(np.roll(p, -1, 1) - p, n)
    behind = _in_plane(np.roll(p, -2, 1) - p, n)
    weight = angle_between(ahead, behind)[..., None]
    directions = _in_plane(along_u[:, None], n)
    tangents = normalise(sums_by_group(weight * directions, group, count))[group]
    normal = n.reshape(-1, 3)
    least = np.abs(normal).argmin(1)
    lacking = ~tangents.any(1)
    tangents[lacking] = _in_plane(np.eye(3)[least], normal)[lacking]
    signs = np.where(side == 0, 1.0, side)
    return np.column_stack([tangents, np.repeat(signs, 3)])


def _in_plane(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))
