"""The nearest face at every pixel centre, without a tree: each face asks the pixels of its own box.

A ray d meets the triangle a, b, c where d lies on the inner side of the planes through the eye and each edge, so the test
is three dot products with a x b, b x c, c x a (Olano and Greer 1997, with directions in place of a pinhole's pixels: any
lens works). Neighbours compute the same plane with the sign turned, exactly, so no ray slips between them.
Eight pixels are tested at once: the compiler does not turn a loop with a test and a store into vectors, so the test is given
as one; unfused, with the bits of one direction after the other.
Cost: O(faces + pixels of their boxes); some 8 times quicker than a tree for the coherent rays of a picture."""

# mypy: disable-error-code="no-untyped-def, call-arg, var-annotated"
from __future__ import annotations

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.rect import Rect

# The picture of a straight edge bows by about length^2 / 8 x curvature of the lens; at this length that is less than
# the padding for every lens of the test clips, below it the padding shrinks with the bow, above it the edges are followed.
_SHORT_PX = 24.0
_PAD_PX = 1.0
_SAMPLE_PX = 0.501  # samples lie this far from their pixel's centre
_EDGE_STEPS = 16
LANES = 8
_BIT, _BYTE, _INT, _LONG = ir.IntType(1), ir.IntType(LANES), ir.IntType(32), ir.IntType(64)
_DOUBLES, _INTS = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(_INT, LANES)
_PAIRS = ir.VectorType(ir.FloatType(), 2 * LANES)


def _broadcast(builder, value):
    """A vector of doubles, all of them value."""
    nothing = ir.Constant(_DOUBLES, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(_INTS, LANES * [0]))


def _bits(builder, flags):
    return builder.zext(builder.bitcast(flags, _BYTE), _LONG)


@intrinsic
def inside_eight(typingctx, directions, i, j, planes):
    """Bit k: is directions[i, j + k] (x, y, 1) on the inner side, or on, of three planes through the eye?

    directions : (h, w, 2) float32 whose last axis is contiguous; holds [i, j + 7];  not a number = outside
    planes : (9,) float64, their normals"""
    signature = types.uint64(
        directions, types.uint64, types.uint64, types.UniTuple(types.float64, 9)
    )

    def codegen(context, builder, signature, args):
        kind = signature.args[0]
        array = context.make_array(kind)(context, builder, args[0])
        index = [args[1], args[2], ir.Constant(args[2].type, 0)]
        at = cgutils.get_item_pointer(context, builder, kind, array, index, wraparound=False)
        pairs = builder.load(builder.bitcast(at, _PAIRS.as_pointer()), align=4)
        x, y = (
            builder.fpext(
                builder.shuffle_vector(
                    pairs,
                    ir.Constant(_PAIRS, ir.Undefined),
                    ir.Constant(_INTS, [2 * k + part for k in range(LANES)]),
                ),
                _DOUBLES,
            )
            for part in range(2)
        )
        inside = None
        for k in (0, 3, 6):
            px, py, pz = (
                _broadcast(builder, builder.extract_value(args[3], k + axis)) for axis in range(3)
            )
            side = builder.fadd(builder.fadd(builder.fmul(px, x), builder.fmul(py, y)), pz)
            inner = builder.fcmp_ordered(">=", side, ir.Constant(_DOUBLES, LANES * [0.0]))
            inside = inner if inside is None else builder.and_(inside, inner)
        return _bits(builder, inside)

    return signature, codegen


@intrinsic
def nonnegative_eight(typingctx, numbers, at):
    """Bit k: is numbers[at + k] not negative? numbers : flat int32, contiguous, holds [at + 7]"""
    signature = types.uint64(numbers, types.uint64)

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        eight = builder.load(
            builder.bitcast(builder.gep(data, [args[1]]), _INTS.as_pointer()), align=4
        )
        return _bits(builder, builder.icmp_signed(">=", eight, ir.Constant(_INTS, LANES * [0])))

    return signature, codegen


