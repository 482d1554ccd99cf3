"""Compiled rays: rectangles and spheres, lit directly with true shadows, textures averaged
exactly over a footprint.

A texture is a summed-area table. Its bilinear interpolation integrates a picture of
constant cells exactly, so the edges of a print are anti-aliased without sampling error
(Crow 1984, "Summed-area tables for texture mapping"). Radiance follows arfx.core.light:
ambient + sum of rgb * max(n·d, 0) * visible, times albedo.

Row layouts (float64):
rectangle  0-2 centre, 3-5 u, 6-8 v, 9-11 normal, 12 half width, 13 half height, 14 texture,
15 object, 16 gloss,
           17 whether it is a face of a closed box
sphere     0-2 centre, 3 radius, 4-6 albedo, 7 object
light      0-2 unit vector towards it, 3-5 rgb, 6 tangent of half its angular size
texture    0 offset into the table, 1 columns, 2 rows, 3 smallest box in texels (0: cells
stay hard-edged)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from arfx.core.compiled import line_kernel
from arfx.synth.shadows import occluders, visible

_FAR = 1e30
_NUMBERS = 65521  # below 2^16, prime: of two surfaces under many lights few get the same
# start of a shadow ray above its surface: float64 hit points are off by 1e-15 m, sheets lie
# 2e-4 m apart
_LIFT_M = 2e-5


class Lens(NamedTuple):
    """rays (h, w, 2) float: camera directions, z = 1 left out; NaN = the lens maps nothing
    there, stays black
    rotation (3, 3), origin (3,): room_from_camera;  lens_m: diameter of the aperture;
    focus_m: distance of focus
    """

    rays: np.ndarray
    rotation: np.ndarray
    origin: np.ndarray
    lens_m: float
    focus_m: float


class Room(NamedTuple):
    """What there is, by rows, and its ambient light (3,);  table: of the textures
    sky (h, w, 3): radiance by direction, (0, ...) = black"""

    rects: np.ndarray
    spheres: np.ndarray
    lights: np.ndarray
    ambient: np.ndarray
    textures: np.ndarray
    table: np.ndarray
    sky: np.ndarray


class Samples(NamedTuple):
    """One sample in every chosen (h, w) bool pixel, of this weight.

    footprint: width in pixels that it stands for
    """

    chosen: np.ndarray
    footprint: float
    weight: float
    seed: int


@njit(cache=True, nogil=True, error_model="numpy")
def _views(origin, rects, textures):
    """(n, 5): way from a point to each rectangle's centre along its normal, u and v, m; its
    texels per m along u and v.
    """
    out = np.empty((rects.shape[0], 5))
    for i in range(rects.shape[0]):
        px, py, pz = (
            rects[i, 0] - origin[0],
            rects[i, 1] - origin[1],
            rects[i, 2] - origin[2],
        )
        out[i, 0] = px * rects[i, 9] + py * rects[i, 10] + pz * rects[i, 11]
        out[i, 1] = px * rects[i, 3] + py * rects[i, 4] + pz * rects[i, 5]
        out[i, 2] = px * rects[i, 6] + py * rects[i, 7] + pz * rects[i, 8]
        tex = int(rects[i, 14])
        if tex < textures.shape[0]:
            out[i, 3], out[i, 4] = (
                textures[tex, 1] / (2 * rects[i, 12]),
                textures[tex, 2] / (2 * rects[i, 13]),
            )
    return out


@line_kernel(error_model="numpy")
def _nearest(origin, ex, ey, ez, dx, dy, dz, rects, views, spheres):
    """(distance in units of d, kind 0 none 1 rectangle 2 sphere, index) of the first
    surface along a ray from origin + e. Rectangles are tested without a division: their
    offsets from the origin are known, and both sides are times |d·n|."""
    best, kind, index = _FAR, 0, -1
    for i in range(rects.shape[0]):
        dn = dx * rects[i, 9] + dy * rects[i, 10] + dz * rects[i, 11]
        away = views[i, 0] - (ex * rects[i, 9] + ey * rects[i, 10] + ez * rects[i, 11])
        if dn < 0.0:
            dn, away = -dn, -away
        if away <= 1e-9 * dn or away >= best * dn:
            continue
        pu = views[i, 1] - (ex * rects[i, 3] + ey * rects[i, 4] + ez * rects[i, 5])
        if (
            abs(away * (dx * rects[i, 3] + dy * rects[i, 4] + dz * rects[i, 5]) - pu * dn)
            > rects[i, 12] * dn
        ):
            continue
        pv = views[i, 2] - (ex * rects[i, 6] + ey * rects[i, 7] + ez * rects[i, 8])
        if (
            abs(away * (dx * rects[i, 6] + dy * rects[i, 7] + dz * rects[i, 8]) - pv * dn)
            <= rects[i, 13] * dn
        ):
            best, kind, index = away / dn, 1, i
    for i in range(spheres.shape[0]):
        px, py, pz = (
            spheres[i, 0] - origin[0] - ex,
            spheres[i, 1] - origin[1] - ey,
            spheres[i, 2] - origin[2] - ez,
        )
        a = dx * dx + dy * dy + dz * dz
        b = px * dx + py * dy + pz * dz
        c = px * px + py * py + pz * pz - spheres[i, 3] * spheres[i, 3]
        if b * b < a * c * (1 - 1e-9):  # passes by, rounding left to the exact test below
            continue
        b /= a
        cx, cy, cz = px - b * dx, py - b * dy, pz - b * dz
        h = spheres[i, 3] * spheres[i, 3] - (cx * cx + cy * cy + cz * cz)
        if h <= 0.0:
            continue
        half = math.sqrt(h / a)
        t = b - half if b - half > 1e-9 else b + half
        if 1e-9 < t < best:
            best, kind, index = t, 2, i
    return best, kind, index


@line_kernel(error_model="numpy")
def _noise(seed, n):
    """0..1 from two integers: the finaliser of MurmurHash3."""
    h = (np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15)) ^ (
        np.uint64(n) * np.uint64(0xC2B2AE3D27D4EB4F)
    )
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xFF51AFD7ED558CCD)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xC4CEB9FE1A85EC53)
    h ^= h >> np.uint64(33)
    return float(h >> np.uint64(11)) / 9007199254740992.0


@line_kernel(error_model="numpy")
def _corner(table, offset, columns, x, y):
    """Integral of a texture's three channels over the box from its first corner to (x, y)."""
    ix, iy = int(x), int(y)
    fx, fy = x - ix, y - iy
    row = 3 * (columns + 1)
    at = offset + iy * row + 3 * ix
    w = (1 - fx) * (1 - fy)
    r, g, b = w * table[at], w * table[at + 1], w * table[at + 2]
    if fx > 0.0:
        w = fx * (1 - fy)
        r, g, b = r + w * table[at + 3], g + w * table[at + 4], b + w * table[at + 5]
    if fy > 0.0:
        w = (1 - fx) * fy
        at += row
        r, g, b = r + w * table[at], g + w * table[at + 1], b + w * table[at + 2]
        if fx > 0.0:
            w = fx * fy
            r, g, b = r + w * table[at + 3], g + w * table[at + 4], b + w * table[at + 5]
    return r, g, b


