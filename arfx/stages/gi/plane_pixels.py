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

from arfx.core.compiled import line_kernel
from arfx.core.layers import Layer, Layers
from arfx.core.parallel import parallel_rows
from arfx.stages.gi.cones import LOBES, SCRATCH, Lobes, Placed, trace
from arfx.stages.gi.pixels import gloss_weights, split_sum
from arfx.stages.gi.real_planes import SHOWS
from arfx.stages.gi.surroundings import (
    WARP,
    Background,
    background_radiance,
    first_plane,
    wide_share,
)
from arfx.stages.viewing import GRID_PX

_FAST = {"contract", "nsz", "arcp"}
DARKEST = np.float32(0.002)  # radiance below which a pixel is no base for a ratio
_SAME = np.float32(
    0.02
)  # of the distance: measured depth that is off by less lies on the plane; by twice that, not
SHARPEST = 0.2  # roughness of the narrowest cone: a narrower one would show the voxels themselves
_SHOWS = np.float32(SHOWS)
_RIM = np.float32(
    0.85
)  # share of the disc's radius from which on what is left (under half a grey level) fades out


class PlaneChange(NamedTuple):
    """What the object changes on the planes. delta (p, side, side, 3) : over half_m, and within radius_m of the origin
    extra_occlusion : as delta, or (0, ...) = none;  weight : of all of it
    cell : pixels from one place that is looked up to the next: it is linear between; a power of two, GRID_PX at most"""

    delta: np.ndarray
    extra_occlusion: np.ndarray
    half_m: np.float32
    radius_m: np.float32
    weight: np.float32
    cell: np.int64


@line_kernel(fastmath=_FAST, error_model="numpy")
def depth_agreement(real, row, column, depth):  # pragma: no cover - compiled
    """0..1 : is the real surface in this pixel the plane at `depth`? real (h, w) metres, inf = not measured; or (0, 0)"""
    if real.shape[0] == 0:
        return np.float32(1)
    r = real[row, column]
    if not r < np.float32(1e20):
        return np.float32(1)
    return min(max(np.float32(2) - abs(r - depth) / (_SAME * depth), np.float32(0)), np.float32(1))


def measured(layers: Layers) -> np.ndarray:
    """The layer REAL_DEPTH as the kernels take it: empty where the job has none."""
    if layers.extent(Layer.REAL_DEPTH).empty or not np.isfinite(layers[Layer.REAL_DEPTH]).any():
        return np.zeros((0, 0), np.float32)
    return np.array(
        layers[Layer.REAL_DEPTH], np.float32, order="C"
    )  # writable, as the empty one: one form to compile for


def cell_px(px_per_m: float, half_m: float, side: int) -> int:
    """About the pitch of a plane's texels near the object, in pixels. px_per_m : there;  half_m, side : of the texture"""
    texel_px = px_per_m * 2 * half_m / (side * float(WARP))
    return int(2 ** np.clip(np.floor(np.log2(max(texel_px, 1.0))), 0, np.log2(GRID_PX)))