@intrinsic
def lowest_bit(typingctx, bits):
    """Number of the lowest bit that is set; bits must not be 0."""
    signature = types.uint64(types.uint64)

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(_BIT, 1))

    return signature, codegen


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
    """Planes through the eye and the edges opposite to a, b and c, inner side positive; |a b c|; is the front seen?"""
    ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
    bx, by, bz = points[j, 0], points[j, 1], points[j, 2]
    cx, cy, cz = points[k, 0], points[k, 1], points[k, 2]
    pax, pay, paz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    pbx, pby, pbz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    pcx, pcy, pcz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    volume = ax * pax + ay * pay + az * paz
    s = -1.0 if volume < 0 else 1.0
    return (
        s * pax,
        s * pay,
        s * paz,
        s * pbx,
        s * pby,
        s * pbz,
        s * pcx,
        s * pcy,
        s * pcz,
        s * volume,
        volume < 0,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nearest_faces(
    points, faces, hidden, box, lens, height, width, near
):  # pragma: no cover - compiled
    """Per pixel the nearest face (-1 = none), its barycentric u, v and depth; and per face whether its front is seen.

    hidden : (m,) bool, faces that cannot be seen from behind;  lens : (h + 2, w + 2, 2) directions, one pixel of margin"""
    prim = np.full(height * width, -1, np.int32)
    u, v = np.empty(height * width, np.float32), np.empty(height * width, np.float32)
    depth = np.full(height * width, np.inf, np.float32)
    if lens.shape[1] < LANES:
        lens = _widened(lens)
    one, row, lanes, most = (
        np.uintp(1),
        np.uintp(width),
        np.uintp(LANES),
        np.uintp(lens.shape[1] - LANES),
    )
    front = np.zeros(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        pax, pay, paz, pbx, pby, pbz, pcx, pcy, pcz, volume, front[f] = _planes(points, i, j, k)
        if volume == 0 or (hidden[f] and not front[f]):
            continue
        x0, x1 = np.uintp(box[f, 0]), np.uintp(box[f, 2])
        for y in range(np.uintp(box[f, 1]), np.uintp(box[f, 3])):
            for first in range(x0, x1, LANES):
                column = np.uintp(first) + one
                start = min(column, most)  # eight columns that the table holds
                found = inside_eight(
                    lens, np.uintp(y + one), start, (pax, pay, paz, pbx, pby, pbz, pcx, pcy, pcz)
                )
                found = (found >> (column - start)) << (column - start)
                if x1 + one - start < lanes:
                    found &= (one << (x1 + one - start)) - one
                while found:
                    x = start + lowest_bit(found) - one
                    found &= found - one
                    dx, dy = (
                        np.float64(lens[y + one, x + one, 0]),
                        np.float64(lens[y + one, x + one, 1]),
                    )
                    ea = pax * dx + pay * dy + paz
                    eb = pbx * dx + pby * dy + pbz
                    ec = pcx * dx + pcy * dy + pcz
                    total = ea + eb + ec
                    if total > 0:
                        z, n = volume / total, y * row + x
                        if near < z < depth[n]:
                            depth[n], prim[n] = z, f
                            u[n], v[n] = eb / total, ec / total
    return prim, u, v, depth, front


@numba.njit(cache=True, nogil=True)
def _widened(directions):  # pragma: no cover - compiled
    """(h, w, 2) with columns of no direction added up to a whole number of eights."""
    h, w = directions.shape[:2]
    out = np.full((h, -(-w // LANES) * LANES, 2), np.nan, np.float32)
    for y in range(h):
        for x in range(w):
            out[y, x, 0], out[y, x, 1] = directions[y, x, 0], directions[y, x, 1]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nearest_faces_at(
    points, faces, hidden, box, slot, samples, width, near
):  # pragma: no cover - compiled
    """The same for several samples of some pixels.

    slot : (h * w,) int32, number of the pixel among those sampled, -1 = not sampled
    samples : (pixels, s, 2) float32 directions;  returns face, u, v, depth (pixels * s,)"""
    per = samples.shape[1]
    if per % LANES:
        samples = _widened(samples)
    if slot.size < LANES:
        slot = np.concatenate((slot, np.full(LANES, -1, np.int32)))
    n, one, most = samples.shape[0] * per, np.uintp(1), np.uintp(slot.size - LANES)
    prim = np.full(n, -1, np.int32)
    u, v = np.zeros(n, np.float32), np.zeros(n, np.float32)
    depth = np.full(n, np.inf, np.float32)
    for f in range(faces.shape[0]):
        if box[f, 0] >= box[f, 2] or box[f, 1] >= box[f, 3]:
            continue
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        pax, pay, paz, pbx, pby, pbz, pcx, pcy, pcz, volume, front = _planes(points, i, j, k)
        if volume == 0 or (hidden[f] and not front):
            continue
        for y in range(box[f, 1], box[f, 3]):
            ends = np.uintp(y * width + box[f, 2])
            for first in range(y * width + box[f, 0], ends, LANES):
                start = min(np.uintp(first), most)
                sampled = nonnegative_eight(slot, start)
                sampled = (sampled >> (np.uintp(first) - start)) << (np.uintp(first) - start)
                if ends - start < np.uintp(LANES):
                    sampled &= (one << (ends - start)) - one
                while sampled:
                    a = np.uintp(slot[start + lowest_bit(sampled)])
                    sampled &= sampled - one
                    for eight in range(0, samples.shape[1], LANES):
                        found = inside_eight(
                            samples,
                            a,
                            np.uintp(eight),
                            (pax, pay, paz, pbx, pby, pbz, pcx, pcy, pcz),
                        )
                        while found:
                            s = np.uintp(eight) + lowest_bit(found)
                            found &= found - one
                            dx, dy = np.float64(samples[a, s, 0]), np.float64(samples[a, s, 1])
                            ea = pax * dx + pay * dy + paz
                            eb = pbx * dx + pby * dy + pbz
                            ec = pcx * dx + pcy * dy + pcz
                            total = ea + eb + ec
                            if total > 0:
                                z, m = volume / total, a * np.uintp(per) + s
                                if near < z < depth[m]:
                                    depth[m], prim[m] = z, f
                                    u[m], v[m] = eb / total, ec / total
    return prim, u, v, depth
