"""Compiled shadows: what of a light's disc a point sees. Row layouts are those of
arfx.synth.tracer.

`occluders` finds once per time what can occlude each light at all, so that few are tested
for a point. Row of an occluder (float64), for one light l and one rectangle, its normal
turned to the light's side: 0-3 normal n and n·centre, 4-7 u and u·centre, 8-11 v and
v·centre, 12 half width, 13 half height, 14-15 u·l / n·l and v·l / n·l, 16 growth of the
disc's shadow per m along n, 17 radius if some rays to the disc run along the plane, else 0
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from arfx.core.compiled import line_kernel

_DISC_SAMPLES = 16
_GOLDEN_ANGLE = 2.399963229728653


@njit(cache=True, nogil=True, error_model="numpy")
def occluders(rects, spheres, lights):
    """rows (lights, n, 18) and how many of each light's rows are in use.
    Left out are the faces by which light enters a closed box, since it leaves by another,
    and a rectangle that has nothing behind it."""
    rows, used = (
        np.zeros((lights.shape[0], rects.shape[0], 18)),
        np.zeros(lights.shape[0], np.int64),
    )
    for k in range(lights.shape[0]):
        disc = lights[k, 6]
        for i in range(rects.shape[0]):
            rise = (
                lights[k, 0] * rects[i, 9]
                + lights[k, 1] * rects[i, 10]
                + lights[k, 2] * rects[i, 11]
            )
            along = abs(rise) <= disc + 1e-9
            if not along and (
                (rects[i, 17] > 0.0 and rise < 0.0)
                or not _something_behind(rects, spheres, i, rise > 0.0)
            ):
                continue
            row = rows[k, used[k]]
            used[k] += 1
            side = 1.0 if rise > 0.0 else -1.0
            rise = abs(rise)
            for c in range(3):
                row[c], row[4 + c], row[8 + c] = (
                    side * rects[i, 9 + c],
                    rects[i, 3 + c],
                    rects[i, 6 + c],
                )
            for first in (0, 4, 8):
                row[first + 3] = (
                    row[first] * rects[i, 0]
                    + row[first + 1] * rects[i, 1]
                    + row[first + 2] * rects[i, 2]
                )
            row[12], row[13] = rects[i, 12], rects[i, 13]
            if along:
                row[17] = math.sqrt(row[12] * row[12] + row[13] * row[13])
                continue
            row[14] = (
                row[4] * lights[k, 0] + row[5] * lights[k, 1] + row[6] * lights[k, 2]
            ) / rise
            row[15] = (
                row[8] * lights[k, 0] + row[9] * lights[k, 1] + row[10] * lights[k, 2]
            ) / rise
            row[16] = 1.0001 * ((1 + disc) / (rise - disc) - 1 / rise)
    return rows, used


@njit(cache=True, nogil=True, error_model="numpy")
def _something_behind(rects, spheres, i, above):
    """Whether any surface reaches to the side of rectangle i that its light does not come from."""
    side = 1.0 if above else -1.0
    nx, ny, nz = side * rects[i, 9], side * rects[i, 10], side * rects[i, 11]
    level = nx * rects[i, 0] + ny * rects[i, 1] + nz * rects[i, 2] - 1e-9
    for j in range(rects.shape[0]):
        middle = nx * rects[j, 0] + ny * rects[j, 1] + nz * rects[j, 2]
        across = abs(nx * rects[j, 3] + ny * rects[j, 4] + nz * rects[j, 5]) * rects[j, 12]
        across += abs(nx * rects[j, 6] + ny * rects[j, 7] + nz * rects[j, 8]) * rects[j, 13]
        if middle - across < level:
            return True
    for j in range(spheres.shape[0]):
        if (
            nx * spheres[j, 0] + ny * spheres[j, 1] + nz * spheres[j, 2] - spheres[j, 3]
            < level
        ):
            return True
    return False


@line_kernel(error_model="numpy")
def _first_occluder(point, towards, disc, rows, k, used, spheres):
    """First rectangle that may meet a ray from a point to light k's disc; `used` if only
    spheres may, -1 if nothing.
    """
    (px, py, pz), (lx, ly, lz) = point, towards
    for i in range(used):
        away = rows[k, i, 3] - (
            px * rows[k, i, 0] + py * rows[k, i, 1] + pz * rows[k, i, 2]
        )
        if rows[k, i, 17] > 0.0:
            cu = rows[k, i, 7] - (
                px * rows[k, i, 4] + py * rows[k, i, 5] + pz * rows[k, i, 6]
            )
            cv = rows[k, i, 11] - (
                px * rows[k, i, 8] + py * rows[k, i, 9] + pz * rows[k, i, 10]
            )
            cx = away * rows[k, i, 0] + cu * rows[k, i, 4] + cv * rows[k, i, 8]
            cy = away * rows[k, i, 1] + cu * rows[k, i, 5] + cv * rows[k, i, 9]
            cz = away * rows[k, i, 2] + cu * rows[k, i, 6] + cv * rows[k, i, 10]
            if _cone_meets(cx, cy, cz, lx, ly, lz, disc, rows[k, i, 17]):
                return i
            continue
        if away <= 0.0:
            continue  # every ray leaves the plane
        spread = (
            away * rows[k, i, 16] + 1e-6
        )  # from the middle ray's meeting point to any other's
        qu = (
            away * rows[k, i, 14]
            - rows[k, i, 7]
            + (px * rows[k, i, 4] + py * rows[k, i, 5] + pz * rows[k, i, 6])
        )
        if abs(qu) > rows[k, i, 12] + spread:
            continue
        qv = (
            away * rows[k, i, 15]
            - rows[k, i, 11]
            + (px * rows[k, i, 8] + py * rows[k, i, 9] + pz * rows[k, i, 10])
        )
        if abs(qv) <= rows[k, i, 13] + spread:
            return i
    for i in range(spheres.shape[0]):
        cx, cy, cz = spheres[i, 0] - px, spheres[i, 1] - py, spheres[i, 2] - pz
        if _cone_meets(cx, cy, cz, lx, ly, lz, disc, spheres[i, 3]):
            return used
    return -1


@line_kernel(error_model="numpy")
def _cone_meets(cx, cy, cz, lx, ly, lz, disc, radius):
    """Whether a cone along unit l from the origin, `disc` its slope, may meet the sphere;
    errs towards True.
    """
    along = cx * lx + cy * ly + cz * lz
    radius = 1.0001 * radius + 1e-6  # rounding
    if along < -radius:
        return False
    across = cx * cx + cy * cy + cz * cz - along * along
    reach = radius + disc * (along + radius)
    return across <= reach * reach


@line_kernel(error_model="numpy")
def _blocked(point, towards, rows, k, first, used, spheres):
    """Whether a ray meets a rectangle of light k's rows first..used, or a sphere."""
    (px, py, pz), (lx, ly, lz) = point, towards
    for i in range(first, used):
        rise = lx * rows[k, i, 0] + ly * rows[k, i, 1] + lz * rows[k, i, 2]
        away = rows[k, i, 3] - (
            px * rows[k, i, 0] + py * rows[k, i, 1] + pz * rows[k, i, 2]
        )
        if rise < 0.0:
            rise, away = -rise, -away
        if away <= 1e-9 * rise:
            continue
        qu = away * (lx * rows[k, i, 4] + ly * rows[k, i, 5] + lz * rows[k, i, 6])
        qu -= rise * (
            rows[k, i, 7] - (px * rows[k, i, 4] + py * rows[k, i, 5] + pz * rows[k, i, 6])
        )
        if abs(qu) > rise * rows[k, i, 12]:
            continue
        qv = away * (lx * rows[k, i, 8] + ly * rows[k, i, 9] + lz * rows[k, i, 10])
        qv -= rise * (
            rows[k, i, 11] - (px * rows[k, i, 8] + py * rows[k, i, 9] + pz * rows[k, i, 10])
        )
        if abs(qv) <= rise * rows[k, i, 13] and rise > 0.0:
            return True
    return _meets_a_sphere(px, py, pz, lx, ly, lz, spheres)