def add_delta(
    shadow: np.ndarray,
    x0: int,
    y0: int,
    within: np.ndarray,
    nodes: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    change: PlaneChange,
    real: np.ndarray,
) -> None:
    """shadow (h, w, 3) float32 += weight x (delta - extra occlusion x what the shadow takes), never below 0.

    x0, y0 : its first pixel in the picture;  the other arguments as `_add_delta`"""

    def rows(a: int, b: int) -> None:
        measured = real[a:b] if real.size else real
        scratch = np.zeros((2, shadow.shape[1] // int(change.cell) + 4, 8), np.float32)
        _add_delta(
            shadow[a:b], (x0, y0 + a), within, nodes, origin, axes, change, measured, scratch
        )

    parallel_rows(rows, len(shadow))


@line_kernel(fastmath=_FAST, error_model="numpy")
def _direction(nodes, x, y):  # pragma: no cover - compiled
    """Viewing direction of a pixel, linear between those of nodes (gh, gw, 3) every GRID_PX pixels."""
    j, i, step = y // GRID_PX, x // GRID_PX, np.float32(1.0 / GRID_PX)
    fy, fx = np.float32(y % GRID_PX) * step, np.float32(x % GRID_PX) * step
    gy, gx = np.float32(1) - fy, np.float32(1) - fx
    a, b, c, d = gy * gx, gy * fx, fy * gx, fy * fx
    below, right = (
        min(j + 1, nodes.shape[0] - 1),
        min(i + 1, nodes.shape[1] - 1),
    )  # a cell's last corner may be the last node
    n00, n01, n10, n11 = nodes[j, i], nodes[j, right], nodes[below, i], nodes[below, right]
    dx = a * n00[0] + b * n01[0] + c * n10[0] + d * n11[0]
    dy = a * n00[1] + b * n01[1] + c * n10[1] + d * n11[1]
    return dx, dy, a * n00[2] + b * n01[2] + c * n10[2] + d * n11[2]


@line_kernel(fastmath=_FAST, error_model="numpy")
def _change_at(nodes, x, y, origin, axes, change: PlaneChange, out):  # pragma: no cover - compiled
    """The plane that a pixel shows, -1 = none that changes there; out (7,) : its change, `extra_occlusion`, depth."""
    delta, extra_occlusion, half_m, radius_m, weight, _ = change
    one, half = np.float32(1), np.float32(0.5)
    n = delta.shape[1]
    side = np.float32(n)
    dx, dy, dz = _direction(nodes, x, y)
    p, t = first_plane(axes, origin[0], origin[1], origin[2], dx, dy, dz)
    if p < 0 or not t > 0:
        return -1
    qx, qy = origin[0] + t * dx - axes[p, 0, 0], origin[1] + t * dy - axes[p, 0, 1]
    qz = origin[2] + t * dz - axes[p, 0, 2]
    a = qx * axes[p, 1, 0] + qy * axes[p, 1, 1] + qz * axes[p, 1, 2]
    b = qx * axes[p, 2, 0] + qy * axes[p, 2, 1] + qz * axes[p, 2, 2]
    away = (a * a + b * b) / (radius_m * radius_m)
    if not away < one:
        return -1
    fade = weight
    if away > _RIM * _RIM:
        fade = (one - np.sqrt(away)) / (one - _RIM) * weight
    a, b = a / half_m, b / half_m
    u, v = WARP * a / (one + (WARP - one) * abs(a)), WARP * b / (one + (WARP - one) * abs(b))
    s = min(max((u + one) * half * side - half, np.float32(0)), side - np.float32(1.001))
    q = min(max((v + one) * half * side - half, np.float32(0)), side - np.float32(1.001))
    i, j = np.uintp(s), np.uintp(q)  # not signed: no check for what counts from the end
    i1, j1, k = i + np.uintp(1), j + np.uintp(1), np.uintp(p)
    fs, fq = s - np.float32(i), q - np.float32(j)
    w00, w01, w10, w11 = (one - fs) * (one - fq), fs * (one - fq), (one - fs) * fq, fs * fq
    for c in range(3):
        value = (
            w00 * delta[k, j, i, c]
            + w01 * delta[k, j, i1, c]
            + w10 * delta[k, j1, i, c]
            + w11 * delta[k, j1, i1, c]
        )
        out[c] = fade * value
        if extra_occlusion.shape[0]:
            more = w00 * extra_occlusion[k, j, i, c] + w01 * extra_occlusion[k, j, i1, c]
            more += w10 * extra_occlusion[k, j1, i, c] + w11 * extra_occlusion[k, j1, i1, c]
            out[3 + c] = fade * more
    out[6] = t
    return p


@line_kernel(fastmath=_FAST, error_model="numpy")
def _add_delta(
    out, corner, within, nodes, origin, axes, change: PlaneChange, real, scratch
):  # pragma: no cover - compiled
    """`add_delta` of some lines, to out (h, w, 3), the shadow, whose first pixel is `corner` (x, y) of the picture.

    Looked up at the corners of cells that are aligned with the picture; at each pixel where these do not show the same plane.
    within (4,) : x0, y0, x1, y1 of the pixels to change;  nodes (gh, gw, 3) : viewing directions every GRID_PX pixels and
    origin (3,) : the camera, both anchor axes;  axes : of `Planes`;  real : as `depth_agreement`; what is not on a plane stays
    scratch (2, columns of cells + 2, 8)"""
    one, zero, cell = np.float32(1), np.float32(0), change.cell
    deeper, uneven, step = (
        change.extra_occlusion.shape[0] > 0,
        real.shape[0] > 0,
        one / np.float32(cell),
    )
    x0, y0 = corner
    x_from, x_to = max(within[0], x0), min(within[2], x0 + out.shape[1])
    y_from, y_to = max(within[1], y0), min(within[3], y0 + out.shape[0])
    if x_from >= x_to or y_from >= y_to:
        return
    first, last = x_from // cell, (x_to - 1) // cell + 1
    here = scratch[0, last - first + 1]
    for j in range(y_from // cell, (y_to - 1) // cell + 1):
        above, below = scratch[j % 2], scratch[1 - j % 2]
        for i in range(first, last + 1):
            if j == y_from // cell:
                above[i - first, 7] = _change_at(
                    nodes, i * cell, j * cell, origin, axes, change, above[i - first]
                )
            below[i - first, 7] = _change_at(
                nodes, i * cell, (j + 1) * cell, origin, axes, change, below[i - first]
            )
        for i in range(first, last):
            at = i - first
            p = above[at, 7]
            same = p == above[at + 1, 7] and p == below[at, 7] and p == below[at + 1, 7]
            if same and p < 0:
                continue
            xa, xb = max(i * cell, x_from), min((i + 1) * cell, x_to)
            for y in range(max(j * cell, y_from), min((j + 1) * cell, y_to)):
                row, fy = y - y0, np.float32(y - j * cell) * step
                gy = one - fy
                if same and not (deeper or uneven):
                    for c in range(3):
                        value = gy * above[at, c] + fy * below[at, c]
                        slope = (gy * above[at + 1, c] + fy * below[at + 1, c] - value) * step
                        value += np.float32(xa - i * cell) * slope
                        for x in range(xa - x0, xb - x0):
                            out[row, x, c] = max(out[row, x, c] + value, zero)
                            value += slope
                    continue
                for x in range(xa, xb):
                    if same:
                        fx = np.float32(x - i * cell) * step
                        for k in range(7):
                            left, right = (
                                gy * above[at, k] + fy * below[at, k],
                                gy * above[at + 1, k] + fy * below[at + 1, k],
                            )
                            here[k] = left + fx * (right - left)
                    elif _change_at(nodes, x, y, origin, axes, change, here) < 0:
                        continue
                    agreement = depth_agreement(real, row, x - x0, here[6])
                    for c in range(3):
                        ratio = out[row, x - x0, c]
                        more = here[3 + c] * (one - ratio) if deeper else zero
                        out[row, x - x0, c] = max(ratio + agreement * (here[c] - more), zero)


def visible_radius_m(
    delta: np.ndarray, positions: np.ndarray, axes: np.ndarray, most_m: float
) -> float:
    """Distance from the planes' origins beyond which no texel's change shows; at most `most_m`.

    delta, positions (p, side, side, 3);  axes (p, 4, 3)"""
    shows = np.abs(delta).max(-1) >= SHOWS
    away = np.linalg.norm(positions - axes[:, None, None, 0], axis=-1)
    if not shows.any():
        return 0.0
    # as far again as to the next texel, and room for the rim to fade
    return float(min(away[shows].max() * 1.1 / float(_RIM), most_m))


class Gloss(NamedTuple):
    """Of the planes. f0, roughness;  table : `split_sum`;  walk, tangent : of the mirror cone"""

    f0: np.float32
    roughness: np.float32
    table: np.ndarray
    walk: np.ndarray
    tangent: np.float32


def gloss_of(f0: float, roughness: float, lobes: Lobes) -> Gloss:
    k = round(max(roughness, SHARPEST) * (LOBES - 1))
    walk = lobes.steps[k, : lobes.counts[k]]
    return Gloss(np.float32(f0), np.float32(roughness), split_sum(), walk, lobes.tangents[k])


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def mirror_in_planes(
    plate, directions, origin, bias, gloss: Gloss, placed: Placed, background: Background, real
):  # pragma: no cover - compiled
    """(h, w, 3) float32: radiance that the planes' mirror image of the object adds to the picture, or takes from it.

    plate (h, w, 3) : of the picture;  directions (h, w, 3) : viewing, z = 1, and origin (3,) : the camera, both anchor axes
    real : as `add_delta`"""
    bricks, low, size = placed
    scratch = np.empty(SCRATCH, np.float32)
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
            if f < _SHOWS:
                continue
            d = dx - 2 * along * nx, dy - 2 * along * ny, dz - 2 * along * nz
            at = (px - low[0]) / size, (py - low[1]) / size, (pz - low[2]) / size
            r, g, b, transmittance = trace(
                bricks, gloss.walk, at, d, at, (zero, zero, zero), False, scratch
            )
            if transmittance >= one:
                continue
            er, eg, eb = background_radiance(
                background, p, (px, py, pz), d, tangent, half_deg, wide_share(half_deg)
            )
            out[i, j, 0] = f * (r - (one - transmittance) * er)
            out[i, j, 1] = f * (g - (one - transmittance) * eg)
            out[i, j, 2] = f * (b - (one - transmittance) * eb)
            for c in range(3):  # the picture cannot lose more than it shows
                out[i, j, c] = max(out[i, j, c], min(bias[c] - plate[i, j, c], zero))
    return out
