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

import numpy as np

from arfx.core.numerics import angle_between, divide, normalise, same_rows

CREASE_DEG = 40.0
# Of the two faces of edges (e,), and whether they run along it in opposite ways (e,): across
# which edges their corners belong together (e,)
_Joined = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3 m, 3) unit, of the corners of faces.

    vertices : (n, 3), those at the same place count as one;  faces : (m, 3) int, none without area
    """
    p = vertices[faces]
    flat = normalise(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))

    def joined(a: np.ndarray, b: np.ndarray, _: np.ndarray) -> np.ndarray:
        cosine = (flat[a] * flat[b]).sum(1)
        return np.asarray(cosine > np.cos(np.radians(CREASE_DEG)))

    place = same_rows(vertices)[1][faces]
    out = _smoothed(place, joined, flat[:, None], *_edges(p))
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
    u1, v1 = (t[:, 1] - t[:, 0]).T
    u2, v2 = (t[:, 2] - t[:, 0]).T
    side = np.asarray(np.sign(u1 * v2 - v1 * u2))
    edge1, edge2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    along_u = side[:, None] * (v2[:, None] * edge1 - v1[:, None] * edge2)
    along_u = normalise(divide(along_u, np.abs(along_u).max(1, keepdims=True)))
    side[~along_u.any(1)] = 0  # the picture covers it with no area

    def joined(a: np.ndarray, b: np.ndarray, opposite: np.ndarray) -> np.ndarray:
        return np.asarray(opposite & (side[a] == side[b]) & (side[a] != 0))

    number = same_rows(np.concatenate([vertices, normals, uv], 1))[1]
    ahead, behind = (_in_plane(edge, n) for edge in _edges(p))
    directions = _in_plane(along_u[:, None], n)
    tangents = _smoothed(number[faces], joined, directions, ahead, behind)
    normal = n.reshape(-1, 3)
    anyhow = _in_plane(np.eye(3)[np.abs(normal).argmin(1)], normal)
    tangents = np.where(tangents.any(1, keepdims=True), tangents, anyhow)
    return np.column_stack([tangents, np.repeat(np.where(side == 0, 1.0, side), 3)])


def _edges(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both (m, 3, 3), from the corners of triangles to the next one and the one before."""
    return np.roll(p, -1, 1) - p, np.roll(p, 1, 1) - p


def _smoothed(
    place: np.ndarray,
    joined: _Joined,
    directions: np.ndarray,
    ahead: np.ndarray,
    behind: np.ndarray,
) -> np.ndarray:
    """(3 m, 3) mean directions of the groups of corners, weighted by corner angle.

    place : (m, 3) int, number of each corner's place
    directions : (m, 3, 3) unit, or (m, 1, 3);  ahead, behind : (m, 3, 3) the corners' sides"""
    group = _corner_groups(place, joined)
    weighted = angle_between(ahead, behind)[..., None] * directions
    sums = [np.bincount(group, axis) for axis in weighted.reshape(-1, 3).T]
    return normalise(np.stack(sums, 1))[group]


def _corner_groups(place: np.ndarray, joined: _Joined) -> np.ndarray:
    """(3 m,) of corners that belong together: at one place, with joined edges between them."""
    from trimesh.graph import connected_component_labels

    # Every edge by the corner that it starts from, and that where it ends; sorted, equal ones meet.
    end = np.roll(np.arange(place.size).reshape(-1, 3), -1, 1).ravel()
    places = place.ravel()
    edge = np.sort(np.stack([places, places[end]], 1), 1)
    order = np.lexsort(edge.T[::-1])
    same = (edge[order[1:]] == edge[order[:-1]]).all(1)
    a, b = order[:-1][same], order[1:][same]
    together = joined(a // 3, b // 3, places[a] != places[b])
    a, b = a[together], b[together]
    there = np.where(places[a] != places[b], [end[b], b], [b, end[b]])
    links = np.stack([[a, end[a]], there], -1).reshape(-1, 2)
    return np.asarray(connected_component_labels(links, node_count=place.size))


def _in_plane(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of what of v is across the normal."""
    return normalise(v - normal * (v * normal).sum(-1, keepdims=True))
