"""Which pixels need more than one sample: those that an outline or a sharp edge of the model passes through.

Outlines come from the geometry, so that features thinner than a pixel are not missed; what geometry does not tell
(cut-outs, parts that pass through each other) comes from differences between neighbouring samples."""

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
# An edge this much behind the surface that the centre sees, as a fraction of its depth, is hidden. Outlines always lie
# behind: the surface beside them is seen at a grazing angle.
_BEHIND = 2e-2


def edge_pixels(
    mesh: Mesh, camera: Camera, points: np.ndarray, front: np.ndarray, rect: Rect, depth: np.ndarray
) -> np.ndarray:
    """(h, w) bool, pixels of `rect` that a visible outline or sharp edge crosses.

    points : (n, 3) vertices in camera coordinates;  front : (m,) bool, face seen from its front
    depth : (h, w) metres at the pixel centres"""
    mask = np.zeros((rect.height, rect.width), bool)
    low, high = _bounds(camera, rect)
    shown = _shown(mesh.edges, mesh.sharp, front, mesh.hidden)
    longest = 4.0 * (rect.width + rect.height)
    xy, z = _points_along(
        mesh.edges, shown, points, low, high, camera.fx, camera.fy, longest, camera.max_radius**2
    )
    if len(z):
        px = camera.distort(xy) * [camera.fx, camera.fy] + [camera.cx + 0.5, camera.cy + 0.5]
        _mark_seen(mask, px, z, depth, rect.x0, rect.y0, np.float32(1 + _BEHIND))
    return mask


