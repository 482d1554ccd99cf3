"""Which pixels need more than one sample: those that an outline or a sharp edge of the model passes through.

Outlines come from the geometry, so that features thinner than a pixel are not missed; what geometry does not tell
(cut-outs, parts that pass through each other) comes from differences between neighbouring samples.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.rect import Rect
from arfx.stages.raster.mesh import Mesh

_POINTS_PER_PX = 1.5
_MAX_POINTS = 400_000  # along all edges of a frame: bounds time and memory where the camera is inside the model
# An edge this much behind the surface that the centre sees, as a share of its depth, is hidden. Outlines always lie
# behind: the surface beside them is seen at a grazing angle.
_BEHIND = 2e-2


def edge_pixels(mesh: Mesh, camera: Camera, points: np.ndarray, front: np.ndarray, rect: Rect, depth: np.ndarray) -> np.ndarray:
    """(h, w) bool, pixels of `rect` that a visible outline or sharp edge crosses.

    points : (n, 3) vertices in camera coordinates;  front : (m,) bool, face seen from its front
    depth : (h, w) metres at the pixel centres
    """
    mask = np.zeros((rect.height, rect.width), bool)
    e = mesh.edges[_shown(mesh.edges, mesh.sharp, front, mesh.hidden)]
    e = e[(points[e[:, 0], 2] > EPS_DEPTH_M) & (points[e[:, 1], 2] > EPS_DEPTH_M)]
    if not len(e):
        return mask
    a, b = points[e[:, 0]], points[e[:, 1]]
    na, nb = a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:]
    inside = _meets(camera, rect, na, nb)
    a, b, na, nb = a[inside], b[inside], na[inside], nb[inside]
    length = np.abs((nb - na) * [camera.fx, camera.fy]).max(1)
    steps = np.minimum(np.ceil(length * _POINTS_PER_PX), 4.0 * (rect.width + rect.height)).astype(int) + 1
    if steps.sum() > _MAX_POINTS:
        steps = np.maximum((steps * (_MAX_POINTS / steps.sum())).astype(int), 1)
    of = np.repeat(np.arange(len(steps)), steps)
    t = (np.arange(len(of)) - np.repeat(np.cumsum(steps) - steps, steps) + 0.5) / np.repeat(steps, steps)
    t = t[:, None]
    xy = na[of] * (1 - t) + nb[of] * t  # straight in the ideal picture, bent by the lens after
    z = 1 / ((1 - t[:, 0]) / a[of, 2] + t[:, 0] / b[of, 2])
    fold = camera.max_radius
    keep = (xy**2).sum(1) <= fold * fold
    px = np.floor(camera.distort(xy[keep]) * [camera.fx, camera.fy] + [camera.cx + 0.5, camera.cy + 0.5])
    z = z[keep]
    ok = (px[:, 0] >= rect.x0) & (px[:, 0] < rect.x1) & (px[:, 1] >= rect.y0) & (px[:, 1] < rect.y1)
    col, row, z = (px[ok, 0] - rect.x0).astype(int), (px[ok, 1] - rect.y0).astype(int), z[ok]
    seen = z <= depth[row, col] * (1 + _BEHIND)
    mask[row[seen], col[seen]] = True
    return mask


def _meets(camera: Camera, rect: Rect, na: np.ndarray, nb: np.ndarray) -> np.ndarray:
    """Edges whose box in the ideal picture meets that of `rect`, generously."""
    x, y = np.linspace(rect.x0 - 1, rect.x1, 9), np.linspace(rect.y0 - 1, rect.y1, 9)
    border = np.concatenate(
        [np.stack([x, np.full(9, v)], 1) for v in (y[0], y[-1])] + [np.stack([np.full(9, u), y], 1) for u in (x[0], x[-1])]
    )
    n = camera.normalised(border)
    if not np.isfinite(n).all():
        return np.ones(len(na), bool)
    low, high = n.min(0), n.max(0)
    slack = 0.05 * (high - low)
    return ((np.maximum(na, nb) >= low - slack) & (np.minimum(na, nb) <= high + slack)).all(1)


@numba.njit(cache=True, nogil=True)
def _shown(edges, sharp, front, hidden):  # pragma: no cover - compiled
    """Edges that are an outline, or sharp with a side that is seen."""
    out = np.empty(edges.shape[0], np.bool_)
    for k in range(edges.shape[0]):
        a, b = edges[k, 2], edges[k, 3]
        if b < 0:
            out[k] = front[a] or not hidden[a]
        elif front[a] != front[b]:
            out[k] = True
        else:
            out[k] = sharp[k] and (front[a] or not hidden[a] or not hidden[b])
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_differences(edge, prim, depth, part, face_normal, lens, height, width, rotation, pixel):  # pragma: no cover - compiled
    """Mark both pixels of every neighbouring pair whose first hits differ in a way no marked edge between them explains.

    lens : directions with one pixel of margin;  pixel : side of a pixel at depth 1
    """
    before = edge.copy()
    for y in range(height):
        for x in range(width):
            k = y * width + x
            for step in range(2):
                if (step == 0 and x + 1 >= width) or (step == 1 and y + 1 >= height):
                    continue
                m = k + 1 if step == 0 else k + width
                if prim[k] == prim[m] or before[k] or before[m]:
                    continue
                differ = prim[k] < 0 or prim[m] < 0 or part[prim[k]] != part[prim[m]]
                if not differ and abs(depth[m] - depth[k]) > depth[k] * (8.0 * pixel):  # else no slope makes it one
                    # depth that the plane of k's face has at m
                    f = prim[k]
                    here, there = 0.0, 0.0
                    for c in range(3):
                        base = rotation[2, c]
                        near_x, near_y = lens[y + 1, x + 1, 0], lens[y + 1, x + 1, 1]
                        here += face_normal[f, c] * (rotation[0, c] * near_x + rotation[1, c] * near_y + base)
                        i, j = y + 1 + step, x + 2 - step
                        there += face_normal[f, c] * (rotation[0, c] * lens[i, j, 0] + rotation[1, c] * lens[i, j, 1] + base)
                    slope = abs(here - there) / max(abs(there), 1e-3)
                    differ = abs(depth[m] - depth[k]) > depth[k] * (3.0 * slope + 8.0 * pixel)
                if differ:
                    edge[k] = True
                    edge[m] = True
