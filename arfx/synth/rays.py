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
from arfx.core.vectors import cross, dot, minus, shifted, unit, vector

FAR = 1e30  # nothing is met
_DISC_SAMPLES = 16
_GOLDEN_ANGLE = 2.399963229728653


@line_kernel(error_model="numpy")
def _rectangle_at(start, towards, rects, i, farthest):
    """Where a ray meets rectangle i, in units of `towards`; `farthest` if not before.
    Without a division but for a ray that meets it: both sides are times |towards·n|."""
    offset, normal = minus(vector(rects[i]), start), vector(rects[i, 9:])
    rise, away = dot(towards, normal), dot(offset, normal)
    if rise < 0.0:
        rise, away = -rise, -away
    if away <= 1e-9 * rise or away >= farthest * rise:
        return farthest
    for axis in range(2):
        across = vector(rects[i, 3 + 3 * axis :])
        missed = abs(away * dot(towards, across) - dot(offset, across) * rise)
        if missed > rects[i, 12 + axis] * rise:
            return farthest
    return away / rise


@line_kernel(error_model="numpy")
def _sphere_at(start, towards, spheres, i, farthest):
    """Where a ray meets sphere i, in units of `towards`; `farthest` if not before."""
    offset, squared = minus(vector(spheres[i]), start), dot(towards, towards)
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
def _blocked(start, towards, rects, spheres):
    """Whether a ray meets anything."""
    for i in range(rects.shape[0]):
        # what enters a box leaves it by another face
        enters_box = rects[i, 17] > 0.0 and dot(towards, vector(rects[i, 9:])) < 0.0
        if not enters_box and _rectangle_at(start, towards, rects, i, FAR) < FAR:
            return True
    for i in range(spheres.shape[0]):  # noqa: SIM110 - numba has no generators here
        if _sphere_at(start, towards, spheres, i, FAR) < FAR:
            return True
    return False


@line_kernel(error_model="numpy")
def visible(point, lights, k, rects, spheres, turn):
    """Fraction 0..1 of light k's disc that a point sees: five rays, and sixteen more where
    these disagree.
    """
    light, disc = vector(lights[k]), lights[k, 6]
    if disc == 0.0:
        return 0.0 if _blocked(point, light, rects, spheres) else 1.0
    x, y, z = light
    a = unit((0.0, z, -y) if abs(x) < 0.6 else (-z, 0.0, x))
    b = cross(light, a)
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
        if not _blocked(point, towards, rects, spheres):
            visible_rays += 1
    return visible_rays / _DISC_SAMPLES
