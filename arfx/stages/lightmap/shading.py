"""Radiance of every covered pixel of the virtual object under the light of its frame.

Diffuse: albedo times the light's radiance for the normal (soft harmonics and directional lights, `core.light`), each
directional light times what the object leaves of it. Gloss: Blinn and Phong's lobe of the half-vector, Schlick's Fresnel,
metals and dielectrics as in glTF 2.0; a light of some size widens it. What a camera adds where no light falls is added to
the object too.
Cost: O(covered pixels). Leaves out: the surroundings' picture in metals, light from the plane onto the object."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel

_FAST = {"contract", "nsz", "arcp"}


class Surface(NamedTuple):
    """Layers of the object over one rectangle."""

    coverage: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    albedo: np.ndarray
    material: np.ndarray
    emissive: np.ndarray


class Lights(NamedTuple):
    """Directional: towards, rgb (l, 3), widths (l,) of `highlight_width`; visibility (l, h, w);  soft_visibility (h, w)"""

    towards: np.ndarray
    rgb: np.ndarray
    widths: np.ndarray
    visibility: np.ndarray
    soft_visibility: np.ndarray


def harmonic_terms(soft: np.ndarray, ambient: np.ndarray) -> np.ndarray:
    """(9, 3) float32 factors of 1, y, z, x, xy, yz, 3z^2 - 1, xz, x^2 - y^2; without harmonics the first alone."""
    out = np.zeros((9, 3))
    if len(soft):
        c = [
            0.28209479177387814,
            *[0.4886025119029199] * 3,
            1.0925484305920792,
            1.0925484305920792,
            0.31539156525252005,
        ]
        out[:] = soft * np.array([*c, 1.0925484305920792, 0.5462742152960396])[:, None]
    else:
        out[0] = ambient
    return out.astype(np.float32)


def highlight_width(size_deg: np.ndarray) -> np.ndarray:
    """What a light's disc (full angle) adds to roughness^4: a disc of radius a spreads half-vectors by a^2 / 16, the lobe's
    own spread is roughness^4 / 2."""
    return (np.radians(np.asarray(size_deg, float) / 2) ** 2 / 8).astype(np.float32)


@line_kernel()
def covered_span(coverage):  # pragma: no cover - compiled
    """(first, last) covered pixel of a line, (0, -1) without one. Bare ones between cost less than leaving them out."""
    first, last = 0, coverage.shape[0] - 1
    while last >= 0 and not coverage[last] > 0:
        last -= 1
    while first < last and not coverage[first] > 0:
        first += 1
    return first, last


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def shade(
    surface: Surface, eye, lights: Lights, soft, constant, bias
):  # pragma: no cover - compiled
    """(h, w, 3) float32, premultiplied by the coverage.

    eye (3,) : the camera, WORLD frame;  soft (9, 3), constant : only its first row counts;  bias (3,)"""
    coverage, normal, position, albedo, material, emissive = surface
    towards, rgb, widths, visibility, soft_visibility = lights
    rows, columns = coverage.shape
    out = np.zeros((rows, columns, 3), np.float32)
    zero, one, two = np.float32(0), np.float32(1), np.float32(2)
    nx, ny, nz = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    vx, vy, vz = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    dr, dg, db = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    fr, fg, fb = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    r, g, b = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    width4, shine = np.empty(columns, np.float32), np.empty(columns, np.float32)
    edge = np.empty(columns, np.float32)
    lit, lobe, graze = (
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
        np.empty(columns, np.float32),
    )
    mantissa, whole = np.empty(columns, np.float32), np.empty(columns, np.float32)
    cosine = np.empty(columns, np.float32)
    cosine_bits, mantissa_bits, whole_bits = (
        cosine.view(np.int32),
        mantissa.view(np.int32),
        whole.view(np.int32),
    )
    for y in range(rows):
        first, last = covered_span(coverage[y])
        n = last + 1 - first
        if n == 0:
            continue
        normals, positions, colours = (
            normal[y, first : last + 1],
            position[y, first : last + 1],
            albedo[y, first : last + 1],
        )
        kinds, glow, cover = (
            material[y, first : last + 1],
            emissive[y, first : last + 1],
            coverage[y, first : last + 1],
        )
        line = out[y, first : last + 1]
        for i in range(n):
            nx[i], ny[i], nz[i] = normals[i, 0], normals[i, 1], normals[i, 2]
        if towards.shape[0] > 0:  # the way to the eye and the gloss's width are theirs alone
            for i in range(n):
                vx[i], vy[i], vz[i] = (
                    eye[0] - positions[i, 0],
                    eye[1] - positions[i, 1],
                    eye[2] - positions[i, 2],
                )
            for i in range(n):
                length = np.sqrt(vx[i] * vx[i] + vy[i] * vy[i] + vz[i] * vz[i])
                scale = one / max(length, np.float32(1e-12))
                vx[i] *= scale
                vy[i] *= scale
                vz[i] *= scale
            for i in range(n):
                # at grazing angles all is mirrored, unless the material is set not to be glossy at all (F0 under 4 %)
                edge[i] = kinds[i, 0] + (one - kinds[i, 0]) * min(two * kinds[i, 2], one)
                rough = max(kinds[i, 1], np.float32(0.05))
                width4[i] = rough * rough * rough * rough
        for i in range(n):
            metal = kinds[i, 0]
            base = np.float32(0.08) * kinds[i, 2] * (one - metal)
            diffuse_weight = (one - metal) * (one - base)
            dr[i], dg[i], db[i] = (
                colours[i, 0] * diffuse_weight,
                colours[i, 1] * diffuse_weight,
                colours[i, 2] * diffuse_weight,
            )
            fr[i], fg[i], fb[i] = (
                base + colours[i, 0] * metal,
                base + colours[i, 1] * metal,
                base + colours[i, 2] * metal,
            )
        if constant:
            for i in range(n):
                r[i] = (dr[i] + fr[i]) * soft[0, 0]
                g[i] = (dg[i] + fg[i]) * soft[0, 1]
                b[i] = (db[i] + fb[i]) * soft[0, 2]
        else:
            _soft_channel(r, dr, fr, nx, ny, nz, soft[:, 0], n)
            _soft_channel(g, dg, fg, nx, ny, nz, soft[:, 1], n)
            _soft_channel(b, db, fb, nx, ny, nz, soft[:, 2], n)
        soft_line = soft_visibility[y, first : last + 1]
        for i in range(n):
            r[i] *= soft_line[i]
            g[i] *= soft_line[i]
            b[i] *= soft_line[i]
        for k in range(towards.shape[0]):
            lx, ly, lz = towards[k, 0], towards[k, 1], towards[k, 2]
            lr, lg, lb, wide = rgb[k, 0], rgb[k, 1], rgb[k, 2], widths[k]
            for i in range(n):
                hx, hy, hz = lx + vx[i], ly + vy[i], lz + vz[i]
                scale = one / np.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
                cosine[i] = max((nx[i] * hx + ny[i] * hy + nz[i] * hz) * scale, np.float32(1e-8))
                away = one - min(max((vx[i] * hx + vy[i] * hy + vz[i] * hz) * scale, zero), one)
                graze[i] = edge[i] * (away * away * away * away * away)
                lit[i] = max(nx[i] * lx + ny[i] * ly + nz[i] * lz, zero)
                # Blinn's exponent of the GGX width roughness^2
                shine[i] = min(max(two / (width4[i] + wide) - two, one), np.float32(2000))
            # lobe = cosine ^ shine, as 2 ^ (shine log2 cosine)
            for i in range(n):
                mantissa_bits[i] = (cosine_bits[i] & np.int32(0x007FFFFF)) | np.int32(0x3F800000)
            for i in range(n):
                power = np.float32((cosine_bits[i] >> np.int32(23)) - np.int32(127))
                m = mantissa[i]
                upper = m > np.float32(1.41421356)
                m = m * np.float32(0.5) if upper else m
                power = power + one if upper else power
                z = (m - one) / (m + one)
                q = z * z
                rest = np.float32(0.57707802) + q * np.float32(0.41219858)
                series = z * (np.float32(2.88539008) + q * (np.float32(0.96179669) + q * rest))
                exponent = max(shine[i] * (power + series), np.float32(-126))
                nearest = np.int32(exponent + np.float32(128.5)) - np.int32(128)
                f = exponent - np.float32(nearest)
                rest = np.float32(0.00961813) + f * (
                    np.float32(0.00133336) + f * np.float32(0.00015404)
                )
                rest = np.float32(0.69314718) + f * (
                    np.float32(0.24022651) + f * (np.float32(0.05550411) + f * rest)
                )
                lobe[i] = one + f * rest
                whole_bits[i] = (nearest + np.int32(127)) << np.int32(23)
            for i in range(n):
                lobe[i] *= whole[i] * (shine[i] + np.float32(8)) * np.float32(0.125) * lit[i]
            line_visibility = visibility[k, y, first : last + 1]
            for i in range(n):
                visible = line_visibility[i]
                lit[i] *= visible
                lobe[i] *= visible
            for i in range(n):
                r[i] += lr * (dr[i] * lit[i] + (fr[i] + (one - fr[i]) * graze[i]) * lobe[i])
            for i in range(n):
                g[i] += lg * (dg[i] * lit[i] + (fg[i] + (one - fg[i]) * graze[i]) * lobe[i])
            for i in range(n):
                b[i] += lb * (db[i] * lit[i] + (fb[i] + (one - fb[i]) * graze[i]) * lobe[i])
        for i in range(n):
            c = cover[i]
            line[i, 0] = c * (r[i] + glow[i, 0] + bias[0])
            line[i, 1] = c * (g[i] + glow[i, 1] + bias[1])
            line[i, 2] = c * (b[i] + glow[i, 2] + bias[2])
    return out


@line_kernel(fastmath=_FAST, error_model="numpy")
def _soft_channel(out, diffuse, mirror, nx, ny, nz, s, n):  # pragma: no cover - compiled
    """One line of one colour: (diffuse + mirror) x the soft light of the normals, which is never below 0."""
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]
    for i in range(n):
        x, y, z = nx[i], ny[i], nz[i]
        light = (
            s0 + s1 * y + s2 * z + s3 * x + (s4 * y + s7 * z + s8 * x) * x + (s5 * z - s8 * y) * y
        )
        light = light + s6 * (np.float32(3) * z * z - np.float32(1))
        out[i] = (diffuse[i] + mirror[i]) * max(light, np.float32(0))
