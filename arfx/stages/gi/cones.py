"""Cones through the voxels: what radiance comes back, and how much of what is behind them is still seen.

A cone is a row of samples whose spacing and voxel level depend on its aperture alone, so that neighbouring pixels read
the same levels and no pattern of voxels shows; values between voxels are trilinear. Opacity a of a voxel of side s counts
1 - (1 - a)^(ds / s) for a step of ds, and radiance is scaled with it. Directions between the axes blend three of the six
directional values by the squares of their components, which sum to 1.
A surface would meet its own voxels: samples begin START voxels off it, and of a sample only those voxels count whose
centre is above the surface's tangent plane by more than a voxel that holds the surface can be. Source: docs/methods/gi.md#cones.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.triangles import hemisphere

START = np.float32(np.sqrt(3.0))
# Cosine of the tilt of the five: a cosine lobe leaves 2/3 and 1/4 of the first two degrees of what is around (core.light), and
# with cones of 30 degrees this tilt leaves .667 and .247. At 60 degrees it would be .583 and .126: light from above is lost.
_TILT_COSINE = 0.619
LOBES = 12  # widths of mirror cones
SCRATCH = 32  # floats: values of six directions, and weights of eight corners
_FAST = {"contract", "nsz", "arcp"}
_DARK = np.float32(0.005)  # less of the background than this is none


class Bricks(NamedTuple):
    """What a cone reads: values (n,) float32 in bricks;  brick_of, meta : of their `Structure`"""

    values: np.ndarray
    brick_of: np.ndarray
    meta: np.ndarray


class Placed(NamedTuple):
    """bricks, and where they are: low (3,), corner of the voxels, and size, side of one, metres, anchor axes"""

    bricks: Bricks
    low: np.ndarray
    size: np.float32


class DiffuseCones(NamedTuple):
    """Cones about a normal. directions (k, 3) about +z, weights (k,), tangent and degrees of the half-angle, steps of one"""

    directions: np.ndarray
    weights: np.ndarray
    tan_half: np.float32
    half_deg: np.float32
    steps: np.ndarray


class Lobes(NamedTuple):
    """Mirror cones by roughness: steps (LOBES, n, 3), of which counts (LOBES,), and tangents (LOBES,)"""

    steps: np.ndarray
    tangents: np.ndarray
    counts: np.ndarray


def six_cones() -> tuple[np.ndarray, np.ndarray, float]:
    """(directions (6, 3) about +z, weights (6,), tangent of the half-angle, 30 degrees): one up, five 52 degrees from it."""
    a = np.arange(5) * 2 * np.pi / 5
    out = np.sqrt(1 - _TILT_COSINE**2)
    ring = np.stack([out * np.cos(a), out * np.sin(a), np.full(5, _TILT_COSINE)], -1)
    directions = np.concatenate([[[0.0, 0.0, 1.0]], ring]).astype(np.float32)
    return directions, np.array([0.25] + [0.15] * 5, np.float32), float(np.tan(np.radians(30)))


def cosine_cones(count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """The same for `count` directions of equal weight, denser towards the normal as the cosine is."""
    # the mean solid angle of a direction is that of the cosine's lobe, pi, by count
    half = np.arccos(1 - 0.5 / count)
    return (
        hemisphere(count).astype(np.float32),
        np.full(count, 1 / count, np.float32),
        float(np.tan(half)),
    )


def steps_of(
    tan_half: float, n: int, spacing: float = 0.5, start: float | None = None
) -> np.ndarray:
    """(k, 3) float32: distance of each sample, voxels; its level; the exponent ds / s of its opacity.

    spacing : of samples, in diameters of the cone there. Goes on to 8 n, beyond which nothing of the volume is larger than
    a few degrees. start : distance of the first; None = where the cone is a voxel wide, or one voxel"""
    out, finest = [], 2 * tan_half
    top = int(np.log2(n))
    t = min(1.0 / finest, 1.0) if start is None else start
    while t < 8 * n:
        diameter = max(1.0, finest * t)
        step = spacing * diameter
        middle = t + step / 2
        level = int(np.clip(np.floor(np.log2(max(finest * middle, 1.0)) + 0.25), 0, top))
        out.append((middle, level, step / 2**level))
        t += step
    return np.array(out, np.float32)


def mirror_tangent(roughness: np.ndarray | float) -> np.ndarray:
    """Tangent of the half-angle of a cone about the mirrored direction that blurs like a GGX lobe of width roughness^2.

    Half of the microfacets' normals lie within atan(a) (GGX: D integrates to tan^2 / (a^2 + tan^2)); the mirrored direction
    turns twice as far. Of a cone, half lies within 1 / sqrt(2) of its half-angle: so it is that much wider."""
    a = np.clip(np.asarray(roughness, float), 0.0, 1.0) ** 2
    return np.clip(np.tan(np.minimum(np.sqrt(8) * np.arctan(a), np.radians(50))), 0.01, None)


def diffuse_cones(n: int) -> DiffuseCones:
    """The six, through n^3 voxels."""
    directions, weights, tan_half = six_cones()
    half_deg = np.float32(np.degrees(np.arctan(tan_half)))
    return DiffuseCones(directions, weights, np.float32(tan_half), half_deg, steps_of(tan_half, n))


def lobes(n: int) -> Lobes:
    """LOBES of even steps of roughness, through n^3 voxels."""
    tangents = mirror_tangent(np.linspace(0, 1, LOBES))
    rows = [steps_of(float(t), n) for t in tangents]
    steps = np.zeros((LOBES, max(map(len, rows)), 3), np.float32)
    for k, r in enumerate(rows):
        steps[k, : len(r)] = r
    return Lobes(steps, tangents.astype(np.float32), np.array([len(r) for r in rows]))


@line_kernel(fastmath=_FAST, inline="always")
def blend(values, at, width, scratch):  # pragma: no cover - compiled
    """scratch[:width] : sum of the eight values from `at` on, with the weights scratch[24:]. All unsigned: nothing counts from
    the end, so that it is done for several directions at once."""
    w0, w1, w2, w3 = scratch[24], scratch[25], scratch[26], scratch[27]
    w4, w5, w6, w7 = scratch[28], scratch[29], scratch[30], scratch[31]
    b, c, e = at + width, at + np.uintp(5) * width, at + np.uintp(25) * width
    d, f, g, h = c + width, e + width, e + np.uintp(5) * width, e + np.uintp(6) * width
    for k in range(width):
        q = np.uintp(k)
        near = w0 * values[at + q] + w1 * values[b + q] + w2 * values[c + q] + w3 * values[d + q]
        scratch[q] = (
            near + w4 * values[e + q] + w5 * values[f + q] + w6 * values[g + q] + w7 * values[h + q]
        )


@line_kernel(fastmath=_FAST, error_model="numpy")
def trace(
    bricks: Bricks, steps, start, direction, point, normal, clip, scratch
):  # pragma: no cover - compiled
    """(r, g, b, share of the background that is left).

    start, unit direction, point and normal of the surface it starts on : x, y, z in voxels of level 0
    clip : leave the surface's own voxels out;  scratch (SCRATCH,)"""
    values, brick_of, meta = bricks
    (ox, oy, oz), (dx, dy, dz), (px, py, pz), (nx, ny, nz) = start, direction, point, normal
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    r, g, b, transmittance = zero, zero, zero, one
    wx, wy, wz = dx * dx, dy * dy, dz * dz
    fx0, fy0, fz0 = (0 if dx >= 0 else 4), (8 if dy >= 0 else 12), (16 if dz >= 0 else 20)
    half_extent = half * (abs(nx) + abs(ny) + abs(nz))
    size = np.float32(meta[0, 0])
    for k in range(steps.shape[0]):
        t = steps[k, 0]
        level = int(steps[k, 1])
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        s = np.float32(1 << level)
        e = half * s  # how far the outermost voxels are felt
        if x < -e or y < -e or z < -e or x > size + e or y > size + e or z > size + e:
            e = s + s  # beyond what the next, larger samples feel
            if (x < -e and dx <= 0) or (y < -e and dy <= 0) or (z < -e and dz <= 0):
                break
            if (
                (x > size + e and dx >= 0)
                or (y > size + e and dy >= 0)
                or (z > size + e and dz >= 0)
            ):
                break
            continue
        inv = one / s
        if clip:
            # the highest a voxel of the sample can be over the tangent plane
            h = (x - px) * nx + (y - py) * ny + (z - pz) * nz
            if h * inv <= -half_extent:
                continue
        x, y, z = (
            x * inv + half,
            y * inv + half,
            z * inv + half,
        )  # sample i + 1 lies at cell i's centre
        ix, iy, iz = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        cells = meta[level, 0]
        if ix < 0 or iy < 0 or iz < 0 or ix > cells or iy > cells or iz > cells:
            continue
        across = meta[level, 1]
        brick = brick_of[meta[level, 2] + ((iz >> 2) * across + (iy >> 2)) * across + (ix >> 2)]
        if brick < 0:
            continue
        fx, fy, fz = x - np.float32(ix), y - np.float32(iy), z - np.float32(iz)
        width = 4 if level == 0 else 24
        at = (
            meta[level, 3]
            + (np.int64(brick) * 125 + ((iz & 3) * 5 + (iy & 3)) * 5 + (ix & 3)) * width
        )
        # height of the cell centre of sample (ix, iy, iz) over the tangent plane, voxels of this level
        h0 = (np.float32(ix) - half - px * inv) * nx + (np.float32(iy) - half - py * inv) * ny
        h0 = h0 + (np.float32(iz) - half - pz * inv) * nz - half_extent
        any_weight = zero
        for corner in range(8):
            cx, cy, cz = corner & 1, (corner >> 1) & 1, corner >> 2
            w = (fx if cx else one - fx) * (fy if cy else one - fy) * (fz if cz else one - fz)
            if clip:
                h = h0 + (nx if cx else zero) + (ny if cy else zero) + (nz if cz else zero)
                w = w * min(max(h + h, zero), one)
            scratch[24 + corner] = w
            any_weight += w
        if any_weight <= zero:
            continue
        if level == 0:
            blend(values, np.uintp(at), np.uintp(4), scratch)
        else:
            blend(values, np.uintp(at), np.uintp(24), scratch)
        if level == 0:
            cr, cg, cb, ca = scratch[0], scratch[1], scratch[2], scratch[3]
        else:
            cr = wx * scratch[fx0] + wy * scratch[fy0] + wz * scratch[fz0]
            cg = wx * scratch[fx0 + 1] + wy * scratch[fy0 + 1] + wz * scratch[fz0 + 1]
            cb = wx * scratch[fx0 + 2] + wy * scratch[fy0 + 2] + wz * scratch[fz0 + 2]
            ca = wx * scratch[fx0 + 3] + wy * scratch[fy0 + 3] + wz * scratch[fz0 + 3]
        if ca <= np.float32(1e-6):
            continue
        absorbed = one - (one - min(ca, one)) ** steps[k, 2]
        scale = transmittance * absorbed / ca
        r += scale * cr
        g += scale * cg
        b += scale * cb
        transmittance *= one - absorbed
        if transmittance < _DARK:
            transmittance = zero
            break
    return r, g, b, transmittance


