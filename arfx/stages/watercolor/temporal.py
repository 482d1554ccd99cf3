"""Temporal blend of edges: the measure of the last frame, carried along the motion, is mixed into this frame's.

Half of it counts where both are alike, none where they are not: what comes into view, moves on its own or follows a cut is as
it is now. Only the last frame's own measure is used, never what was mixed before, so that a frame is the same whoever paints
it and wherever a stretch of work begins. Cost: O(pixels of the half-size grid). Source: docs/methods/watercolor.md#edges."""

from __future__ import annotations

import numba
import numpy as np

from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows
from arfx.stages.watercolor.sites import GRID_PX, SiteField

BLEND_WEIGHT = 0.5  # of the last frame's measure
_TOLERANCE, _NOISE = (
    0.25,
    0.005,
)  # difference, relative to the larger and absolute, that still counts as the same
_FAR_PX = 256.0  # no thing is followed farther from frame to frame
_FAST = {"contract", "nsz", "arcp"}


def backward_flow(now: SiteField, before: SiteField) -> np.ndarray | None:
    """(2, gh, gw) float32 px: what the nodes must be moved by along x and y to lie where they lay in the frame before.

    None where the two fields have no node in common. Both in the same coordinates of the thing painted."""
    if now.u.shape != before.u.shape or (now.x0, now.y0) != (before.x0, before.y0):
        return None
    # how u and v of the frame before change along x and y, per px
    (uy, ux), (vy, vx) = (np.gradient(a, GRID_PX) for a in (before.u, before.v))
    det = ux * vy - uy * vx
    gh, gw = now.u.shape
    rows, columns = np.indices((gh, gw)).astype(float)
    x, y = np.zeros((gh, gw)), np.zeros((gh, gw))
    for _ in range(2):  # Newton; a linear field is met at once
        i, j = rows + y / GRID_PX, columns + x / GRID_PX
        du, dv = now.u - _sampled(before.u, i, j), now.v - _sampled(before.v, i, j)
        x = np.clip(x + divide(du * vy - dv * uy, det), -_FAR_PX, _FAR_PX)
        y = np.clip(y + divide(dv * ux - du * vx, det), -_FAR_PX, _FAR_PX)
    return np.stack([x, y]).astype(np.float32)


def _sampled(a: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """`a` between its nodes, bilinear, linear beyond its border. i, j : row and column, not whole"""
    r, c = (
        np.clip(np.floor(i), 0, a.shape[0] - 2).astype(int),
        np.clip(np.floor(j), 0, a.shape[1] - 2).astype(int),
    )
    t, s = i - r, j - c
    top, bottom = (
        a[r, c] + s * (a[r, c + 1] - a[r, c]),
        a[r + 1, c] + s * (a[r + 1, c + 1] - a[r + 1, c]),
    )
    out: np.ndarray = top + t * (bottom - top)
    return out


def temporal_blend(
    measure: np.ndarray, before: np.ndarray, back: np.ndarray, x0: int, y0: int
) -> np.ndarray:
    """(h, w) float32: the measure of edges, mixed with that of the frame before.

    measure, before (h, w) : on the grid of half the size;  back : of `backward_flow`, its first node at (x0, y0) of the picture
    """
    out = np.empty_like(measure)
    parallel_rows(
        lambda a, b: _blend_rows(measure, before, back, np.float32(x0), np.float32(y0), a, b, out),
        measure.shape[0],
    )
    return out


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _blend_rows(measure, before, back, x0, y0, ya, yb, out):  # pragma: no cover - compiled
    h, w = measure.shape
    gh, gw = back.shape[1:]
    zero, one, half, pitch = (
        np.float32(0),
        np.float32(1),
        np.float32(0.5),
        np.float32(1.0 / GRID_PX),
    )
    for y in range(ya, yb):
        i = (np.float32(2 * y) + half - y0) * pitch
        m = min(max(np.int32(i), 0), gh - 2)
        t = i - np.float32(m)
        for x in range(w):
            j = (np.float32(2 * x) + half - x0) * pitch
            k = min(max(np.int32(j), 0), gw - 2)
            s = j - np.float32(k)
            sx = back[0, m, k] + s * (back[0, m, k + 1] - back[0, m, k])
            sx += t * (back[0, m + 1, k] + s * (back[0, m + 1, k + 1] - back[0, m + 1, k]) - sx)
            sy = back[1, m, k] + s * (back[1, m, k + 1] - back[1, m, k])
            sy += t * (back[1, m + 1, k] + s * (back[1, m + 1, k + 1] - back[1, m + 1, k]) - sy)
            px, py = np.float32(x) + half * sx, np.float32(y) + half * sy
            now = measure[y, x]
            out[y, x] = now
            if px < zero or py < zero or px > np.float32(w - 1) or py > np.float32(h - 1):
                continue
            c, r = min(np.int32(px), max(w - 2, 0)), min(np.int32(py), max(h - 2, 0))
            d, e = min(c + 1, w - 1), min(r + 1, h - 1)
            u, v = px - np.float32(c), py - np.float32(r)
            top = before[r, c] + u * (before[r, d] - before[r, c])
            then = top + v * (before[e, c] + u * (before[e, d] - before[e, c]) - top)
            apart = abs(then - now) / (np.float32(_TOLERANCE) * max(then, now) + np.float32(_NOISE))
            out[y, x] = now + np.float32(BLEND_WEIGHT) * min(
                max(np.float32(2) - apart, zero), one
            ) * (then - now)
