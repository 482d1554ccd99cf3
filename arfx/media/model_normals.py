"""Vertex normals for files that bring none: smooth across flat edges, sharp across the others.

Linear in the number of faces: corners that share a vertex are joined across each flat edge, and
every joined group gets one normal, weighted by corner angle (Thuermer and Wuethrich 1998)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arfx.core.numerics import angle_between, normalise, same_rows

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
    normal = normalise(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))

    def flat(a: np.ndarray, b: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.asarray((normal[a] * normal[b]).sum(1) > np.cos(np.radians(CREASE_DEG)))

    count, group = corner_groups(place, flat)
    angles = angle_between(np.roll(p, -1, 1) - p, np.roll(p, -2, 1) - p).ravel()
    sums = [np.bincount(group, angles * np.repeat(normal[:, k], 3), count) for k in range(3)]
    normals = normalise(np.stack(sums, 1))
    lost = np.abs(normals).sum(1) == 0  # opposite faces cancel: take one of them
    if lost.any():
        first = np.full(count, 3 * m)
        np.minimum.at(first, group, np.arange(3 * m))
        normals[lost] = normal[first[lost] // 3]
    old = faces.ravel()
    if split:
        new_faces, source, of_group = split_corners(faces, group)
        return new_faces, source, normals[of_group]
    source = np.empty(count, int)
    source[group] = old
    return group.reshape(m, 3), source, normals


def corner_groups(
    place: np.ndarray,
    joined: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
) -> tuple[int, np.ndarray]:
    """Corners of triangles that belong together: at one place, with joined edges between them.

    place : (m, 3) int, number of each corner's place
    joined : of the two faces of edges (e,), and whether they run along it in opposite ways (e,),
        tells (e,) across which edges their corners belong together
    Returns how many groups there are, and (3 m,) the group of each corner."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    m = len(place)
    corner = np.arange(3 * m).reshape(m, 3)
    # Every edge with the corner at its lower and at its higher place; sorted, equal ones meet.
    i, j = np.array([0, 1, 2]), np.array([1, 2, 0])
    lo, hi = place[:, i], place[:, j]
    swap = lo > hi
    low, high = np.where(swap, hi, lo).ravel(), np.where(swap, lo, hi).ravel()
    low_corner = np.where(swap, corner[:, j], corner[:, i]).ravel()
    high_corner = np.where(swap, corner[:, i], corner[:, j]).ravel()
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    a, b = order[:-1][same], order[1:][same]
    together = joined(a // 3, b // 3, swap.ravel()[a] != swap.ravel()[b])
    a, b = a[together], b[together]
    rows = np.concatenate([low_corner[a], high_corner[a]])
    cols = np.concatenate([low_corner[b], high_corner[b]])
    graph = coo_matrix((np.ones(len(rows), bool), (rows, cols)), shape=(3 * m, 3 * m))
    count, group = connected_components(graph, directed=False)
    return int(count), group


def split_corners(
    faces: np.ndarray,
    group: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of which each belongs to one group of corners alone.

    faces : (m, 3) int;  group : (3 m,) int
    Returns faces (m, 3) over new vertices, and of each the old vertex and the group, (k,) both."""
    old = faces.ravel()
    first, new = same_rows(np.stack([group, old], 1))
    return new.reshape(-1, 3), old[first], group[first]
