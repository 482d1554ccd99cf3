"""What the object changes on the real planes, looked up where each pixel's viewing ray meets them, and its mirror image in them.

The mirror image is one cone about the mirrored line of sight, only where it can meet the object. What the plane mirrors without
the object is in the picture already; what the object sends takes its place, so the change is F x (object - (1 - left) x what is
behind it), as a share of the pixel. F as for the object's own gloss.
Source: docs/methods/gi.md#delta. Cost: O(pixels + pixels of the mirror image x steps). Leaves out: highlights of the lamps, and
their shadow in the mirror image's place."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.stages.gi.cones import LOBES, Bricks, Lobes, trace
from arfx.stages.gi.pixels import gloss_weights, split_sum
from arfx.stages.gi.surroundings import WARP, Background, background_radiance, first_plane
from arfx.stages.viewing import GRID_PX

_FAST = {"contract", "nsz", "arcp"}
DARKEST = np.float32(0.002)  # radiance below which a pixel is no base for a ratio
_SAME = np.float32(0.02)  # of the distance: measured depth that is off by less lies on the plane; by twice that, not
SHARPEST = 0.2  # roughness of the narrowest cone: a narrower one would show the voxels themselves
_RIM = np.float32(0.85)  # share of the disc's radius from which on what is left (under half a grey level) fades out


class PlaneChange(NamedTuple):
    """What the object changes on the planes. delta (p, side, side, 3) : over half_m, and within radius_m of the origin
    extra_occlusion : as delta, or (0, ...) = none;  weight : of all of it"""

    delta: np.ndarray
    extra_occlusion: np.ndarray
    half_m: np.float32
    radius_m: np.float32
    weight: np.float32


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def depth_agreement(real, row, column, depth):  # pragma: no cover - compiled
    """0..1 : is the real surface in this pixel the plane at `depth`? real (h, w) metres, inf = not measured; or (0, 0)"""
    if real.shape[0] == 0:
        return np.float32(1)
    r = real[row, column]
    if not r < np.float32(1e20):
        return np.float32(1)
    return min(max(np.float32(2) - abs(r - depth) / (_SAME * depth), np.float32(0)), np.float32(1))


def measured(real: np.ndarray) -> np.ndarray:
    """The layer REAL_DEPTH as the kernels take it: empty where the job has none."""
    if real.strides == (0, 0) or not np.isfinite(real).any():
        return np.zeros((0, 0), np.float32)
    return np.ascontiguousarray(real, np.float32)


def add_delta(
    shadow: np.ndarray, x0: int, y0: int, within: np.ndarray, nodes: np.ndarray, origin: np.ndarray, axes: np.ndarray,
    change: PlaneChange, real: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 shadow + weight x (delta - deeper x what the shadow takes), never below 0. Arguments as `_add_delta`"""

    def rows(a: int, b: int) -> np.ndarray:
        measured = real[a:b] if real.size else real
        return _add_delta(shadow[a:b], x0, y0 + a, within, nodes, origin, axes, change, measured)

    return np.concatenate(parallel_rows(rows, len(shadow)))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_delta(
    shadow, x0, y0, within, nodes, origin, axes, change: PlaneChange, real
):  # fmt: skip  # pragma: no cover - compiled
    """`add_delta` of some lines.

    within (4,) : x0, y0, x1, y1 of the pixels to change;  nodes (gh, gw, 3) : viewing directions every GRID_PX pixels and
    origin (3,) : the camera, both anchor axes;  axes : of `Planes`;  real : as `depth_agreement`; what is not on a plane stays"""
    delta, extra_occlusion, half_m, radius_m, weight = change
    out = shadow.copy()
    one, half = np.float32(1), np.float32(0.5)
    step = np.float32(1.0 / GRID_PX)
    n = delta.shape[1]
    side = np.float32(n)
    nearness, scale, rim = one / (radius_m * radius_m), one / half_m, one / (one - _RIM)
    x_from, x_to = max(within[0], x0), min(within[2], x0 + shadow.shape[1])
    for y in range(max(within[1], y0), min(within[3], y0 + shadow.shape[0])):
        iy = y // GRID_PX
        fy = np.float32(y % GRID_PX) * step
        gy = one - fy
        last = -1
        ax, ay, az, sx, sy, sz = one, one, one, one, one, one
        for x in range(x_from, x_to):
            ix = x // GRID_PX
            if ix != last:  # both ends of a run of GRID_PX pixels on this line
                last = ix
                ax = gy * nodes[iy, ix, 0] + fy * nodes[iy + 1, ix, 0]
                ay = gy * nodes[iy, ix, 1] + fy * nodes[iy + 1, ix, 1]
                az = gy * nodes[iy, ix, 2] + fy * nodes[iy + 1, ix, 2]
                sx = (gy * nodes[iy, ix + 1, 0] + fy * nodes[iy + 1, ix + 1, 0] - ax) * step
                sy = (gy * nodes[iy, ix + 1, 1] + fy * nodes[iy + 1, ix + 1, 1] - ay) * step
                sz = (gy * nodes[iy, ix + 1, 2] + fy * nodes[iy + 1, ix + 1, 2] - az) * step
            fx = np.float32(x - ix * GRID_PX)
            dx, dy, dz = ax + fx * sx, ay + fx * sy, az + fx * sz
            p, t = first_plane(axes, origin[0], origin[1], origin[2], dx, dy, dz)
            if p < 0 or not t > 0:
                continue
            qx, qy = origin[0] + t * dx - axes[p, 0, 0], origin[1] + t * dy - axes[p, 0, 1]
            qz = origin[2] + t * dz - axes[p, 0, 2]
            a = qx * axes[p, 1, 0] + qy * axes[p, 1, 1] + qz * axes[p, 1, 2]
            b = qx * axes[p, 2, 0] + qy * axes[p, 2, 1] + qz * axes[p, 2, 2]
            away = (a * a + b * b) * nearness
            if not away < one:
                continue
            fade = weight
            if away > _RIM * _RIM:
                fade = (one - np.sqrt(away)) * rim * weight
            fade *= depth_agreement(real, y - y0, x - x0, t)
            a, b = a * scale, b * scale
            u, v = WARP * a / (one + (WARP - one) * abs(a)), WARP * b / (one + (WARP - one) * abs(b))
            s = min(max((u + one) * half * side - half, np.float32(0)), side - np.float32(1.001))
            q = min(max((v + one) * half * side - half, np.float32(0)), side - np.float32(1.001))
            i, j = np.uintp(s), np.uintp(q)  # not signed: no check for what counts from the end
            i1, j1 = i + np.uintp(1), j + np.uintp(1)
            fs, fq = s - np.float32(i), q - np.float32(j)
            w00, w01, w10, w11 = (one - fs) * (one - fq), fs * (one - fq), (one - fs) * fq, fs * fq
            row, column, k = np.uintp(y - y0), np.uintp(x - x0), np.uintp(p)
            for c in range(3):
                value = w00 * delta[k, j, i, c] + w01 * delta[k, j, i1, c] + w10 * delta[k, j1, i, c] + w11 * delta[k, j1, i1, c]
                if extra_occlusion.shape[0]:
                    more = w00 * extra_occlusion[k, j, i, c] + w01 * extra_occlusion[k, j, i1, c]
                    more += w10 * extra_occlusion[k, j1, i, c] + w11 * extra_occlusion[k, j1, i1, c]
                    value -= more * (one - out[row, column, c])
                out[row, column, c] = max(out[row, column, c] + fade * value, np.float32(0))
    return out