@line_kernel(error_model="numpy")
def _mean(table, offset, columns, left, right, top, bottom):
    """Mean of a texture's three channels over a box, texels."""
    r0, g0, b0 = _corner(table, offset, columns, right, bottom)
    r1, g1, b1 = _corner(table, offset, columns, left, bottom)
    r2, g2, b2 = _corner(table, offset, columns, left, top)
    r3, g3, b3 = _corner(table, offset, columns, right, top)
    scale = 1.0 / ((right - left) * (bottom - top))
    return (
        (r0 - r1 + (r2 - r3)) * scale,
        (g0 - g1 + (g2 - g3)) * scale,
        (b0 - b1 + (b2 - b3)) * scale,
    )


@line_kernel(error_model="numpy")
def _span(centre, half, size):
    """A box of the texture along one axis, kept inside it without becoming empty."""
    half = max(half, 1e-4)
    low, high = max(centre - half, 0.0), min(centre + half, float(size))
    if high - low < 1e-6:
        low, high = (0.0, min(1e-4, size)) if centre <= 0 else (size - 1e-4, float(size))
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def render_rows(y0, y1, lens: Lens, room: Room, samples: Samples, out, met):
    """Add samples of rows y0..y1 to `out` (h, w, 3).
    met (h, w) uint16 gets a number for the surface and the lights that it sees; 0 where it
    sees a part of one, and on a print"""
    views, shadows = (
        _views(lens.origin, room.rects, room.textures),
        occluders(room.rects, room.spheres, room.lights),
    )
    _render(y0, y1, lens, room, (views, shadows), samples, out, met)