@line_kernel(fastmath=_FAST)
def tangent_frame(nx, ny, nz):  # pragma: no cover - compiled
    """Two unit vectors that make a right-handed frame with the unit normal; continuous but at (0, 0, -1) (Frisvad 2012)."""
    if nz < np.float32(-0.99999):
        return (
            np.float32(0),
            np.float32(-1),
            np.float32(0),
            np.float32(-1),
            np.float32(0),
            np.float32(0),
        )
    a = np.float32(1) / (np.float32(1) + nz)
    b = -nx * ny * a
    return np.float32(1) - nx * nx * a, b, -nx, b, np.float32(1) - ny * ny * a, -ny


def around_normals(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(m, k, 3) float32: directions (k, 3) about +z turned to each of the unit normals (m, 3), as `tangent_frame` does."""
    frames = _tangent_frames(np.ascontiguousarray(normals, np.float32))
    u, v = frames[:, None, :3], frames[:, None, 3:]
    out = (
        directions[None, :, :1] * u
        + directions[None, :, 1:2] * v
        + directions[None, :, 2:] * normals[:, None]
    )
    return np.asarray(out, np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _tangent_frames(normals):  # pragma: no cover - compiled
    out = np.empty((normals.shape[0], 6), np.float32)
    for i in range(normals.shape[0]):
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = tangent_frame(x, y, z)
    return out


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def trace_many(
    bricks: Bricks, steps, origins, directions, normals, start, clip
):  # pragma: no cover - compiled
    """(m x k, 4) of cones from origins (m, 3), voxels, in directions (m, k, 3); they begin `start` voxels along normals."""
    count = directions.shape[1]
    scratch = np.empty(SCRATCH, np.float32)
    out = np.empty((origins.shape[0] * count, 4), np.float32)
    for i in range(origins.shape[0]):
        x, y, z = origins[i, 0], origins[i, 1], origins[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        for c in range(count):
            d = directions[i, c, 0], directions[i, c, 1], directions[i, c, 2]
            from_ = x + start * nx, y + start * ny, z + start * nz
            r, g, b, transmittance = trace(
                bricks, steps, from_, d, (x, y, z), (nx, ny, nz), clip, scratch
            )
            k = i * count + c
            out[k, 0], out[k, 1], out[k, 2], out[k, 3] = r, g, b, transmittance
    return out