def _bounds(camera: Camera, rect: Rect) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest (x/z, y/z) of the ideal picture of `rect`, generously; infinite where the lens folds."""
    x, y = (
        np.linspace(rect.x0 - 1, rect.x1, 9),
        np.linspace(rect.y0 - 1, rect.y1, 9),
    )  # along all sides: straight lines bulge
    sides = [np.stack([x, np.full(9, v)], 1) for v in y[[0, -1]]] + [
        np.stack([np.full(9, u), y], 1) for u in x[[0, -1]]
    ]
    n = camera.normalised(np.concatenate(sides))
    if not np.isfinite(n).all():
        return np.full(2, -np.inf), np.full(2, np.inf)
    low, high = n.min(0), n.max(0)
    slack = 0.05 * (high - low)
    return low - slack, high + slack


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _points_along(
    edges, shown, points, low, high, fx, fy, longest, fold2
):  # pragma: no cover - compiled
    """Points along the edges `shown` whose box meets low .. high: (n, 2) in the ideal picture, and their depths (n,).

    longest : steps of one edge at most;  fold2 : squared radius from which on the lens shows nothing"""
    steps = np.zeros(edges.shape[0], np.int64)
    for k in range(edges.shape[0]):
        i, j = np.uintp(edges[k, 0]), np.uintp(edges[k, 1])
        za, zb = points[i, 2], points[j, 2]
        if not (shown[k] and za > EPS_DEPTH_M and zb > EPS_DEPTH_M):
            continue
        ax, ay, bx, by = points[i, 0] / za, points[i, 1] / za, points[j, 0] / zb, points[j, 1] / zb
        if (
            max(ax, bx) >= low[0]
            and max(ay, by) >= low[1]
            and min(ax, bx) <= high[0]
            and min(ay, by) <= high[1]
        ):
            length = max(abs((bx - ax) * fx), abs((by - ay) * fy))
            steps[k] = np.int64(min(np.ceil(length * _POINTS_PER_PX), longest)) + 1
    total = steps.sum()
    if total > _MAX_POINTS:
        fraction = _MAX_POINTS / total
        for k in range(edges.shape[0]):
            if steps[k] > 0:
                steps[k] = max(np.int64(steps[k] * fraction), 1)
        total = steps.sum()
    xy, depth = np.empty((total, 2)), np.empty(total)
    n = 0
    for k in range(edges.shape[0]):
        if steps[k] == 0:
            continue
        i, j = np.uintp(edges[k, 0]), np.uintp(edges[k, 1])
        za, zb = points[i, 2], points[j, 2]
        ax, ay, bx, by = points[i, 0] / za, points[i, 1] / za, points[j, 0] / zb, points[j, 1] / zb
        for q in range(steps[k]):
            t = (q + 0.5) / steps[k]
            x, y = (
                ax * (1 - t) + bx * t,
                ay * (1 - t) + by * t,
            )  # straight in the ideal picture, bent by the lens after
            if x * x + y * y <= fold2:
                xy[n, 0], xy[n, 1], depth[n] = x, y, 1 / ((1 - t) / za + t / zb)
                n += 1
    return xy[:n], depth[:n]


@numba.njit(cache=True, nogil=True)
def _mark_seen(mask, px, z, depth, x0, y0, behind):  # pragma: no cover - compiled
    """Mark the pixels of points px (n, 2), counted from the corner of pixel 0, that do not lie far behind `depth`."""
    for k in range(px.shape[0]):
        x, y = np.floor(px[k, 0]) - x0, np.floor(px[k, 1]) - y0
        if 0 <= x < mask.shape[1] and 0 <= y < mask.shape[0]:
            row, col = np.uintp(y), np.uintp(x)
            if z[k] <= depth[row, col] * behind:
                mask[row, col] = True


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
def add_differences(
    edge, prim, depth, part, face_normal, lens, height, width, rotation, pixel
):  # pragma: no cover - compiled
    """Mark both pixels of every neighbouring pair whose first hits differ in a way no marked edge between them explains.

    lens : directions with one pixel of margin;  pixel : side of a pixel at depth 1"""
    before = edge.copy()
    slack = np.float32(8.0 * pixel)
    parts = part.min() != part.max()
    maybe = np.empty(width, np.bool_)
    for y in range(height):
        for step in range(2):
            across = 1 if step == 0 else width
            n = width - 1 if step == 0 else (width if y + 1 < height else 0)
            if _may_differ(prim, depth, y * width, across, n, slack, parts, maybe) == 0:
                continue
            for x in range(n):
                k = y * width + x
                m = k + across
                if not maybe[x] or (before[k] and before[m]):
                    continue
                nothing = prim[k] < 0 or prim[m] < 0
                differ = nothing or part[prim[k]] != part[prim[m]]
                if before[k] or before[m]:
                    differ = differ and not nothing
                elif not differ and abs(depth[m] - depth[k]) > depth[k] * (
                    8.0 * pixel
                ):  # else no slope makes it one
                    # depth that the plane of k's face has at m
                    f = prim[k]
                    here, there = 0.0, 0.0
                    for c in range(3):
                        base = rotation[2, c]
                        near_x, near_y = lens[y + 1, x + 1, 0], lens[y + 1, x + 1, 1]
                        here += face_normal[f, c] * (
                            rotation[0, c] * near_x + rotation[1, c] * near_y + base
                        )
                        i, j = y + 1 + step, x + 2 - step
                        there += face_normal[f, c] * (
                            rotation[0, c] * lens[i, j, 0] + rotation[1, c] * lens[i, j, 1] + base
                        )
                    slope = abs(here - there) / max(abs(there), 1e-3)
                    differ = abs(depth[m] - depth[k]) > depth[k] * (3.0 * slope + 8.0 * pixel)
                if differ:
                    edge[k] = True
                    edge[m] = True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _may_differ(prim, depth, start, across, n, slack, parts, maybe):  # pragma: no cover - compiled
    """maybe[:n] : may the pixels from `start` on and those `across` further be two sides of an edge? Returns how many may."""
    here, there, near, far = (
        prim[start : start + n],
        prim[start + across :],
        depth[start : start + n],
        depth[start + across :],
    )
    count = np.int32(0)
    for x in range(n):
        other, gap = here[x] != there[x], abs(far[x] - near[x])
        # half of the least gap that counts: rounding decides nothing here; one that is nowhere has an infinite gap
        found = other & (parts | (gap > np.float32(0.5) * slack * min(near[x], far[x])))
        maybe[x] = found
        count += np.int32(found)
    return count