@line_kernel(error_model="numpy")
def _render(y0, y1, lens: Lens, room: Room, tables, samples: Samples, out, met):
    """As `render_rows`, with the tables of `_views` and `occluders`."""
    rays, rotation, origin, lens_m, focus_m = lens
    rects, spheres, lights, ambient, textures, table, sky = room
    width = rays.shape[1]
    views, (occluder_rows, used) = tables
    chosen, footprint, weight, seed = samples
    for y in range(y0, y1):
        for x in range(width):
            if not chosen[y, x]:
                continue
            met[y, x] = 1
            cx, cy = rays[y, x, 0], rays[y, x, 1]
            if not (math.isfinite(cx) and math.isfinite(cy)):
                continue
            x2 = x + 1 if x + 1 < width else x - 1
            y2 = y + 1 if y + 1 < rays.shape[0] else y - 1
            ux, uy = (rays[y, x2, 0] - cx) * footprint, (rays[y, x2, 1] - cy) * footprint
            vx, vy = (rays[y2, x, 0] - cx) * footprint, (rays[y2, x, 1] - cy) * footprint
            if not math.isfinite(
                ux + uy
            ):  # the neighbour lies beyond the lens's field: assume square pixels
                ux, uy = vy, -vx
            if not math.isfinite(vx + vy):
                vx, vy = -uy, ux
            if not math.isfinite(ux + uy + vx + vy):
                ux, uy, vx, vy = 0.0, 0.0, 0.0, 0.0
            ex, ey = 0.0, 0.0
            number = y * width + x
            if lens_m > 0.0:
                radius = 0.5 * lens_m * math.sqrt(_noise(seed, 2 * number))
                angle = 2 * math.pi * _noise(seed, 2 * number + 1)
                ex, ey = radius * math.cos(angle), radius * math.sin(angle)
                cx, cy = cx - ex / focus_m, cy - ey / focus_m
            rx = rotation[0, 0] * ex + rotation[0, 1] * ey
            ry = rotation[1, 0] * ex + rotation[1, 1] * ey
            rz = rotation[2, 0] * ex + rotation[2, 1] * ey
            dx = rotation[0, 0] * cx + rotation[0, 1] * cy + rotation[0, 2]
            dy = rotation[1, 0] * cx + rotation[1, 1] * cy + rotation[1, 2]
            dz = rotation[2, 0] * cx + rotation[2, 1] * cy + rotation[2, 2]
            t, kind, index = _nearest(origin, rx, ry, rz, dx, dy, dz, rects, views, spheres)
            if kind == 0:
                if sky.shape[0] > 0:
                    size = math.sqrt(dx * dx + dy * dy + dz * dz)
                    sx = (
                        int((0.5 - math.atan2(dy, dx) / (2 * math.pi)) * sky.shape[1])
                        % sky.shape[1]
                    )
                    sy = min(
                        int((0.5 - math.asin(dz / size) / math.pi) * sky.shape[0]),
                        sky.shape[0] - 1,
                    )
                    for c in range(3):
                        out[y, x, c] += weight * sky[sy, sx, c]
                continue
            hx, hy, hz = (
                origin[0] + rx + t * dx,
                origin[1] + ry + t * dy,
                origin[2] + rz + t * dz,
            )
            gloss = 0.0
            if kind == 1:
                nx, ny, nz = rects[index, 9], rects[index, 10], rects[index, 11]
                dn = dx * nx + dy * ny + dz * nz
                per_dn = 1.0 / dn
                wide, high = (
                    0.0,
                    0.0,
                )  # half extents of the footprint on the surface, along u and v
                for k in range(2):
                    fx, fy = (ux, uy) if k == 0 else (vx, vy)
                    gx = rotation[0, 0] * fx + rotation[0, 1] * fy
                    gy = rotation[1, 0] * fx + rotation[1, 1] * fy
                    gz = rotation[2, 0] * fx + rotation[2, 1] * fy
                    slide = (gx * nx + gy * ny + gz * nz) * per_dn
                    gx, gy, gz = (
                        t * (gx - slide * dx),
                        t * (gy - slide * dy),
                        t * (gz - slide * dz),
                    )
                    a, b = (
                        gx * rects[index, 3] + gy * rects[index, 4] + gz * rects[index, 5],
                        gx * rects[index, 6] + gy * rects[index, 7] + gz * rects[index, 8],
                    )
                    wide += a * a
                    high += b * b
                tex = int(rects[index, 14])
                offset, columns, rows = (
                    int(textures[tex, 0]),
                    int(textures[tex, 1]),
                    int(textures[tex, 2]),
                )
                per_u, per_v = views[index, 3], views[index, 4]
                qx, qy, qz = (
                    hx - rects[index, 0],
                    hy - rects[index, 1],
                    hz - rects[index, 2],
                )
                tx = (
                    qx * rects[index, 3]
                    + qy * rects[index, 4]
                    + qz * rects[index, 5]
                    + rects[index, 12]
                ) * per_u
                ty = (
                    rects[index, 13]
                    - (qx * rects[index, 6] + qy * rects[index, 7] + qz * rects[index, 8])
                ) * per_v
                left, right = _span(
                    tx, max(0.5 * math.sqrt(wide) * per_u, 0.5 * textures[tex, 3]), columns
                )
                top, bottom = _span(
                    ty, max(0.5 * math.sqrt(high) * per_v, 0.5 * textures[tex, 3]), rows
                )
                colour = _mean(table, offset, columns, left, right, top, bottom)
                gloss = rects[index, 16]
                if dn > 0.0:
                    nx, ny, nz = -nx, -ny, -nz
            else:
                nx, ny, nz = (
                    (hx - spheres[index, 0]) / spheres[index, 3],
                    (hy - spheres[index, 1]) / spheres[index, 3],
                    (hz - spheres[index, 2]) / spheres[index, 3],
                )
                colour = (spheres[index, 4], spheres[index, 5], spheres[index, 6])
            light0, light1, light2 = ambient[0], ambient[1], ambient[2]
            shine0, shine1, shine2 = 0.0, 0.0, 0.0
            px, py, pz = hx + _LIFT_M * nx, hy + _LIFT_M * ny, hz + _LIFT_M * nz
            turn = 2 * math.pi * _noise(seed + 7, number)
            whole = (
                kind == 2 or textures[int(rects[index, 14]), 3] > 0.0
            )  # hard edges of a print are in its texture
            number_met = (index if kind == 1 else rects.shape[0] + index) + 1
            for k in range(lights.shape[0]):
                facing = nx * lights[k, 0] + ny * lights[k, 1] + nz * lights[k, 2]
                number_met *= 2
                if facing <= 0.0:
                    continue
                seen = visible(px, py, pz, lights, k, occluder_rows, used[k], spheres, turn)
                whole = whole and (seen == 0.0 or seen == 1.0)
                if seen == 0.0:
                    continue
                number_met += 1
                light0 += seen * facing * lights[k, 3]
                light1 += seen * facing * lights[k, 4]
                light2 += seen * facing * lights[k, 5]
                if gloss > 0.0:
                    size = math.sqrt(dx * dx + dy * dy + dz * dz)
                    bx, by, bz = (
                        lights[k, 0] - dx / size,
                        lights[k, 1] - dy / size,
                        lights[k, 2] - dz / size,
                    )
                    half = (nx * bx + ny * by + nz * bz) / math.sqrt(
                        bx * bx + by * by + bz * bz
                    )
                    peak = seen * gloss * max(half, 0.0) ** 40
                    shine0, shine1, shine2 = (
                        shine0 + peak * lights[k, 3],
                        shine1 + peak * lights[k, 4],
                        shine2 + peak * lights[k, 5],
                    )
            out[y, x, 0] += weight * (colour[0] * light0 + shine0)
            out[y, x, 1] += weight * (colour[1] * light1 + shine1)
            out[y, x, 2] += weight * (colour[2] * light2 + shine2)
            met[y, x] = 2 + number_met % _NUMBERS if whole else 0