def visible_radius_m(delta: np.ndarray, positions: np.ndarray, axes: np.ndarray, least: float, most_m: float) -> float:
    """Distance from the planes' origins beyond which no texel changes by `least`; at most `most_m`.

    delta, positions (p, side, side, 3);  axes (p, 4, 3)"""
    shows = np.abs(delta).max(-1) >= least
    away = np.linalg.norm(positions - axes[:, None, None, 0], axis=-1)
    if not shows.any():
        return 0.0
    # as far again as to the next texel, and room for the rim to fade
    return float(min(away[shows].max() * 1.1 / float(_RIM), most_m))


class Gloss(NamedTuple):
    """Of the planes. f0, roughness;  table : `split_sum`;  walk, tangent : of the mirror cone
    least : share mirrored under which nothing shows"""

    f0: np.float32
    roughness: np.float32
    table: np.ndarray
    walk: np.ndarray
    tangent: np.float32
    least: np.float32


def gloss_of(f0: float, roughness: float, lobes: Lobes, least: float) -> Gloss:
    k = round(max(roughness, SHARPEST) * (LOBES - 1))
    walk = lobes.steps[k, : lobes.counts[k]]
    return Gloss(np.float32(f0), np.float32(roughness), split_sum(), walk, lobes.tangents[k], np.float32(least))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def mirror_in_planes(
    plate, directions, origin, bias, gloss: Gloss, bricks: Bricks, low, size, background: Background, real
):  # fmt: skip  # pragma: no cover - compiled
    """(h, w, 3) float32: radiance that the planes' mirror image of the object adds to the picture, or takes from it.

    plate (h, w, 3) : of the picture;  directions (h, w, 3) : viewing, z = 1, and origin (3,) : the camera, both anchor axes
    low (3,), size : corner and side of the voxels, metres;  real : as `add_delta`"""
    axes, tangent = background.axes, gloss.tangent
    rows, columns = plate.shape[:2]
    out = np.zeros((rows, columns, 3), np.float32)
    zero, one = np.float32(0), np.float32(1)
    half_deg = np.float32(np.arctan(tangent) * np.float32(57.29578))
    for i in range(rows):
        for j in range(columns):
            dx, dy, dz = directions[i, j, 0], directions[i, j, 1], directions[i, j, 2]
            p, t = first_plane(axes, origin[0], origin[1], origin[2], dx, dy, dz)
            if p < 0 or not t > 0:
                continue
            agreement = depth_agreement(real, i, j, t)
            if agreement <= 0:
                continue
            px, py, pz = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            nx, ny, nz = axes[p, 3, 0], axes[p, 3, 1], axes[p, 3, 2]
            s = one / np.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx * s, dy * s, dz * s
            along = dx * nx + dy * ny + dz * nz
            ga, gb = gloss_weights(gloss.table, gloss.roughness, -along)
            f = (gloss.f0 * ga + gb) * agreement
            if f < gloss.least:
                continue
            d = dx - 2 * along * nx, dy - 2 * along * ny, dz - 2 * along * nz
            at = (px - low[0]) / size, (py - low[1]) / size, (pz - low[2]) / size
            r, g, b, transmittance = trace(bricks, gloss.walk, at, d, at, (zero, zero, zero), False)
            if transmittance >= one:
                continue
            er, eg, eb = background_radiance(background, p, (px, py, pz), d, tangent, half_deg)
            out[i, j, 0] = f * (r - (one - transmittance) * er)
            out[i, j, 1] = f * (g - (one - transmittance) * eg)
            out[i, j, 2] = f * (b - (one - transmittance) * eb)
            for c in range(3):  # the picture cannot lose more than it shows
                out[i, j, c] = max(out[i, j, c], min(bias[c] - plate[i, j, c], zero))
    return out
