"""Compiled inner loops of the reference: random numbers, directions about a normal, and what a ray meets.

Arrays of positions, directions and light are float64, row by row; all axes are the anchor's but where it says otherwise.
Source: O'Neill 2014 (PCG); Burley 2020 (scrambled Sobol sequence)."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.colour import SRGB

_CODE = np.asarray(SRGB.decode(np.arange(256) / 255.0), float)
_U32 = np.uint32
_ONE = 1.0 / 4294967296.0
_DIRECTED = 1e-12  # shortest vector with a direction


class Surfaces(NamedTuple):
    """Of triangles (n). normals, colours (n, 3, 3) : of their corners;  shares (n, 3) : matt, mirrored (f0) and metal
    emission, face_normal (n, 3);  light_density (n,);  uv (n, 3, 2);  base, glow (n,) : their textures, -1 = none
    table (k, 3) : first texel, width, height;  texels (m, 3) uint8"""

    normals: np.ndarray
    colours: np.ndarray
    shares: np.ndarray
    emission: np.ndarray
    face_normal: np.ndarray
    light_density: np.ndarray
    uv: np.ndarray
    base: np.ndarray
    glow: np.ndarray
    table: np.ndarray
    texels: np.ndarray


@numba.njit(cache=True, nogil=True)
def _hashed(pixel, mix):  # pragma: no cover - compiled
    """32 bits of two numbers of 32 bits: the output permutation of PCG, twice."""
    s = _U32(pixel)
    for _ in range(2):  # products of 32 bits have 64: cut off each time
        s = _U32((s ^ mix) * _U32(747796405) + _U32(2891336453))
        s = _U32(((s >> ((s >> _U32(28)) + _U32(4))) ^ s) * _U32(277803737))
        s = _U32((s >> _U32(22)) ^ s)
    return s


@numba.njit(cache=True, nogil=True)
def hashed(pixel, mix):  # pragma: no cover - compiled
    """(n,) in [0, 1) from pixels (n,) uint32 and a uint32."""
    out = np.empty(len(pixel))
    for i in range(len(pixel)):
        out[i] = _hashed(pixel[i], mix) * _ONE
    return out


@numba.njit(cache=True, nogil=True)
def scrambled(bits, pixel, mix):  # pragma: no cover - compiled
    """(n,) in [0, 1) : a number whose 32 bits are given, lowest first, with each bit flipped by those before it (Owen)."""
    out = np.empty(len(pixel))
    for i in range(len(pixel)):
        x = _U32(_hashed(pixel[i], mix) + bits)
        x = _U32(x ^ x * _U32(0x6C50B47C))
        x = _U32(x ^ x * _U32(0xB82F1E52))
        x = _U32(x ^ x * _U32(0xC7AFE638))
        x = _U32(x ^ x * _U32(0x8D22F6E6))
        x = _U32(((x >> _U32(1)) & _U32(0x55555555)) | ((x & _U32(0x55555555)) << _U32(1)))
        x = _U32(((x >> _U32(2)) & _U32(0x33333333)) | ((x & _U32(0x33333333)) << _U32(2)))
        x = _U32(((x >> _U32(4)) & _U32(0x0F0F0F0F)) | ((x & _U32(0x0F0F0F0F)) << _U32(4)))
        x = _U32(((x >> _U32(8)) & _U32(0x00FF00FF)) | ((x & _U32(0x00FF00FF)) << _U32(8)))
        out[i] = _U32((x >> _U32(16)) | (x << _U32(16))) * _ONE
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _unit(x, y, z):  # pragma: no cover - compiled
    length = np.sqrt(x * x + y * y + z * z)
    if not (length > _DIRECTED and np.isfinite(length)):
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tangents(n0, n1, n2):  # pragma: no cover - compiled
    """Two unit vectors that make a right-handed frame with a unit normal."""
    x, y, z = _unit(-n2, 0.0, n0) if abs(n0) > 0.9 else _unit(0.0, -n2, n1)
    if abs(n0) > 0.9:
        x, y, z = _unit(n2, 0.0, -n0)
    return (x, y, z), (n1 * z - n2 * y, n2 * x - n0 * z, n0 * y - n1 * x)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def in_frame_of(normals, x, y, z):  # pragma: no cover - compiled
    """(n, 3) x, y, z (n,) in a frame whose z is the unit normal (n, 3)."""
    out = np.empty((len(x), 3))
    for i in range(len(x)):
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        u, v = _tangents(n0, n1, n2)
        out[i, 0] = x[i] * u[0] + y[i] * v[0] + z[i] * n0
        out[i, 1] = x[i] * u[1] + y[i] * v[1] + z[i] * n1
        out[i, 2] = x[i] * u[2] + y[i] * v[2] + z[i] * n2
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cosine_about(normals, u, v):  # pragma: no cover - compiled
    """(n, 3) unit, with a density as their cosine to the normals (n, 3), from two numbers (n,)."""
    x, y, z = np.empty(len(u)), np.empty(len(u)), np.empty(len(u))
    for i in range(len(u)):
        r, phi = np.sqrt(u[i]), 2 * np.pi * v[i]
        x[i], y[i], z[i] = r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[i])
    return in_frame_of(normals, x, y, z)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def disc_about(d, tangent, u, v):  # pragma: no cover - compiled
    """(n, 3) unit directions to points of a disc around d (3,), from two numbers (n,). tangent : of the disc's half-angle"""
    out = np.empty((len(u), 3))
    a, b = _tangents(d[0], d[1], d[2])
    for i in range(len(u)):
        r, phi = tangent * np.sqrt(u[i]), 2 * np.pi * v[i]
        x, y = r * np.cos(phi), r * np.sin(phi)
        k = 1 / np.sqrt(1 + r * r)
        for c in range(3):
            out[i, c] = (x * a[c] + y * b[c] + d[c]) * k
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cone_of_ball(points, normals, ball, near_radii, u, v):  # pragma: no cover - compiled
    """`reference_sampling.towards_ball`, from two numbers (n,). ball (4,) : centre, radius;  near_radii : how near is near"""
    n = len(u)
    out, density, near = np.empty((n, 3)), np.empty(n), np.empty(n, np.bool_)
    radius = ball[3]
    for i in range(n):
        x, y, z = ball[0] - points[i, 0], ball[1] - points[i, 1], ball[2] - points[i, 2]
        away = np.sqrt(x * x + y * y + z * z)
        near[i] = away < near_radii * radius
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        if near[i]:
            w0, w1, w2, up = n0, n1, n2, np.sqrt(1 - u[i])
        else:
            w0, w1, w2 = x / away, y / away, z / away
            cosine = np.sqrt(1 - (radius / away) ** 2)
            up = 1 - u[i] * (1 - cosine)
            density[i] = 1 / (2 * np.pi * (1 - cosine))
        a, b = _tangents(w0, w1, w2)
        r, phi = np.sqrt(max(1 - up * up, 0.0)), 2 * np.pi * v[i]
        s, t = r * np.cos(phi), r * np.sin(phi)
        d0, d1, d2 = (
            s * a[0] + t * b[0] + up * w0,
            s * a[1] + t * b[1] + up * w1,
            s * a[2] + t * b[2] + up * w2,
        )
        out[i, 0], out[i, 1], out[i, 2] = d0, d1, d2
        if near[i]:
            density[i] = max(n0 * d0 + n1 * d1 + n2 * d2, 1e-9) / np.pi
    return out, density, near


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_plane(axes, bounds, endless, origins, directions):  # pragma: no cover - compiled
    """(plane (n,), -1 = none; distance (n,), inf) of the nearest plane met from its front. endless (p,) : without ends"""
    n = len(origins)
    plane, distance = np.full(n, -1), np.full(n, np.inf)
    for i in range(n):
        for k in range(len(axes)):
            a = axes[k]
            falls = -(
                directions[i, 0] * a[3, 0] + directions[i, 1] * a[3, 1] + directions[i, 2] * a[3, 2]
            )
            if not falls > 1e-9:
                continue
            x, y, z = origins[i, 0] - a[0, 0], origins[i, 1] - a[0, 1], origins[i, 2] - a[0, 2]
            t = max(x * a[3, 0] + y * a[3, 1] + z * a[3, 2], 0.0) / falls
            if not 0 < t < distance[i]:
                continue
            x, y, z = x + t * directions[i, 0], y + t * directions[i, 1], z + t * directions[i, 2]
            u, v = x * a[1, 0] + y * a[1, 1] + z * a[1, 2], x * a[2, 0] + y * a[2, 1] + z * a[2, 2]
            within = bounds[k, 0] < u < bounds[k, 2] and bounds[k, 1] < v < bounds[k, 3]
            if within or endless[k]:
                plane[i], distance[i] = k, t
    return plane, distance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def picture_or(plate, at, corner, shown, means):  # pragma: no cover - compiled
    """((n, 3) radiance of a picture (h, w, 3) at pixels (n, 2), linear between them, where `shown` (n,) and inside, else `means`
    (n, 3); (n,) whether it is the picture's). corner (2,) : its first pixel"""
    h, w = plate.shape[:2]
    out, known = np.empty((len(at), 3)), np.empty(len(at), np.bool_)
    for i in range(len(at)):
        x, y = at[i, 0] - corner[0], at[i, 1] - corner[1]
        known[i] = shown[i] and 0 <= x <= w - 1 and 0 <= y <= h - 1
        if not known[i]:
            for c in range(3):
                out[i, c] = means[i, c]
            continue
        a, b = min(int(x), max(w - 2, 0)), min(int(y), max(h - 2, 0))
        a1, b1 = min(a + 1, w - 1), min(b + 1, h - 1)
        fx, fy = x - a, y - b
        for c in range(3):
            top = plate[b, a, c] * (1 - fx) + plate[b, a1, c] * fx
            out[i, c] = top * (1 - fy) + (plate[b1, a, c] * (1 - fx) + plate[b1, a1, c] * fx) * fy
    return out, known


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _on_cube(x, y, z):  # pragma: no cover - compiled
    """(face, u, v) as `core.cube.on_cube`."""
    a, b, c = abs(x), abs(y), abs(z)
    if not a + b + c > 0:
        return 0, 0.0, 0.0
    if a >= b and a >= c:
        return 0 + (x < 0), -z / a, y / a
    if b >= c:
        return 2 + (y < 0), x / b, -z / b
    return 4 + (z < 0), x / c, y / c


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_texel(faces, face, u, v, weight, out):  # pragma: no cover - compiled
    """out (3,) += weight x a cube (6, n, n, 3), linear between the texels of a face."""
    n = faces.shape[1]
    x, y = (
        min(max((u + 1) / 2 * n - 0.5, 0.0), n - 1.0),
        min(max((v + 1) / 2 * n - 0.5, 0.0), n - 1.0),
    )
    i, j = max(min(int(x), n - 2), 0), max(min(int(y), n - 2), 0)
    i1, j1 = min(i + 1, n - 1), min(j + 1, n - 1)
    fx, fy = x - i, y - j
    for c in range(3):
        top = faces[face, j, i, c] * (1 - fx) + faces[face, j, i1, c] * fx
        low = faces[face, j1, i, c] * (1 - fx) + faces[face, j1, i1, c] * fx
        out[c] += weight * (top * (1 - fy) + low * fy)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cube_radiance(narrow, broad, turn, directions, wide):  # pragma: no cover - compiled
    """(n, 3) radiance in directions (n, 3) of two cubes, broad with weight `wide` (n,), else narrow. turn : to the cubes' axes"""
    out = np.zeros((len(directions), 3))
    for i in range(len(directions)):
        d0, d1, d2 = directions[i, 0], directions[i, 1], directions[i, 2]
        face, u, v = _on_cube(
            turn[0, 0] * d0 + turn[0, 1] * d1 + turn[0, 2] * d2,
            turn[1, 0] * d0 + turn[1, 1] * d1 + turn[1, 2] * d2,
            turn[2, 0] * d0 + turn[2, 1] * d1 + turn[2, 2] * d2,
        )
        if wide[i] > 0:
            _add_texel(broad, face, u, v, wide[i], out[i])
        if wide[i] < 1:
            _add_texel(narrow, face, u, v, 1 - wide[i], out[i])
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _times_texel(of: Surfaces, k, u, v, out):  # pragma: no cover - compiled
    """out (3,) *= the texel of texture k there."""
    first, w, h = of.table[k, 0], of.table[k, 1], of.table[k, 2]
    x, y = (
        max(min(int((u - np.floor(u)) * w), w - 1), 0),
        max(min(int((v - np.floor(v)) * h), h - 1), 0),
    )
    for c in range(3):
        out[c] *= _CODE[of.texels[first + y * w + x, c]]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def surface_at(of: Surfaces, triangle, u, v):  # pragma: no cover - compiled
    """Normal, diffuse, specular, emission, face normal (n, 3 each) and light density (n,) at u, v (n,) of triangles (n,)."""
    n = len(triangle)
    normal, diffuse, specular = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    emission, face_normal, density = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    for i in range(n):
        t = triangle[i]
        q, r = float(u[i]), float(v[i])
        p = 1 - q - r
        a = of.normals[t]
        normal[i] = _unit(
            p * a[0, 0] + q * a[1, 0] + r * a[2, 0],
            p * a[0, 1] + q * a[1, 1] + r * a[2, 1],
            p * a[0, 2] + q * a[1, 2] + r * a[2, 2],
        )
        for c in range(3):
            diffuse[i, c] = (
                p * of.colours[t, 0, c] + q * of.colours[t, 1, c] + r * of.colours[t, 2, c]
            )
            emission[i, c], face_normal[i, c] = of.emission[t, c], of.face_normal[t, c]
        if of.base[t] >= 0 or of.glow[t] >= 0:
            x = p * of.uv[t, 0, 0] + q * of.uv[t, 1, 0] + r * of.uv[t, 2, 0]
            y = p * of.uv[t, 0, 1] + q * of.uv[t, 1, 1] + r * of.uv[t, 2, 1]
            if of.base[t] >= 0:
                _times_texel(of, of.base[t], x, y, diffuse[i])
            if of.glow[t] >= 0:
                _times_texel(of, of.glow[t], x, y, emission[i])
        matt, f0, metal = of.shares[t, 0], of.shares[t, 1], of.shares[t, 2]
        for c in range(3):
            specular[i, c] = f0 + diffuse[i, c] * metal
            diffuse[i, c] *= matt
        density[i] = of.light_density[t]
    return normal, diffuse, specular, emission, face_normal, density


