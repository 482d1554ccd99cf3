"""What the object changes on the real planes, looked up where each pixel's viewing ray meets them. Cost: O(pixels)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.stages.gi.surroundings import WARP, first_plane
from arfx.stages.viewing import GRID_PX

_FAST = {"contract", "nsz", "arcp"}
DARKEST = np.float32(0.002)  # radiance below which a pixel is no base for a ratio
_SAME = np.float32(0.02)  # of the distance: measured depth that is off by less lies on the plane; by twice that, not
_RIM = np.float32(0.85)  # share of the disc's radius from which on what is left (under half a grey level) fades out


class Change(NamedTuple):
    """What the object changes on the planes. delta (p, side, side, 3) : over half_m, and within radius_m of the origin
    deeper : as delta, or (0, ...) = none;  weight : of all of it"""

    delta: np.ndarray
    deeper: np.ndarray
    half_m: np.float32
    radius_m: np.float32
    weight: np.float32


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def agrees(real, row, column, depth):  # pragma: no cover - compiled
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


def add_delta(shadow: np.ndarray, x0: int, y0: int, within: np.ndarray, *rest: Any) -> np.ndarray:
    """(h, w, 3) float32 shadow + weight x (delta - deeper x what the shadow takes), never below 0.

    rest : the other arguments of `_add_delta`
    """
    others, real = rest[:-1], rest[-1]
    one: Any = _add_delta

    def some(a: int, b: int) -> np.ndarray:
        part: np.ndarray = one(shadow[a:b], x0, y0 + a, within, *others, real[a:b] if real.size else real)
        return part

    return np.concatenate(parallel_rows(some, len(shadow)))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_delta(
    shadow, x0, y0, within, nodes, origin, axes, change: Change, real
):  # fmt: skip  # pragma: no cover - compiled
    """`add_delta` of some lines.

    within (4,) : x0, y0, x1, y1 of the pixels to change;  nodes (gh, gw, 3) : viewing directions every GRID_PX pixels and
    origin (3,) : the camera, both anchor axes;  axes : of `Planes`;  real : as `agrees`; what is not on a plane stays
    """
    delta, deeper, half_m, radius_m, weight = change
    out = shadow.copy()
    one, half = np.float32(1), np.float32(0.5)
    step = np.float32(1.0 / GRID_PX)
    n = delta.shape[1]
    side = np.float32(n)
    single = axes.shape[0] == 1
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
            if single:
                p = 0
                h = (origin[0] - axes[0, 0, 0]) * axes[0, 3, 0] + (origin[1] - axes[0, 0, 1]) * axes[0, 3, 1]
                h += (origin[2] - axes[0, 0, 2]) * axes[0, 3, 2]
                falls = -(dx * axes[0, 3, 0] + dy * axes[0, 3, 1] + dz * axes[0, 3, 2])
                if not (falls > np.float32(1e-6) and h > 0):
                    continue
                t = h / falls
            else:
                p, t = first_plane(axes, origin[0], origin[1], origin[2], dx, dy, dz)
                if p < 0 or not t > 0:
                    continue
            qx, qy, qz = (
                origin[0] + t * dx - axes[p, 0, 0],
                origin[1] + t * dy - axes[p, 0, 1],
                origin[2] + t * dz - axes[p, 0, 2],
            )
            a = qx * axes[p, 1, 0] + qy * axes[p, 1, 1] + qz * axes[p, 1, 2]
            b = qx * axes[p, 2, 0] + qy * axes[p, 2, 1] + qz * axes[p, 2, 2]
            away = (a * a + b * b) * nearness
            if not away < one:
                continue
            fade = weight
            if away > _RIM * _RIM:
                fade = (one - np.sqrt(away)) * rim * weight
            fade *= agrees(real, y - y0, x - x0, t)
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
                if deeper.shape[0]:
                    more = w00 * deeper[k, j, i, c] + w01 * deeper[k, j, i1, c]
                    more += w10 * deeper[k, j1, i, c] + w11 * deeper[k, j1, i1, c]
                    value -= more * (one - out[row, column, c])
                out[row, column, c] = max(out[row, column, c] + fade * value, np.float32(0))
    return out


def shown_radius_m(delta: np.ndarray, places: np.ndarray, axes: np.ndarray, least: float, most_m: float) -> float:
    """Distance from the planes' origins beyond which no texel changes by `least`; at most `most_m`.

    delta, places (p, side, side, 3);  axes (p, 4, 3)
    """
    shows = np.abs(delta).max(-1) >= least
    away = np.linalg.norm(places - axes[:, None, None, 0], axis=-1)
    if not shows.any():
        return 0.0
    # as far again as to the next texel, and room for the rim to fade
    return float(min(away[shows].max() * 1.1 / float(_RIM), most_m))
