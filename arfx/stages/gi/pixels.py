"""Indirect light on the object's pixels: gathered at every second pixel of every second line (or at all), from the pixel's
own position and normal, then interpolated where normal and plane agree; where they do not, gathered again.

Diffuse: six cones. Gloss: one cone about the lobe's middle, as wide as the roughness asks; of what lies about the mirrored
direction F0 x a + b is reflected, the split sum of GGX with Smith's height-correlated G and Schlick's F, over the microfacets
that the viewer sees, as the reference traces it. Karis' fit of it (2014, for phones) is a fifth too dark for metal of roughness
.4, and below zero for what is rough and dark. Cost: O(covered pixels x cones x steps). Source: docs/methods/gi.md#cones;
Karis 2013 (split sum); Heitz 2014 (G), 2018 (visible normals). Leaves out: light from microfacet to microfacet."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.parallel import parallel_rows
from arfx.stages.gi.cones import (
    LOBES,
    SCRATCH,
    START,
    DiffuseCones,
    Lobes,
    Placed,
    tangent_frame,
    trace,
)
from arfx.stages.gi.surroundings import Background, background_radiance, wide_share
from arfx.stages.lightmap.shading import Surface

_FAST = {"contract", "nsz", "arcp"}
_AGREE = np.float32(0.02)  # least sum of weights with which neighbours are interpolated
_BEND = np.float32(0.5)  # normals of neighbours that differ by more lie on two sides of an edge
DIFFUSE, GLOSS = 1, 2  # what is gathered at a point
ROUGHNESSES, COSINES = 16, 32  # entries of the split sum's table
_MICROFACETS = 512
_SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
_FEW = 256  # points: below it threads cost more than they save


class Anchor(NamedTuple):
    """rotation (3, 3), offset (3,) : anchor from world;  eye (3,) : the camera, anchor axes"""

    rotation: np.ndarray
    offset: np.ndarray
    eye: np.ndarray


class Limits(NamedTuple):
    """sharp : roughness from which blocks gather what is mirrored
    shows : half a grey level as a share of a white surface's light, over the brightest that is around;  table : `split_sum`"""

    sharp: np.float32
    shows: np.float32
    table: np.ndarray


class Blocks(NamedTuple):
    """What was gathered. block : pixels a side, 0 = none was;  voxel_m : distance from a plane that counts
    points (n, 8), light (n, 6), numbers (rows, columns) : of them, as of `select_points`"""

    block: int
    voxel_m: np.float32
    points: np.ndarray
    light: np.ndarray
    numbers: np.ndarray


def gather_points(points: np.ndarray, gather: np.ndarray, eye: np.ndarray, *scene: Any) -> np.ndarray:
    """(m, 6) float32: radiance of a white diffuse surface, and what comes from about the mirrored direction.

    points (m, 8) : unit normal, position (metres), anchor axes, `widened_roughness`, roughness
    gather (m,) : DIFFUSE and GLOSS, added
    scene : the other arguments of `_gather_points`"""
    out = np.zeros((len(points), 6), np.float32)

    def rows(a: int, b: int) -> None:
        _gather_points(points[a:b], gather[a:b], out[a:b], eye, *scene, np.empty(SCRATCH, np.float32))

    parallel_rows(rows, len(points), least=_FEW)
    return out


