"""The nearest face at every pixel centre, without a tree: each face asks the pixels of its own box.

A ray d meets the triangle a, b, c where d lies on the inner side of the planes through the eye and
each edge, so the test is three dot products with a x b, b x c, c x a (Olano and Greer 1997, with
directions in place of a pinhole's pixels: any lens works). Neighbours compute the same plane with
the sign turned, exactly, so no ray slips between them.
Each run of directions is passed twice: a plain loop of arithmetic, which the compiler turns into
vectors, then one that looks at those inside.
Cost: O(faces + pixels of their boxes); some 8 times quicker than a tree for a picture's rays."""

# mypy: disable-error-code="no-untyped-def, var-annotated"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.rect import Rect

# The picture of a straight edge bows by about length^2 / 8 x curvature of the lens; at this length
# that is less than the padding for every lens of the test clips, below it the padding shrinks with
# the bow, above it the edges are followed.
_SHORT_PX = 24.0
_PAD_PX = 1.0
_SAMPLE_PX = 0.501  # samples lie this far from their pixel's centre
_EDGE_STEPS = 16


def face_boxes(
    points: np.ndarray, pixels: np.ndarray, faces: np.ndarray, camera: Camera, rect: Rect
) -> np.ndarray:
    """(m, 4) int32 half-open x0 y0 x1 y1 within `rect` (relative to it) of the pixels that a face may cover.

    points (n, 3) camera coordinates; pixels (n, 2) their projections, NaN behind the camera or beyond the lens"""
    box, long = _boxes(
        points,
        pixels,
        faces,
        camera.distorted,
        rect.x0,
        rect.y0,
        rect.width,
        rect.height,
        EPS_DEPTH_M,
    )
    if long.any():
        at = np.flatnonzero(long)
        t = np.linspace(0, 1, _EDGE_STEPS + 1)[:, None]
        p = points[faces[at]]
        around = np.concatenate(
            [p[:, None, i] * (1 - t) + p[:, None, j] * t for i, j in ((0, 1), (1, 2), (2, 0))], 1
        )
        followed = camera.project(around)
        low, high = followed.min(1), followed.max(1)
        slack = (
            _PAD_PX + _SAMPLE_PX + 0.02 * (high - low)
        )  # bow between two points: at most 1/256 of the whole bow, times safety
        ends = np.concatenate(
            [
                np.ceil(low - slack) - [rect.x0, rect.y0],
                np.floor(high + slack) + 1 - [rect.x0, rect.y0],
            ],
            1,
        )
        ends = np.where(np.isnan(ends).any(1)[:, None], [0, 0, rect.width, rect.height], ends)
        box[at] = np.clip(ends, 0, [rect.width, rect.height] * 2).astype(np.int32)
    return box


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _boxes(
    points, pixels, faces, distorted, x0, y0, width, height, near
):  # pragma: no cover - compiled
    """Boxes from the corners alone, and which faces are so long that a lens bends their edges by more than the padding."""
    box = np.zeros((faces.shape[0], 4), np.int32)
    long = np.zeros(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        if points[i, 2] <= near and points[j, 2] <= near and points[k, 2] <= near:
            continue
        # a corner without a picture: let the planes decide
        ax, bx, cx, ay, by, cy = (
            pixels[i, 0],
            pixels[j, 0],
            pixels[k, 0],
            pixels[i, 1],
            pixels[j, 1],
            pixels[k, 1],
        )
        if np.isnan(ax + bx + cx + ay + by + cy):
            box[f, 2], box[f, 3] = width, height
            continue
        low_x, high_x, low_y, high_y = (
            min(ax, bx, cx),
            max(ax, bx, cx),
            min(ay, by, cy),
            max(ay, by, cy),
        )
        side = max(high_x - low_x, high_y - low_y)
        long[f] = distorted and side > _SHORT_PX
        pad = _PAD_PX * ((side / _SHORT_PX) ** 2 if distorted else 0.0) + _SAMPLE_PX
        box[f, 0] = min(max(np.ceil(low_x - pad) - x0, 0.0), width)
        box[f, 1] = min(max(np.ceil(low_y - pad) - y0, 0.0), height)
        box[f, 2] = min(max(np.floor(high_x + pad) + 1 - x0, 0.0), width)
        box[f, 3] = min(max(np.floor(high_y + pad) + 1 - y0, 0.0), height)
    return box, long


@numba.njit(nogil=True, inline="always")
def _planes(points, i, j, k):  # pragma: no cover - compiled
    """Planes through the eye and the edges opposite to a, b and c, and the volume |a b c|, signed.

    The volume is negative where the front is seen."""
    ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
    bx, by, bz = points[j, 0], points[j, 1], points[j, 2]
    cx, cy, cz = points[k, 0], points[k, 1], points[k, 2]
    opposite_a = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    opposite_b = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    opposite_c = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    volume = ax * opposite_a[0] + ay * opposite_a[1] + az * opposite_a[2]
    return opposite_a, opposite_b, opposite_c, volume


@numba.njit(nogil=True, inline="always")
def _meet_run(face, planes, near, x, y, first, last, inside, nearest):  # pragma: no cover
    """Meet one face with the directions x, y [first:last]; nearest : face, u, v, depth of each."""
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2), volume = planes
    if volume < 0:
        a0, a1, a2, b0, b1, b2 = -a0, -a1, -a2, -b0, -b1, -b2
        c0, c1, c2, volume = -c0, -c1, -c2, -volume
    prim, u, v, depth = nearest
    for k in range(last - first):
        dx, dy = x[first + k], y[first + k]
        side_b = b0 * dx + b1 * dy + b2
        side_c = c0 * dx + c1 * dy + c2
        inside[k] = min(a0 * dx + a1 * dy + a2, min(side_b, side_c))
    for k in range(last - first):
        if inside[k] >= 0:
            m = first + k
            dx, dy = x[m], y[m]
            side_b = b0 * dx + b1 * dy + b2
            side_c = c0 * dx + c1 * dy + c2
            total = a0 * dx + a1 * dy + a2 + side_b + side_c
            z = volume / total
            if total > 0 and near < z < depth[m]:
                depth[m], prim[m] = z, face
                u[m], v[m] = side_b / total, side_c / total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nearest_faces(points, faces, hidden, box, x, y, near):  # pragma: no cover - compiled
    """Per pixel the nearest face (-1 = none), its barycentric u, v and depth, (h, w) each.

    points : (n, 3) float64, camera axes;  hidden : (m,) bool, faces that are not seen from behind
    x, y : (h, w) float64 directions, z = 1;  near : least depth, metres
    Returns also (m,) bool, whether a face's front is seen."""
    nearest = (
        np.full(x.shape, -1, np.int32),
        np.empty(x.shape, np.float32),
        np.empty(x.shape, np.float32),
        np.full(x.shape, np.inf, np.float32),
    )
    prim, u, v, depth = nearest
    inside = np.empty(x.shape[1])
    front = np.zeros(len(faces), np.bool_)
    for f in range(len(faces)):
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        planes = _planes(points, i, j, k)
        front[f] = planes[3] < 0
        if planes[3] == 0 or (hidden[f] and not front[f]):
            continue
        first, last = np.uintp(box[f, 0]), np.uintp(max(box[f, 0], box[f, 2]))
        for row in range(np.uintp(box[f, 1]), np.uintp(box[f, 3])):
            of_row = prim[row], u[row], v[row], depth[row]
            _meet_run(f, planes, near, x[row], y[row], first, last, inside, of_row)
    return prim, u, v, depth, front


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nearest_faces_at(points, faces, hidden, box, slot, x, y, near):  # pragma: no cover - compiled
    """The same for s samples of each of n pixels: (n, s) face, u, v, depth.

    slot : (h, w) int32, number of the pixel among those sampled, -1 = not sampled
    x, y : (n, s) float64 directions"""
    prim, u = np.full(x.shape, -1, np.int32), np.zeros(x.shape, np.float32)
    v, depth = np.zeros(x.shape, np.float32), np.full(x.shape, np.inf, np.float32)
    inside = np.empty(x.shape[1])
    last = np.uintp(x.shape[1])
    for f in range(len(faces)):
        if box[f, 0] >= box[f, 2] or box[f, 1] >= box[f, 3]:
            continue
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        planes = _planes(points, i, j, k)
        if planes[3] == 0 or (hidden[f] and planes[3] > 0):
            continue
        for row in range(np.uintp(box[f, 1]), np.uintp(box[f, 3])):
            for column in range(np.uintp(box[f, 0]), np.uintp(box[f, 2])):
                if slot[row, column] >= 0:
                    n = np.uintp(slot[row, column])
                    of_pixel = prim[n], u[n], v[n], depth[n]
                    _meet_run(f, planes, near, x[n], y[n], np.uintp(0), last, inside, of_pixel)
    return prim, u, v, depth
