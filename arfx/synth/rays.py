"""Compiled rays against rectangles and spheres, and what of a light's disc a point sees.

Vectors are tuples of three numbers. Row layouts (float64):
rectangle  0-2 centre, 3-5 u, 6-8 v, 9-11 normal, 12 half width, 13 half height, 14 texture,
15 object, 16 gloss, 17 whether it is a face of a closed box
sphere     0-2 centre, 3 radius, 4-6 albedo, 7 object
light      0-2 unit vector towards it, 3-5 rgb, 6 tangent of half its angular size
"""

from __future__ import annotations

import math

from arfx.core.compiled import line_kernel

FAR = 1e30  # nothing is met
_DISC_SAMPLES = 16
_GOLDEN_ANGLE = 2.399963229728653


@line_kernel(error_model="numpy")
def vector(rows, i, first):
    """Three columns of row i as a vector."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


@line_kernel(error_model="numpy")
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@line_kernel(error_model="numpy")
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@line_kernel(error_model="numpy")
def shifted(a, by, b):
    """a + by * b"""
    return a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]


@line_kernel(error_model="numpy")
def divided(a, by):
    return a[0] / by, a[1] / by, a[2] / by


@line_kernel(error_model="numpy")
def rotated(rotation, a):
    """rotation (3, 3) @ a"""
    return (
        dot(vector(rotation, 0, 0), a),
        dot(vector(rotation, 1, 0), a),
        dot(vector(rotation, 2, 0), a),
    )


@line_kernel(error_model="numpy")
def _rectangle_at(start, towards, rects, i, farthest):
    """Where a ray meets rectangle i, in units of `towards`; `farthest` if not before.
    Without a division but for a ray that meets it: both sides are times |towards·n|."""
    offset, normal = minus(vector(rects, i, 0), start), vector(rects, i, 9)
    rise, away = dot(towards, normal), dot(offset, normal)
    if rise < 0.0:
        rise, away = -rise, -away
    if away <= 1e-9 * rise or away >= farthest * rise:
        return farthest
    for axis in range(2):
        across = vector(rects, i, 3 + 3 * axis)
        missed = abs(away * dot(towards, across) - dot(offset, across) * rise)
        if missed > rects[i, 12 + axis] * rise:
            return farthest
    return away / rise


@line_kernel(error_model="numpy")
def _sphere_at(start, towards, spheres, i, farthest):
    """Where a ray meets sphere i, in units of `towards`; `farthest` if not before."""
    offset, squared = minus(vector(spheres, i, 0), start), dot(towards, towards)
    middle = dot(offset, towards) / squared
    across = shifted(offset, -middle, towards)
    inside = spheres[i, 3] * spheres[i, 3] - dot(across, across)
    if inside <= 0.0:
        return farthest
    half = math.sqrt(inside / squared)
    at = middle - half if middle - half > 1e-9 else middle + half
    return at if 1e-9 < at < farthest else farthest


@line_kernel(error_model="numpy")
def nearest(start, towards, rects, spheres):
    """(distance in units of `towards`, or FAR; index of the first surface along a ray, a
    sphere's counted on behind the rectangles)."""
    best, index = FAR, -1
    for i in range(rects.shape[0]):
        at = _rectangle_at(start, towards, rects, i, best)
        if at < best:
            best, index = at, i
    for i in range(spheres.shape[0]):
        at = _sphere_at(start, towards, spheres, i, best)
        if at < best:
            best, index = at, rects.shape[0] + i
    return best, index


@line_kernel(error_model="numpy")
def _blocked(start, towards, rects, spheres, first):
    """Whether a ray meets anything from rectangle `first` on."""
    for i in range(first, rects.shape[0]):
        enters_box = rects[i, 17] > 0.0 and dot(towards, vector(rects, i, 9)) < 0.0
        if not enters_box and _rectangle_at(start, towards, rects, i, FAR) < FAR:
            return True
    for i in range(spheres.shape[0]):  # noqa: SIM110 - numba has no generators here
        if _sphere_at(start, towards, spheres, i, FAR) < FAR:
            return True
    return False


@line_kernel(error_model="numpy")
def _cone_meets(centre, radius, light, disc):
    """Whether a cone along the unit vector `light`, `disc` its slope, may meet a sphere;
    errs towards True.
    """
    along = dot(centre, light)
    radius = 1.0001 * radius + 1e-6  # rounding
    reach = radius + disc * (along + radius)
    return along >= -radius and dot(centre, centre) - along * along <= reach * reach


@line_kernel(error_model="numpy")
def _first_occluder(point, light, disc, rects, spheres):
    """The first rectangle that may stand before a part of a light's disc; their number if
    only spheres may, -1 if nothing.
    """
    for i in range(rects.shape[0]):
        normal = vector(rects, i, 9)
        rise = dot(light, normal)
        along = abs(rise) <= disc + 1e-9  # some rays may run along the plane
        if rects[i, 17] > 0.0 and rise < 0.0 and not along:
            continue  # what enters a box leaves it by another face
        offset = minus(vector(rects, i, 0), point)
        away = dot(offset, normal)
        if rise < 0.0:
            rise, away = -rise, -away
        if away <= 0.0 and not along:
            continue
        half_w, half_h = rects[i, 12], rects[i, 13]
        if along:
            if _cone_meets(
                offset, math.sqrt(half_w * half_w + half_h * half_h), light, disc
            ):
                return i
            continue
        # times rise: from the middle ray's meeting point to any other's
        spread = 1.0001 * away * ((1 + disc) * rise / (rise - disc) - 1) + 1e-6
        u, v = vector(rects, i, 3), vector(rects, i, 6)
        if abs(away * dot(light, u) - rise * dot(offset, u)) > rise * half_w + spread:
            continue
        if abs(away * dot(light, v) - rise * dot(offset, v)) <= rise * half_h + spread:
            return i
    for i in range(spheres.shape[0]):
        if _cone_meets(minus(vector(spheres, i, 0), point), spheres[i, 3], light, disc):
            return rects.shape[0]
    return -1


@line_kernel(error_model="numpy")
def visible(point, lights, k, rects, spheres, turn):
    """Fraction 0..1 of light k's disc that a point sees: five rays, and sixteen more where
    these disagree.
    """
    light, disc = vector(lights, k, 0), lights[k, 6]
    first = _first_occluder(point, light, disc, rects, spheres)
    if first < 0:
        return 1.0
    if disc == 0.0:
        return 0.0 if _blocked(point, light, rects, spheres, first) else 1.0
    x, y, z = light
    a = (0.0, z, -y) if abs(x) < 0.6 else (-z, 0.0, x)
    a = divided(a, math.sqrt(dot(a, a)))
    b = y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]
    visible_rays = 0
    for j in range(5 + _DISC_SAMPLES):
        if j == 5:
            if visible_rays == 0 or visible_rays == 5:
                return visible_rays / 5.0
            visible_rays = 0
        c, s = 0.0, 0.0
        if j >= 5:
            radius = disc * math.sqrt((j - 4.5) / _DISC_SAMPLES)
            angle = turn + (j - 5) * _GOLDEN_ANGLE
            c, s = math.cos(angle) * radius, math.sin(angle) * radius
        elif j < 2:  # four on the edge, then the middle
            c = disc * (1 - 2 * j)
        elif j < 4:
            s = disc * (5 - 2 * j)
        towards = shifted(shifted(light, c, a), s, b)
        if not _blocked(point, towards, rects, spheres, first):
            visible_rays += 1
    return visible_rays / _DISC_SAMPLES