@line_kernel(fastmath=_FAST, error_model="numpy")
def _gather_points(
    points, gather, out, eye, placed: Placed, diffuse_cones: DiffuseCones, mirror: Lobes, background: Background, scratch
):  # fmt: skip  # pragma: no cover - compiled
    """`gather_points` of some, added to out. scratch (SCRATCH,)"""
    bricks, low, size = placed
    directions, weights, tan_half, half_deg, steps = diffuse_cones
    lobes, tangents, counts = mirror
    cones = directions.shape[0]
    for i in range(points.shape[0]):
        nx, ny, nz, x, y, z = points[i, 0], points[i, 1], points[i, 2], points[i, 3], points[i, 4], points[i, 5]
        px, py, pz = (x - low[0]) / size, (y - low[1]) / size, (z - low[2]) / size
        ox, oy, oz = px + START * nx, py + START * ny, pz + START * nz
        ux, uy, uz, vx, vy, vz = tangent_frame(nx, ny, nz)
        first = 0 if gather[i] & DIFFUSE else cones
        last = cones + 1 if gather[i] & GLOSS else cones
        for c in range(first, last):
            if c < cones:
                c0, c1, c2 = directions[c, 0], directions[c, 1], directions[c, 2]
                dx, dy, dz = c0 * ux + c1 * vx + c2 * nx, c0 * uy + c1 * vy + c2 * ny, c0 * uz + c1 * vz + c2 * nz
                w, to, tan_here, deg_here, walk, share = weights[c], 0, tan_half, half_deg, steps, np.float32(1)
            else:
                ex, ey, ez = eye[0] - x, eye[1] - y, eye[2] - z
                s = np.float32(1) / np.sqrt(max(ex * ex + ey * ey + ez * ez, np.float32(1e-12)))
                ex, ey, ez = ex * s, ey * s, ez * s
                twice = np.float32(2) * (nx * ex + ny * ey + nz * ez)
                dx, dy, dz = twice * nx - ex, twice * ny - ey, twice * nz - ez
                dx, dy, dz = off_specular_peak(points[i, 6], nx, ny, nz, dx, dy, dz)
                k = min(max(int(points[i, 6] * np.float32(LOBES - 1) + np.float32(0.5)), 0), LOBES - 1)
                w, to, tan_here, walk = np.float32(1), 3, tangents[k], lobes[k, : counts[k]]
                deg_here = np.float32(np.arctan(tan_here) * np.float32(57.29578))
                k = min(max(int(points[i, 7] * np.float32(LOBES - 1) + np.float32(0.5)), 0), LOBES - 1)
                share = wide_share(np.arctan(tangents[k]) * np.float32(57.29578))
            d = dx, dy, dz
            r, g, b, transmittance = trace(bricks, walk, (ox, oy, oz), d, (px, py, pz), (nx, ny, nz), True, scratch)
            if transmittance > 0:
                er, eg, eb = background_radiance(background, -1, (x, y, z), d, tan_here, deg_here, share)
                r += transmittance * er
                g += transmittance * eg
                b += transmittance * eb
            out[i, to] += w * r
            out[i, to + 1] += w * g
            out[i, to + 2] += w * b


@line_kernel(fastmath=_FAST)
def off_specular_peak(roughness, nx, ny, nz, dx, dy, dz):  # pragma: no cover - compiled
    """Unit direction of a lobe's middle: the mirrored direction d, and the rougher the nearer to the normal, as what would go
    under the surface is missing (Lagarde and de Rousiers 2014)."""
    one = np.float32(1)
    a = min(roughness * roughness, one)
    m = (one - a) * (np.sqrt(one - a) + a)
    x, y, z = nx + m * (dx - nx), ny + m * (dy - ny), nz + m * (dz - nz)
    s = one / np.sqrt(max(x * x + y * y + z * z, np.float32(1e-12)))
    return x * s, y * s, z * s