@line_kernel(error_model="numpy")
def _meets_a_sphere(ox, oy, oz, dx, dy, dz, spheres):
    """Whether a ray meets any sphere."""
    for i in range(spheres.shape[0]):
        px, py, pz = spheres[i, 0] - ox, spheres[i, 1] - oy, spheres[i, 2] - oz
        a = dx * dx + dy * dy + dz * dz
        b = (px * dx + py * dy + pz * dz) / a
        cx, cy, cz = px - b * dx, py - b * dy, pz - b * dz
        h = spheres[i, 3] * spheres[i, 3] - (cx * cx + cy * cy + cz * cz)
        if h > 0.0 and b + math.sqrt(h / a) > 1e-9:
            return True
    return False


@line_kernel(error_model="numpy")
def visible(px, py, pz, lights, k, rows, used, spheres, turn):
    """Fraction 0..1 of light k's disc that a point sees: five rays, and sixteen more where
    these disagree.
    """
    lx, ly, lz, disc = lights[k, 0], lights[k, 1], lights[k, 2], lights[k, 6]
    point = px, py, pz
    first = _first_occluder(point, (lx, ly, lz), disc, rows, k, used, spheres)
    if first < 0:
        return 1.0
    if disc == 0.0:
        return 0.0 if _blocked(point, (lx, ly, lz), rows, k, first, used, spheres) else 1.0
    if abs(lx) < 0.6:
        ax, ay, az = 0.0, lz, -ly
    else:
        ax, ay, az = -lz, 0.0, lx
    n = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / n, ay / n, az / n
    bx, by, bz = ly * az - lz * ay, lz * ax - lx * az, lx * ay - ly * ax
    visible_rays = 0
    for j in range(5 + _DISC_SAMPLES):
        if j == 5:
            if visible_rays == 0 or visible_rays == 5:
                return visible_rays / 5.0
            visible_rays = 0
        c, s = 0.0, 0.0
        if j >= 5:
            radius, angle = (
                disc * math.sqrt((j - 4.5) / _DISC_SAMPLES),
                turn + (j - 5) * _GOLDEN_ANGLE,
            )
            c, s = math.cos(angle) * radius, math.sin(angle) * radius
        elif j < 2:  # four on the edge, then the middle
            c = disc * (1 - 2 * j)
        elif j < 4:
            s = disc * (5 - 2 * j)
        towards = lx + c * ax + s * bx, ly + c * ay + s * by, lz + c * az + s * bz
        if not _blocked(point, towards, rows, k, first, used, spheres):
            visible_rays += 1
    return visible_rays / _DISC_SAMPLES