@numba.njit(cache=True, nogil=True)
def dots(a, b):  # pragma: no cover - compiled
    """(n,) of vectors (n, 3)."""
    out = np.empty(len(a))
    for i in range(len(a)):
        out[i] = a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2]
    return out


@numba.njit(cache=True, nogil=True)
def facing(normal, towards, position, lift):  # pragma: no cover - compiled
    """Normals (n, 3) turned to the side of `towards`, positions that far over it, and the mirrored directions, (n, 3) each."""
    turned, start, mirrored = np.empty_like(normal), np.empty_like(normal), np.empty_like(normal)
    for i in range(len(normal)):
        cosine = (
            normal[i, 0] * towards[i, 0]
            + normal[i, 1] * towards[i, 1]
            + normal[i, 2] * towards[i, 2]
        )
        side = -1.0 if cosine < 0 else 1.0
        for c in range(3):
            turned[i, c] = side * normal[i, c]
            start[i, c] = position[i, c] + lift * turned[i, c]
            mirrored[i, c] = 2 * abs(cosine) * turned[i, c] - towards[i, c]
    return turned, start, mirrored


@numba.njit(cache=True, nogil=True)
def add_scaled(out, rows, weight, rgb):  # pragma: no cover - compiled
    """out[rows] += weight (m,) x rgb (3,)"""
    for k in range(len(rows)):
        for c in range(3):
            out[rows[k], c] += weight[k] * rgb[c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def share_of_ball(points, ball, times, least):  # pragma: no cover - compiled
    """(n,) from `least` to 1: so many times the part of the hemisphere that a ball (4,) may fill, from points (n, 3)."""
    out = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0] - ball[0], points[i, 1] - ball[1], points[i, 2] - ball[2]
        away2 = x * x + y * y + z * z
        out[i] = min(max(times * ball[3] ** 2 / away2, least), 1.0) if away2 > 0 else 1.0
    return out