def select_points(
    surface: Surface, x0: int, y0: int, block: int, anchor: Anchor, limits: Limits
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point for each block: (points (m, 8), gather (m,), index (rows, columns) of blocks, -1 = none).

    x0, y0 : position of the arrays in the picture, with which blocks are aligned. The point is the most covered pixel's."""
    rows, columns = surface.coverage.shape
    index = np.full(((y0 + rows - 1) // block - y0 // block + 1, (x0 + columns - 1) // block - x0 // block + 1), -1, np.int32)
    points, gather = np.empty((index.size, 8), np.float32), np.zeros(index.size, np.int8)
    m = _select_points(surface, x0, y0, block, anchor, limits, points, gather, index)
    return points[:m], gather[:m], index


@line_kernel(fastmath=_FAST)
def _select_points(
    surface: Surface, x0, y0, block, anchor: Anchor, limits: Limits, points, gather, index
):  # fmt: skip  # pragma: no cover - compiled
    """How many there are."""
    coverage, normal, position, _, material, _ = surface
    rows, columns = coverage.shape
    by0, bx0 = y0 // block, x0 // block
    m = 0
    for j in range(index.shape[0]):
        for i in range(index.shape[1]):
            best, at_y, at_x = np.float32(0), -1, -1
            for y in range(max((j + by0) * block - y0, 0), min((j + by0 + 1) * block - y0, rows)):
                for x in range(max((i + bx0) * block - x0, 0), min((i + bx0 + 1) * block - x0, columns)):
                    if coverage[y, x] > best:
                        best, at_y, at_x = coverage[y, x], y, x
            if at_y < 0 or not _surface_point(normal, position, at_y, at_x, anchor, points[m]):
                continue
            rough = material[at_y, at_x, 1]
            points[m, 6], points[m, 7] = widened_roughness(rough, coverage, normal, at_y, at_x), rough
            shines = rough >= limits.sharp and shows_specular(surface, at_y, at_x, points[m], anchor.eye, limits)
            gather[m] = DIFFUSE + GLOSS if shines else DIFFUSE
            index[j, i] = m
            m += 1
    return m


def interpolate(
    surface: Surface, x0: int, y0: int, blocks: Blocks, anchor: Anchor, limits: Limits
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every pixel's light from the blocks around: (light (h, w, 6), points (m, 8), gather (m,), pixels (m, 2)) of those that
    still have to be gathered."""
    rows, columns = surface.coverage.shape
    out, most = np.zeros((rows, columns, 6), np.float32), rows * columns + 1
    points, gather, pixels = np.empty((most, 8), np.float32), np.empty(most, np.int8), np.empty((most, 2), np.int32)
    m = _interpolate(surface, x0, y0, blocks, anchor, limits, out, points, gather, pixels)
    return out, points[:m], gather[:m], pixels[:m]


@line_kernel(fastmath=_FAST)
def _interpolate(
    surface: Surface, x0, y0, blocks: Blocks, anchor: Anchor, limits: Limits, out, remaining, gather, pixels
):  # fmt: skip  # pragma: no cover - compiled
    """How many remain."""
    coverage, normal, position, _, material, _ = surface
    rows, columns = coverage.shape
    block, size, points, light, index = blocks
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    m = 0
    for y in range(rows):
        for x in range(columns):
            here = remaining[m]
            if coverage[y, x] <= 0 or not _surface_point(normal, position, y, x, anchor, here):
                continue
            total = zero
            if block > 0:
                by0, bx0 = y0 // block, x0 // block
                u = (np.float32(x + x0) + half) / np.float32(block) - half
                v = (np.float32(y + y0) + half) / np.float32(block) - half
                iu, iv = int(np.floor(u)), int(np.floor(v))
                fu, fv = u - np.float32(iu), v - np.float32(iv)
                for corner in range(4):
                    cu, cv = corner & 1, corner >> 1
                    i, j = iu + cu - bx0, iv + cv - by0
                    if i < 0 or j < 0 or i >= index.shape[1] or j >= index.shape[0] or index[j, i] < 0:
                        continue
                    at = index[j, i]
                    k = points[at]
                    agree = max(here[0] * k[0] + here[1] * k[1] + here[2] * k[2], zero)
                    agree = agree * agree
                    agree = agree * agree
                    agree = agree * agree
                    off = (here[3] - k[3]) * here[0] + (here[4] - k[4]) * here[1] + (here[5] - k[5]) * here[2]
                    off = off / size
                    w = (fu if cu else one - fu) * (fv if cv else one - fv) * agree * agree / (one + off * off)
                    total += w
                    for c in range(6):
                        out[y, x, c] += w * light[at, c]
            shines = shows_specular(surface, y, x, here, anchor.eye, limits)
            need = 0
            if total < _AGREE:
                need = DIFFUSE + GLOSS if shines else DIFFUSE
            else:
                for c in range(6):
                    out[y, x, c] /= total
                if shines and material[y, x, 1] < limits.sharp:
                    need = GLOSS
            if need:
                here[6], here[7] = widened_roughness(material[y, x, 1], coverage, normal, y, x), material[y, x, 1]
                gather[m] = need
                pixels[m, 0], pixels[m, 1] = y, x
                m += 1
    return m


def reflected_light(
    surface: Surface, anchor: Anchor, limits: Limits, light: np.ndarray, gathered: np.ndarray, gather: np.ndarray,
    pixels: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 that the surface sends to the camera, premultiplied by coverage. gathered (m, 6) : of the pixels (m, 2)

    Where too little is mirrored to be gathered, what is mirrored is the light that falls on the surface."""
    out = np.zeros((*surface.coverage.shape, 3), np.float32)
    _reflected_light(surface, anchor, limits, light, gathered, gather, pixels, out, np.zeros(7, np.float32))
    return out


@line_kernel(fastmath=_FAST)
def _reflected_light(
    surface: Surface, anchor: Anchor, limits: Limits, light, gathered, gather, pixels, out, here
):  # fmt: skip  # pragma: no cover - compiled
    coverage, normal, position, albedo, material, _ = surface
    eye, table = anchor.eye, limits.table
    for i in range(pixels.shape[0]):
        to = light[pixels[i, 0], pixels[i, 1]]
        for c in range(6):
            if gather[i] & (DIFFUSE if c < 3 else GLOSS):
                to[c] = gathered[i, c]
    rows, columns = coverage.shape
    one, zero = np.float32(1), np.float32(0)
    for y in range(rows):
        for x in range(columns):
            if coverage[y, x] <= 0 or not _surface_point(normal, position, y, x, anchor, here):
                continue
            ex, ey, ez = eye[0] - here[3], eye[1] - here[4], eye[2] - here[5]
            s = one / np.sqrt(max(ex * ex + ey * ey + ez * ez, np.float32(1e-12)))
            ga, gb = gloss_weights(table, material[y, x, 1], max((here[0] * ex + here[1] * ey + here[2] * ez) * s, zero))
            metal = material[y, x, 0]
            f0 = np.float32(0.08) * material[y, x, 2] * (one - metal)
            if f0 + metal <= zero:
                gb = zero
            shines = 3 if shows_specular(surface, y, x, here, eye, limits) else 0
            for c in range(3):
                a = albedo[y, x, c]
                diffuse = a * (one - metal) * (one - min(f0 * ga + gb, one))
                gloss = (f0 + a * metal) * ga + gb
                out[y, x, c] = coverage[y, x] * (diffuse * light[y, x, c] + gloss * light[y, x, shines + c])


@line_kernel(fastmath=_FAST)
def shows_specular(surface: Surface, y, x, here, eye, limits: Limits):  # pragma: no cover - compiled
    """Whether what the pixel mirrors can change it by half a grey level: specular x Fresnel over what that is of its own light.

    here (6+,) : normal and place, as eye anchor axes"""
    albedo, material = surface.albedo, surface.material
    zero, one = np.float32(0), np.float32(1)
    metal = material[y, x, 0]
    most = max(albedo[y, x, 0], albedo[y, x, 1], albedo[y, x, 2])
    f0 = np.float32(0.08) * material[y, x, 2] * (one - metal) + most * metal
    if f0 <= zero:
        return False
    ex, ey, ez = eye[0] - here[3], eye[1] - here[4], eye[2] - here[5]
    s = one / np.sqrt(max(ex * ex + ey * ey + ez * ez, np.float32(1e-12)))
    ga, gb = gloss_weights(limits.table, material[y, x, 1], max((here[0] * ex + here[1] * ey + here[2] * ez) * s, zero))
    return f0 * ga + gb > limits.shows * most


@line_kernel(fastmath=_FAST)
def widened_roughness(roughness, coverage, normal, y, x):  # pragma: no cover - compiled
    """Roughness whose lobe is as wide as what one pixel of the curved surface mirrors, if that is more than its own.

    Neighbours whose normals differ by d mirror directions 2 d apart: half of that is the half-angle. Without it a mirror's rim
    shows every n-th pixel of what it squeezes together."""
    rows, columns = coverage.shape
    most = np.float32(0)
    for k in range(4):
        j, i = y + (k == 0) - (k == 1), x + (k == 2) - (k == 3)
        if j < 0 or i < 0 or j >= rows or i >= columns or coverage[j, i] <= 0:
            continue
        apart = np.float32(0)
        for c in range(3):
            apart += (normal[y, x, c] - normal[j, i, c]) ** 2
        if apart < _BEND * _BEND:  # else an edge
            most = max(most, apart)
    # mirror_tangent: about sqrt(8) roughness^2
    return max(roughness, np.sqrt(np.float32(0.35355) * np.sqrt(most)))


@line_kernel(fastmath=_FAST)
def _surface_point(normal, position, y, x, anchor: Anchor, out):  # pragma: no cover - compiled
    """Normal and place of a pixel in anchor axes, into out[:6]; False where it has none."""
    rotation, offset = anchor.rotation, anchor.offset
    a, b, c = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
    length = a * a + b * b + c * c
    if not length > np.float32(1e-6):
        return False
    s = np.float32(1) / np.sqrt(length)
    p, q, r = position[y, x, 0], position[y, x, 1], position[y, x, 2]
    for k in range(3):
        out[k] = (rotation[k, 0] * a + rotation[k, 1] * b + rotation[k, 2] * c) * s
        out[3 + k] = rotation[k, 0] * p + rotation[k, 1] * q + rotation[k, 2] * r + offset[k]
    return True


@lru_cache(maxsize=1)
def split_sum() -> np.ndarray:
    """(ROUGHNESSES, COSINES, 2) float32 (a, b) for roughness and cosine of view from 0 to 1, both ends included."""
    a = np.maximum(np.linspace(0, 1, ROUGHNESSES), _SMOOTHEST)[:, None, None] ** 2
    nv = np.maximum(np.linspace(0, 1, COSINES), 1e-3)[:, None]
    k = np.arange(_MICROFACETS)
    r, phi = np.sqrt((k + 0.5) / _MICROFACETS), 2 * np.pi * (k * 0.6180339887498949 % 1)
    across = np.sqrt(1 - nv * nv)
    # the view direction where the surface is stretched to a half ball, of which it sees a disc
    sx, sz = a * across / np.hypot(a * across, nv), nv / np.hypot(a * across, nv)
    x, y = r * np.cos(phi), r * np.sin(phi)
    s = (1 + sz) / 2
    y = (1 - s) * np.sqrt(1 - x * x) + s * y
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    # across the view, up the disc (both unit) and along the view; then shrunk back
    hx, hy, hz = a * (z * sx - y * sz), a * x, np.maximum(y * sx + z * sz, 1e-9)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    vh = np.clip(across * hx + nv * hz, 0, 1)
    nl = 2 * vh * hz - nv
    a2, light = a * a, np.clip(nl, 1e-6, None)
    view = np.sqrt(a2 + (1 - a2) * nv * nv)
    # G2 over G1 of the view
    unmasked = np.where(nl > 0, light * (nv + view) / (light * view + nv * np.sqrt(a2 + (1 - a2) * light * light)), 0.0)
    grazing = (1 - vh) ** 5
    out = np.stack([((1 - grazing) * unmasked).mean(-1), (grazing * unmasked).mean(-1)], -1)
    return np.ascontiguousarray(out, np.float32)


@line_kernel(fastmath=_FAST)
def gloss_weights(table, roughness, cosine):  # pragma: no cover - compiled
    """(a, b) : F0 x a + b of what lies about the mirrored direction is reflected. table : `split_sum`, linear between entries"""
    one, zero = np.float32(1), np.float32(0)
    s = min(max(roughness, zero), one) * np.float32(table.shape[0] - 1)
    t = min(max(cosine, zero), one) * np.float32(table.shape[1] - 1)
    i, j = min(int(s), table.shape[0] - 2), min(int(t), table.shape[1] - 2)
    fs, ft = s - np.float32(i), t - np.float32(j)
    w00, w01, w10, w11 = (one - fs) * (one - ft), (one - fs) * ft, fs * (one - ft), fs * ft
    a = w00 * table[i, j, 0] + w01 * table[i, j + 1, 0] + w10 * table[i + 1, j, 0] + w11 * table[i + 1, j + 1, 0]
    b = w00 * table[i, j, 1] + w01 * table[i, j + 1, 1] + w10 * table[i + 1, j, 1] + w11 * table[i + 1, j + 1, 1]
    return a, b
