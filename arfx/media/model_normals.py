"""Vertex normals for files that bring none: smooth across edges flatter than an angle, sharp across the others.

Linear in the number of faces: corners that share a vertex are joined across each flat edge, and every joined group
gets one normal, weighted by corner angle (Thuermer and Wuethrich 1998)."""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import angle_between, normalise, same_rows

CREASE_DEG = 40.0


def smooth_by_angle(vertices: np.ndarray, faces: np.ndarray, split: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals by smoothing groups.
    vertices : (n, 3); faces : (m, 3) int, none without area; vertices at the same place count as one
    split : keep vertices apart that the file keeps apart (their texture coordinates or colours differ)
    Returns faces (m, 3) over new vertices, source (k,) the old vertex of each new one, normals (k, 3) unit."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    m = len(faces)
    at = same_rows(vertices)[1][faces]  # (m, 3) place of each corner
    p = vertices[faces]
    normal = normalise(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    corner = np.arange(3 * m).reshape(m, 3)
    # Every edge with the corner at its lower and at its higher place; equal edges lie next to each other when sorted.
    i, j = np.array([0, 1, 2]), np.array([1, 2, 0])
    lo, hi = at[:, i], at[:, j]
    swap = lo > hi
    low, high = np.where(swap, hi, lo).ravel(), np.where(swap, lo, hi).ravel()
    low_corner, high_corner = (
        np.where(swap, corner[:, j], corner[:, i]).ravel(),
        np.where(swap, corner[:, i], corner[:, j]).ravel(),
    )
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    a, b = order[:-1][same], order[1:][same]
    flat = (normal[a // 3] * normal[b // 3]).sum(1) > np.cos(np.radians(CREASE_DEG))
    a, b = a[flat], b[flat]
    rows = np.concatenate([low_corner[a], high_corner[a]])
    cols = np.concatenate([low_corner[b], high_corner[b]])
    graph = coo_matrix((np.ones(len(rows), bool), (rows, cols)), shape=(3 * m, 3 * m))
    count, group = connected_components(graph, directed=False)
    angles = np.stack([angle_between(p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]) for k in range(3)], 1).ravel()
    total = np.stack([np.bincount(group, angles * np.repeat(normal[:, k], 3), count) for k in range(3)], 1)
    normals = normalise(total)
    lost = np.abs(normals).sum(1) == 0  # opposite faces cancel: take one of them
    if lost.any():
        first = np.full(count, 3 * m)
        np.minimum.at(first, group, np.arange(3 * m))
        normals[lost] = normal[first[lost] // 3]
    old = faces.ravel()
    if split:
        first, new = same_rows(np.stack([group, old], 1))
        return new.reshape(m, 3), old[first], normals[group[first]]
    source = np.empty(count, int)
    source[group] = old
    return group.reshape(m, 3), source, normals
