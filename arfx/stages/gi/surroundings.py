"""What a cone sees behind the voxels: the real planes with the picture on them, else the environment.

The environment is kept on octahedral maps (a square per width of cone, no seam), looked up linear between texels and
widths. Planes carry the picture's radiance as a texture with a mip chain, denser in the middle, where the object stands.
Source: docs/methods/gi.md#environment; octahedral map: Engelhardt and Dachsbacher 2008. Leaves out: real things that are no
plane."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.cube import bordered, face_directions, on_cube, solid_angles
from arfx.core.light import Light, harmonics
from arfx.core.numerics import divide, normalise
from arfx.stages.light.planes import WARP

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SIDE = 32  # texels of an octahedral map: 5 degrees
FINE_SIDE = 128  # of a cube with more than COARSE_PX texels a face
COARSE_PX = 16  # of a cube that cones with a width are made of
HALF_ANGLES_DEG = (0.0, 6.0, 12.0, 20.0, 30.0, 50.0)
NARROW_DEG, WIDE_DEG = 6.0, 30.0  # half-angles: of a mirror's cone at most, of a cone for diffuse light
_OUTER = np.float32(3)  # levels from the coarsest: an eighth of a side, beyond four radii of the object
EDGE = np.float32(0.03)  # of half_m: softness of a plane's end, at least
_FAST = {"contract", "nsz", "arcp"}


class Background(NamedTuple):
    """What is behind the voxels. axes (p, 4, 3) : of `Planes`, extents (p, 5) : half_m and bounds
    textures (p, texels, 3) : mips of all levels in one row;  mips (levels, 2) : offset, side
    maps, widths, turn : of the environment, as of `environment_radiance`"""

    axes: np.ndarray
    extents: np.ndarray
    textures: np.ndarray
    mips: np.ndarray
    maps: np.ndarray
    widths: np.ndarray
    turn: np.ndarray


@lru_cache(maxsize=2)
def _directions(side: int) -> np.ndarray:
    """(side + 2, side + 2, 3) unit directions of the texels with a border of one, wrapped over the edges."""
    t = (np.arange(-1, side + 1) + 0.5) / side * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    over_u, over_v = np.abs(u) > 1, np.abs(v) > 1  # beyond an edge the map goes on turned by 180 degrees
    uu = np.where(over_u, np.sign(u) * 2 - u, u)
    vv = np.where(over_v, np.sign(v) * 2 - v, v)
    u, v = np.where(over_v, -uu, uu), np.where(over_u, -vv, vv)
    z = 1 - np.abs(u) - np.abs(v)
    fold = np.clip(-z, 0, None)
    return normalise(np.stack([u - np.sign(u) * fold, v - np.sign(v) * fold, z], -1))


@lru_cache(maxsize=2)
def _kernels(size: int) -> csr_array:
    """(widths * texels, 6 size^2) float32: share of each cube texel in each octahedral one; rows sum to 1."""
    from scipy.sparse import csr_array, vstack

    to, source = _directions(SIDE).reshape(-1, 3), face_directions(size).reshape(-1, 3)
    solid = np.tile(solid_angles(size).ravel(), 6)
    angle = np.degrees(np.arccos(np.clip(to @ source.T, -1, 1)))
    pitch = 90.0 / size
    out = []
    for half in HALF_ANGLES_DEG:
        width = max(half, 0.75 * pitch)
        w = np.clip((width + pitch / 2 - angle) / pitch, 0, 1) if half > 0.75 * pitch else np.clip(1 - angle / pitch, 0, None)
        w = w * solid
        out.append(csr_array(divide(w, w.sum(1, keepdims=True)).astype(np.float32)))
    return vstack(out, "csr")


def octahedral(cube: np.ndarray, wide: np.ndarray | None = None) -> np.ndarray:
    """(1 or 2, widths, side + 2, side + 2, 3) float32 of a cube (6, n, n, 3): mean radiance in a cone about every direction.

    wide : another cube, for the second of two: what matt surfaces see instead
    side : SIDE, and FINE_SIDE where the cube has more than COARSE_PX texels a face: its first map then shows each of them"""
    fine, cubes = cube.shape[1] > COARSE_PX, [cube] if wide is None else [cube, wide]
    small = cubes
    if fine:
        small = [np.stack([cv2.resize(f, (COARSE_PX, COARSE_PX), interpolation=cv2.INTER_AREA) for f in c]) for c in cubes]
    flat = np.concatenate([c.reshape(-1, 3).astype(np.float32) for c in small], 1)
    both = (_kernels(small[0].shape[1]) @ flat).reshape(len(HALF_ANGLES_DEG), SIDE + 2, SIDE + 2, len(cubes), 3)
    maps = np.ascontiguousarray(np.moveaxis(both, 3, 0))
    if not fine:
        return maps
    up = _finer()
    out = np.empty((*maps.shape[:2], FINE_SIDE + 2, FINE_SIDE + 2, 3), np.float32)
    rows = up @ maps[:, 1:].reshape(-1, SIDE + 2, 3 * (SIDE + 2))
    out[:, 1:] = (up @ rows.reshape(-1, SIDE + 2, 3)).reshape(out[:, 1:].shape)
    at, share = _places(cube.shape[1])
    for k, c in enumerate(cubes):
        texels = bordered(np.asarray(c, np.float32)).reshape(-1, 3)
        out[k, 0] = np.reshape(sum(s * texels[i] for i, s in zip(at, share, strict=True)), out.shape[2:])
    return out


@lru_cache(maxsize=1)
def _finer() -> np.ndarray:
    """(FINE_SIDE + 2, SIDE + 2) weights: a row or column of a map, linear between those of a coarser one."""
    at = (np.arange(-1, FINE_SIDE + 1) + 0.5) / FINE_SIDE * SIDE + 0.5
    return np.clip(1 - np.abs(at[:, None] - np.arange(SIDE + 2)), 0, None).astype(np.float32)


@lru_cache(maxsize=2)
def _places(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Number (4, texels) and weight (4, texels, 1) of the texels of a `bordered` cube around each of a fine map's directions."""
    face, u, v = on_cube(_directions(FINE_SIDE).reshape(-1, 3))
    x, y = ((t + 1) / 2 * size + 0.5 for t in (u, v))
    i, j = np.minimum(x.astype(int), size), np.minimum(y.astype(int), size)
    at = [(face * (size + 2) + j + b) * (size + 2) + i + a for b in (0, 1) for a in (0, 1)]
    share = [(y - j if b else 1 - y + j) * (x - i if a else 1 - x + i) for b in (0, 1) for a in (0, 1)]
    return np.array(at), np.array(share, np.float32)[..., None]