@njit(cache=True, nogil=True, error_model="numpy")
def probe(rays, rotation, origin, rects, spheres, depth, owner):
    """Depth along the axis (0 = nothing) and object number (0 = nothing) at the rays (h, w,
    2) of pixel centres.
    """
    views = _views(origin, rects, np.zeros((0, 4)))
    for y in range(rays.shape[0]):
        for x in range(rays.shape[1]):
            cx, cy = rays[y, x, 0], rays[y, x, 1]
            depth[y, x], owner[y, x] = 0.0, 0
            if not (math.isfinite(cx) and math.isfinite(cy)):
                continue
            dx = rotation[0, 0] * cx + rotation[0, 1] * cy + rotation[0, 2]
            dy = rotation[1, 0] * cx + rotation[1, 1] * cy + rotation[1, 2]
            dz = rotation[2, 0] * cx + rotation[2, 1] * cy + rotation[2, 2]
            t, kind, index = _nearest(
                origin, 0.0, 0.0, 0.0, dx, dy, dz, rects, views, spheres
            )
            if kind == 1:
                depth[y, x], owner[y, x] = t, int(rects[index, 15])
            elif kind == 2:
                depth[y, x], owner[y, x] = t, int(spheres[index, 7])


@njit(cache=True, nogil=True, error_model="numpy")
def unoccluded(points, origin, rects, spheres, out):
    """out[i] = nothing stands between the origin and room point i (n, 3)."""
    views = _views(origin, rects, np.zeros((0, 4)))
    for i in range(points.shape[0]):
        dx, dy, dz = (
            points[i, 0] - origin[0],
            points[i, 1] - origin[1],
            points[i, 2] - origin[2],
        )
        size = math.sqrt(dx * dx + dy * dy + dz * dz)
        out[i] = (
            _nearest(origin, 0.0, 0.0, 0.0, dx, dy, dz, rects, views, spheres)[0]
            >= 1.0 - _LIFT_M / size
        )
