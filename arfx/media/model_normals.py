"""Vertex normals for files that bring none: smooth across flat edges, sharp across the others.

Linear in the number of faces: corners that share a vertex are joined across each flat edge, and
every joined group gets one normal, weighted by corner angle (Thuermer and Wuethrich 1998).

Tangents of vertices that a normal texture needs, where a file brings none: those of MikkTSpace.

glTF 2.0 section 3.7.2.1 asks for them: programs that bake normal textures use them too. Corners
of one vertex (same place, normal and texture coordinates) are joined across edges to faces that
the picture covers the same way round. Each group gets the mean of its faces' directions along the
picture's rows, laid into the plane of the vertex normal and weighted by corner angle.
Source: Mikkelsen 2008, Simulation of Wrinkled Surfaces Revisited, chapter 2.

Leaves out: a face that the picture covers with no area joins no group, its tangents lie anyhow
across the normals (in MikkTSpace it takes after the neighbour that comes first)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from arfx.core.model import Part
from arfx.core.numerics import angle_between, divide, normalise, same_rows

CREASE_DEG = 40.0


def smooth_by_angle(
    vertices: np.ndarray,
    faces: np.ndarray,
    split: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals by smoothing groups.

    vertices : (n, 3), those at the same place count as one;  faces : (m, 3) int, none without area
    split : keep vertices apart that the file keeps apart (their coordinates or colours differ)
    Returns faces (m, 3) over new vertices, source (k,) the old vertex of each new one, and
    normals (k, 3) unit."""
    m = len(faces)
    place = same_rows(vertices)[1][faces]
    p = vertices[faces]
    edge, other_edge = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = normalise(np.cross(edge, other_edge))

    def flat(a: np.ndarray, b: np.ndarray, _: np.ndarray) -> np.ndarray:
        cosine = (normal[a] * normal[b]).sum(1)
        return np.asarray(cosine > np.cos(np.radians(CREASE_DEG)))

    count, group = corner_groups(place, flat)
    ahead = np.roll(p, -1, 1) - p
    behind = np.roll(p, -2, 1) - p
    weight = angle_between(ahead, behind)[..., None]
    normals = normalise(sums_by_group(weight * normal[:, None], group, count))
    lost = np.abs(normals).sum(1) == 0  # opposite faces cancel: take one of them
    if lost.any():
        first = np.full(count, 3 * m)
        np.minimum.at(first, group, np.arange(3 * m))
        normals[lost] = normal[first[lost] // 3]
    new_faces, first, of_group = split_corners(faces if split else place, group)
    return new_faces, faces.ravel()[first], normals[of_group]


def corner_groups(
    place: np.ndarray,
    joined: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
) -> tuple[int, np.ndarray]:
    """Corners of triangles that belong together: at one place, with joined edges between them.

    place : (m, 3) int, number of each corner's place
    joined : of the two faces of edges (e,), and whether they run along it in opposite ways (e,),
        tells (e,) across which edges their corners belong together
    Returns how many groups there are, and (3 m,) the group of each corner."""
    from trimesh.graph import connected_component_labels

    # Every edge by the corner that it starts from, and that where it ends; sorted, equal ones meet.
    start = np.arange(place.size)
    end = np.roll(start.reshape(-1, 3), -1, 1).ravel()
    places = place.ravel()
    edge = np.sort(np.stack([places, places[end]], 1), 1)
    order = np.lexsort(edge.T[::-1])
    same = (edge[order[1:]] == edge[order[:-1]]).all(1)
    a, b = order[:-1][same], order[1:][same]
    opposite = places[a] != places[b]
    together = joined(a // 3, b // 3, opposite)
    a, b, opposite = a[together], b[together], opposite[together]
    first = np.stack([a, np.where(opposite, end[b], b)], 1)
    second = np.stack([end[a], np.where(opposite, b, end[b])], 1)
    links = np.concatenate([first, second])
    group = connected_component_labels(links, node_count=place.size)
    return int(group.max()) + 1, group


def sums_by_group(vectors: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) of vectors (m, 3, 3) of corners, by their group (3 m,)."""
    flat = vectors.reshape(-1, 3)
    return np.stack([np.bincount(group, axis, count) for axis in flat.T], 1)


def split_corners(
    faces: np.ndarray,
    group: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of which each belongs to one group of corners alone.

    faces : (m, 3) int;  group : (3 m,) int
    Returns faces (m, 3) over new vertices, and of each the first corner (k,) and the group (k,).
    """
    first, new = same_rows(np.stack([group, faces.ravel()], 1))
    return new.reshape(-1, 3), first, group[first]


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
    faces, corner, of_group = split_corners(part.faces, group)
    source = part.faces.ravel()[corner]
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