def from_light(light: Light, size: int = 8) -> np.ndarray:
    """A cube (6, n, n, 3), WORLD axes, that gives about the light's soft radiance, but for its scale: where no picture
    of the surroundings is."""
    d = face_directions(size)
    if not light.soft:
        return np.ones(d.shape)
    # a cosine lobe leaves 2/3 and 1/4 of degrees 1 and 2; the latter is given back by half only, as it rings
    gain = np.repeat([1.0, 1.5, 2.0], [1, 3, 5])[:, None]
    return np.clip(harmonics(d) @ (np.asarray(light.soft, float) * gain), 0, None)


def irradiance(cube: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(3,) radiance of a white diffuse surface of unit normal (3,), axes of the cube, under all of its hemisphere."""
    weight = _facing(cube.shape[1], *(float(v) for v in normal))
    return np.asarray(weight @ cube.reshape(-1, cube.shape[-1]))


@lru_cache(maxsize=8)
def _facing(size: int, *normal: float) -> np.ndarray:
    """(6 size^2) weights of a cube's texels on a surface of that normal, sum 1."""
    weight = (np.clip(face_directions(size) @ np.array(normal), 0, None) * solid_angles(size)).ravel()
    return np.asarray(weight / weight.sum())


@line_kernel(fastmath=_FAST, error_model="numpy")
def environment_radiance(maps, widths, turn, dx, dy, dz, half_deg, wide):  # pragma: no cover - compiled
    """(r, g, b) of the environment. maps : of `octahedral`;  turn (3, 3) : axes of the maps from those of d (any length)
    wide : how much of the second of two maps is seen, the less of the first"""
    x = turn[0, 0] * dx + turn[0, 1] * dy + turn[0, 2] * dz
    y = turn[1, 0] * dx + turn[1, 1] * dy + turn[1, 2] * dz
    z = turn[2, 0] * dx + turn[2, 1] * dy + turn[2, 2] * dz
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    scale = one / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, y * scale
    if z < 0:
        a = (one - abs(v)) * (one if u >= 0 else -one)
        v = (one - abs(u)) * (one if v >= 0 else -one)
        u = a
    last = widths.shape[0] - 1
    k = 0
    while k < last - 1 and half_deg > widths[k + 1]:
        k += 1
    m = min(max((half_deg - widths[k]) / (widths[k + 1] - widths[k]), zero), one)
    side = np.float32(maps.shape[2] - 2)
    s, t = (u + one) * half * side + half, (v + one) * half * side + half
    i, j = min(max(int(s), 0), maps.shape[2] - 2), min(max(int(t), 0), maps.shape[2] - 2)
    fs, ft = s - np.float32(i), t - np.float32(j)
    w00, w01, w10, w11 = (one - fs) * (one - ft), fs * (one - ft), (one - fs) * ft, fs * ft
    r, g, b = zero, zero, zero
    for both in range(4):
        q, which = both & 1, (both >> 1) if maps.shape[0] > 1 else 0
        weight = m if q else one - m
        if maps.shape[0] > 1:
            weight *= wide if which else one - wide
        elif both > 1:
            break
        if weight <= 0:
            continue
        p = maps[which, k + q]
        r += weight * (w00 * p[j, i, 0] + w01 * p[j, i + 1, 0] + w10 * p[j + 1, i, 0] + w11 * p[j + 1, i + 1, 0])
        g += weight * (w00 * p[j, i, 1] + w01 * p[j, i + 1, 1] + w10 * p[j + 1, i, 1] + w11 * p[j + 1, i + 1, 1])
        b += weight * (w00 * p[j, i, 2] + w01 * p[j, i + 1, 2] + w10 * p[j + 1, i, 2] + w11 * p[j + 1, i + 1, 2])
    return r, g, b


@line_kernel(fastmath=_FAST, error_model="numpy")
def wide_share(half_deg):  # pragma: no cover - compiled
    """How much a surface sees the guess as a matt one does; half_deg : half-angle of the cone that it sees."""
    zero, one = np.float32(0), np.float32(1)
    return min(max((half_deg - np.float32(NARROW_DEG)) / np.float32(WIDE_DEG - NARROW_DEG), zero), one)


@line_kernel(fastmath=_FAST, error_model="numpy")
def warped(x):  # pragma: no cover - compiled
    """Texture coordinate, -1..1 inside, of a place x on the plane in units of its texture's half side."""
    return WARP * x / (np.float32(1) + (WARP - np.float32(1)) * abs(x))


@line_kernel(fastmath=_FAST, error_model="numpy")
def first_plane(axes, x, y, z, dx, dy, dz):  # pragma: no cover - compiled
    """(plane, distance) of the nearest plane that is met from its front; plane -1 = none."""
    best, nearest = np.float32(1e30), -1
    for p in range(axes.shape[0]):
        nx, ny, nz = axes[p, 3, 0], axes[p, 3, 1], axes[p, 3, 2]
        towards = -(dx * nx + dy * ny + dz * nz)
        if towards <= np.float32(1e-6):
            continue
        h = (x - axes[p, 0, 0]) * nx + (y - axes[p, 0, 1]) * ny + (z - axes[p, 0, 2]) * nz
        t = max(h, np.float32(0)) / towards
        if t < best:
            best, nearest = t, p
    return nearest, best


@line_kernel(fastmath=_FAST, error_model="numpy")
def plane_radiance(texture, mips, a, b, footprint):  # pragma: no cover - compiled
    """(r, g, b) of one plane's texture at a, b (in half sides from its middle), mean over `footprint` sides of it."""
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    far = max(abs(a), abs(b))
    last = np.float32(mips.shape[0] - 1)
    level = np.log2(max(footprint * np.float32(mips[0, 1]), one))
    # beyond the texture the plane looks as its outer parts do on average: not as near the object, with its shadow
    level = min(max(level, max(last - _OUTER, zero) * min(max((far - one) * np.float32(2), zero), one)), last)
    l0 = int(level)
    m = level - np.float32(l0)
    u, v = min(max(warped(a), -one), one), min(max(warped(b), -one), one)
    r, g, c = zero, zero, zero
    for q in range(2):
        weight = m if q else one - m
        if weight <= 0:
            continue
        offset, n = mips[l0 + q, 0], mips[l0 + q, 1]
        s = min(max((u + one) * half * np.float32(n) - half, zero), np.float32(n - 1))
        w = min(max((v + one) * half * np.float32(n) - half, zero), np.float32(n - 1))
        i, j = min(int(s), max(n - 2, 0)), min(int(w), max(n - 2, 0))
        i1, j1 = min(i + 1, n - 1), min(j + 1, n - 1)
        fs, fw = s - np.float32(i), w - np.float32(j)
        at00, at01, at10, at11 = offset + j * n + i, offset + j * n + i1, offset + j1 * n + i, offset + j1 * n + i1
        w00, w01, w10, w11 = (one - fs) * (one - fw), fs * (one - fw), (one - fs) * fw, fs * fw
        r += weight * (w00 * texture[at00, 0] + w01 * texture[at01, 0] + w10 * texture[at10, 0] + w11 * texture[at11, 0])
        g += weight * (w00 * texture[at00, 1] + w01 * texture[at01, 1] + w10 * texture[at10, 1] + w11 * texture[at11, 1])
        c += weight * (w00 * texture[at00, 2] + w01 * texture[at01, 2] + w10 * texture[at10, 2] + w11 * texture[at11, 2])
    return r, g, c


@line_kernel(fastmath=_FAST, error_model="numpy")
def background_radiance(
    background: Background, skip, point, direction, tan_half, half_deg, wide
):  # fmt: skip  # pragma: no cover - compiled
    """(r, g, b) of what lies behind the voxels from a point (metres) on: planes nearest first, then the environment.

    A cone that lies across a plane's horizon sees it with the part of its width that is under it, and the environment with
    the rest, about the middle of that and narrower.
    Beyond a plane's end the next one shows. point, direction : x, y, z;  skip : a plane not to be met
    wide : as `environment_radiance` takes it"""
    axes, extents, textures, mips, maps, widths, turn = background
    (x, y, z), (dx, dy, dz) = point, direction
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    reach = tan_half / np.sqrt(one + tan_half * tan_half)
    r, g, b, transmittance = zero, zero, zero, one
    nearer_than = np.float32(-1)
    ux, uy, uz, over = dx, dy, dz, one  # direction of what is over the horizon, and how much of the cone's width
    for _ in range(axes.shape[0]):
        best, p, sine_below = np.float32(1e30), -1, zero
        for k in range(axes.shape[0]):
            down = -(dx * axes[k, 3, 0] + dy * axes[k, 3, 1] + dz * axes[k, 3, 2])
            if k == skip or down <= -reach:
                continue
            # middle of the part of the cone that is under the horizon
            low = max(down, half * (down + reach))
            h = (x - axes[k, 0, 0]) * axes[k, 3, 0] + (y - axes[k, 0, 1]) * axes[k, 3, 1] + (z - axes[k, 0, 2]) * axes[k, 3, 2]
            t = max(h, zero) / max(low, np.float32(1e-4))
            if t > nearer_than and t < best:
                best, p, sine_below = t, k, down
        if p < 0:
            break
        nearer_than = best
        half_m = extents[p, 0]
        weight = transmittance * min(max(half + half * sine_below / reach, zero), one)
        sink = max(half * (sine_below + reach) - sine_below, zero)
        ex, ey, ez = dx - sink * axes[p, 3, 0], dy - sink * axes[p, 3, 1], dz - sink * axes[p, 3, 2]
        qx, qy, qz = x + best * ex - axes[p, 0, 0], y + best * ey - axes[p, 0, 1], z + best * ez - axes[p, 0, 2]
        a = qx * axes[p, 1, 0] + qy * axes[p, 1, 1] + qz * axes[p, 1, 2]
        c = qx * axes[p, 2, 0] + qy * axes[p, 2, 1] + qz * axes[p, 2, 2]
        inside = min(min(a - extents[p, 1], c - extents[p, 2]), min(extents[p, 3] - a, extents[p, 4] - c))
        inside_weight = min(max(half + inside / (one + one) / max(best * tan_half, EDGE * half_m), zero), one)
        weight *= inside_weight
        if weight <= zero:
            continue
        a, c = a / half_m, c / half_m
        # of the texture's side: the warp's slope is WARP / (1 + (WARP - 1) |x|)^2
        slope = one + (WARP - one) * max(abs(a), abs(c))
        pr, pg, pb = plane_radiance(textures[p], mips, a, c, best * tan_half / half_m * WARP / (slope * slope))
        r += weight * pr
        g += weight * pg
        b += weight * pb
        transmittance -= weight
        if abs(sine_below) < reach:
            rise = half * inside_weight * (sine_below + reach)
            ux, uy, uz = ux + rise * axes[p, 3, 0], uy + rise * axes[p, 3, 1], uz + rise * axes[p, 3, 2]
            over *= one - half * rise / reach
        if transmittance <= np.float32(1e-3):
            break
    if transmittance > np.float32(1e-3):
        er, eg, eb = environment_radiance(maps, widths, turn, ux, uy, uz, half_deg * over, wide)
        r += transmittance * er
        g += transmittance * eg
        b += transmittance * eb
    return r, g, b


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def background_radiances(points, directions, tangents, background: Background):  # pragma: no cover - compiled
    """(m, 3) radiance from points (m, 3), metres, along directions (m, 3), in cones of these tangents (m,)."""
    out = np.empty((points.shape[0], 3), np.float32)
    for i in range(points.shape[0]):
        p, d = (points[i, 0], points[i, 1], points[i, 2]), (directions[i, 0], directions[i, 1], directions[i, 2])
        half_deg = np.float32(np.arctan(tangents[i]) * np.float32(57.29578))
        share = wide_share(half_deg)
        out[i, 0], out[i, 1], out[i, 2] = background_radiance(background, -1, p, d, tangents[i], half_deg, share)
    return out
