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

import numpy as np

from arfx.core.numerics import angle_between, divide, normalise, same_rows
from arfx.core.scene_mesh import across

CREASE_DEG = 40.0


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3 m, 3) unit, of the corners of faces.

    vertices : (n, 3), those at the same place count as one;  faces : (m, 3) int, none without area
    """
    p = vertices[faces]
    flat = normalise(across(p))
    place = same_rows(vertices)[1][faces]
    a, b = _shared_edges(place)
    smooth = (flat[a // 3] * flat[b // 3]).sum(1) > np.cos(np.radians(CREASE_DEG))
    along = flat[:, None]
    out = _smoothed(place, a[smooth], b[smooth], p, along, along)
    # opposite faces cancel: each keeps its own
    return np.where(out.any(1, keepdims=True), out, np.repeat(flat, 3, 0))


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
    (u1, u2), (v1, v2) = (t[:, 1:] - t[:, :1]).T
    side = np.asarray(np.sign(u1 * v2 - v1 * u2))
    edge1, edge2 = np.moveaxis(p[:, 1:] - p[:, :1], 1, 0)
    along_u = side[:, None] * (v2[:, None] * edge1 - v1[:, None] * edge2)
    along_u = normalise(divide(along_u, np.abs(along_u).max(1, keepdims=True)))
    side[~along_u.any(1)] = 0  # the picture covers it with no area
    place = same_rows(np.concatenate([vertices, normals, uv], 1))[1][faces]
    a, b = _shared_edges(place)
    joined = (side[a // 3] * side[b // 3] > 0) & (place.flat[a] != place.flat[b])
    directions = _in_plane(along_u[:, None], n)
    tangents = _smoothed(place, a[joined], b[joined], p, n, directions)
    normal = n.reshape(-1, 3)
    anyhow = _in_plane(np.eye(3)[np.abs(normal).argmin(1)], normal)
    tangents = np.where(tangents.any(1, keepdims=True), tangents, anyhow)
    return np.column_stack([tangents, np.repeat(np.where(side == 0, 1.0, side), 3)])


def _shared_edges(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (e,) and (e,) from which two faces run along one edge, each towards its next corner.

    place : (m, 3) int, number of each corner's place"""
    edge = np.sort(np.stack([place, np.roll(place, -1, 1)], -1).reshape(-1, 2), 1)
    order = np.lexsort(edge.T[::-1])
    same = (edge[order[1:]] == edge[order[:-1]]).all(1)  # sorted, equal ones meet
    return order[:-1][same], order[1:][same]


def _smoothed(
    place: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    p: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
) -> np.ndarray:
    """(3 m, 3) mean directions of corners that belong together, weighted by corner angle.

    place : as of `_shared_edges`;  a, b : those edges across which corners belong together
    p : (m, 3, 3);  normals : (m, 3, 3) or (m, 1, 3);  directions : likewise, unit"""
    from trimesh.graph import connected_component_labels

    end = np.roll(np.arange(place.size).reshape(-1, 3), -1, 1).ravel()
    opposite = place.flat[a] != place.flat[b]
    there = np.where(opposite, [end[b], b], [b, end[b]])
    links = np.stack([[a, end[a]], there], -1).reshape(-1, 2)
    group = connected_component_labels(links, node_count=place.size)
    # turned by a quarter, in the plane of the normals
    sides = (np.cross(normals, np.roll(p, k, 1) - p) for k in (-1, 1))
    weighted = angle_between(*sides)[..., None] * directions
    sums = [np.bincount(group, axis) for axis in weighted.reshape(-1, 3).T]
    return normalise(np.stack(sums, 1))[group]


def _in_plane(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))
