"""Radiance along rays: rectangles and spheres, lit directly with true shadows, textures averaged
exactly over a footprint; by compiled loops.

A texture is a summed-area table. Its bilinear interpolation integrates a picture of
constant cells exactly, so the edges of a print are anti-aliased without sampling error
(Crow 1984, "Summed-area tables for texture mapping"). Radiance follows arfx.core.light:
ambient + sum of rgb * max(n·d, 0) * visible, times albedo.

Row layouts (float64):
rectangle  0-2 centre, 3-5 u, 6-8 v, 9-11 normal, 12 half width, 13 half height, 14 texture,
15 object, 16 gloss
sphere     0-2 centre, 3 radius, 4-6 albedo, 7 object
light      0-2 unit vector towards it, 3-5 rgb, 6 tangent of half its angular size
texture    0 first row of the table, 1 columns, 2 rows, 3 smallest box in texels (0: cells
stay hard-edged)
"""

# mypy: disable-error-code="no-untyped-def"
import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import line_kernel
from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.core.vectors import cross, dot, minus, scaled, shifted, unit, vector

FAR = 1e30  # nothing is met
# start of a shadow ray above its surface: float64 hit points are off by 1e-15 m, sheets lie
# 2e-4 m apart
LIFT_M = 2e-5
_DISC_SAMPLES = 16
_GOLDEN_ANGLE = 2.399963229728653
_GLOSS_EXPONENT = 40
_LEAST_TEXELS = (
    1e-4  # half a box's side, so that its mean is a quotient of numbers above 0
)
_NUMBERS = (
    65521  # below 2^16, prime: of two surfaces under many lights few get the same
)


class Rays(NamedTuple):
    """starts, towards (n, 3): towards of any length;  spans (n, 2, 3): what a ray stands for,
    right and down, as differences of `towards`;  turns (n,): of the samples of a lamp's disc
    """

    starts: ndarray
    towards: ndarray
    spans: ndarray
    turns: ndarray


class Room(NamedTuple):
    """What there is, by rows, and its ambient light (3,);  table (n, 3): of the textures
    sky (h, w, 3): radiance by direction, (0, ...) = black"""

    rects: ndarray
    spheres: ndarray
    lights: ndarray
    ambient: ndarray
    textures: ndarray
    table: ndarray
    sky: ndarray


@line_kernel(error_model="numpy")
def _intersect(start, towards, rects, spheres, any_hit):
    """(distance in units of `towards`, or FAR; index of the surface along a ray, a sphere's
    counted on behind the rectangles): the nearest, or with `any_hit` any that is found."""
    best, index, count = FAR, -1, rects.shape[0]
    for i in range(count):
        offset, normal = minus(vector(rects[i]), start), vector(rects[i, 9:])
        rise, away = dot(towards, normal), dot(offset, normal)
        if rise < 0.0:
            rise, away = -rise, -away
        # without a division but where it is met: both sides are times |towards·n|
        inside = 1e-9 * rise < away < best * rise
        for axis in range(2):
            across = vector(rects[i, 3 + 3 * axis :])
            missed = abs(away * dot(towards, across) - dot(offset, across) * rise)
            inside = inside and missed <= rects[i, 12 + axis] * rise
        if inside:
            best, index = away / rise, i
            if any_hit:
                break
    squared = dot(towards, towards)
    for i in range(spheres.shape[0]):
        offset = minus(vector(spheres[i]), start)
        middle = dot(offset, towards) / squared
        across = shifted(offset, -middle, towards)
        within = spheres[i, 3] * spheres[i, 3] - dot(across, across)
        half = math.sqrt(max(within, 0.0) / squared)
        distance = middle - half if middle - half > 1e-9 else middle + half
        if within > 0.0 and 1e-9 < distance < best:
            best, index = distance, count + i
    return best, index


@line_kernel(error_model="numpy")
def first_hits(starts, towards, rects, spheres, distance, index):
    """Fill distance (n,) and index (n,) of what rays (n, 3) meet; index -1 = nothing."""
    for n in range(towards.shape[0]):
        start, direction = vector(starts[n]), vector(towards[n])
        distance[n], index[n] = _intersect(start, direction, rects, spheres, False)


@line_kernel(error_model="numpy")
def _visible(point, light, disc, rects, spheres, turn):
    """Fraction 0..1 of a light's disc that a point sees: five rays, and sixteen more where
    these disagree. disc : tangent of half its angular size;  turn : of the sixteen, radians"""
    if disc == 0.0:
        return 1.0 if _intersect(point, light, rects, spheres, True)[1] < 0 else 0.0
    x, y, z = light
    a = unit((0.0, z, -y) if abs(x) < 0.6 else (-z, 0.0, x))
    b = cross(light, a)
    lit = 0
    for j in range(5 + _DISC_SAMPLES):
        if j == 5:
            if lit == 0 or lit == 5:
                return lit / 5.0
            lit = 0
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
        if _intersect(point, towards, rects, spheres, True)[1] < 0:
            lit += 1
    return lit / _DISC_SAMPLES


@line_kernel(error_model="numpy")
def _albedo(hit, towards, distance, spans, rect, texture, table):
    """Of a rectangle at a point, over what a ray's spans (2, 3) cover there: the mean of its
    texture over a box, from the summed-area table, bilinear between the table's nodes."""
    normal, offset = vector(rect[9:]), minus(hit, vector(rect))
    first, smallest = int(texture[0]), 0.5 * texture[3]
    low, high, area = (0.0, 0.0), (0.0, 0.0), 1.0
    for axis in range(2):  # along u, then v
        along, half, size = (
            vector(rect[3 + 3 * axis :]),
            rect[12 + axis],
            texture[1 + axis],
        )
        texels, squared = size / (2.0 * half), 0.0  # per metre
        for span in spans:  # carried along the ray onto the surface
            rise = dot(span, normal) / dot(towards, normal)
            length = distance * (dot(span, along) - rise * dot(towards, along))
            squared += length * length
        reach = max(0.5 * math.sqrt(squared) * texels, smallest, _LEAST_TEXELS)
        place = dot(offset, along) * (1.0 - 2.0 * axis)  # v runs up, rows run down
        centre = (place + half) * texels
        # kept inside the texture without becoming empty
        least = min(max(centre - reach, 0.0), size - _LEAST_TEXELS)
        most = max(min(centre + reach, size), _LEAST_TEXELS)
        low, high, area = (low[1], least), (high[1], most), area * (most - least)
    total = (0.0, 0.0, 0.0)
    for corner in range(16):  # four of the box, times four nodes around each
        x = high[0] if corner & 1 else low[0]
        y = high[1] if corner & 2 else low[1]
        column, row = int(x) + (corner >> 2 & 1), int(y) + (corner >> 3)
        weight = (1.0 - abs(column - x)) * (1.0 - abs(row - y))
        if weight > 0.0:
            sign = 1.0 if corner & 3 in (0, 3) else -1.0
            node = first + row * (int(texture[1]) + 1) + column
            total = shifted(total, sign * weight, vector(table[node]))
    return scaled(1.0 / area, total)


@line_kernel(error_model="numpy")
def shade(rays: Rays, room: Room, radiance, numbers):
    """Fill radiance (n, 3) and numbers (n,) of the rays that meet something; what is there for
    the others stays. numbers : for the surface and the lights that it sees; 0 where it sees a
    part of one, and on a print, whose edges are hard"""
    rects, spheres, lights = room.rects, room.spheres, room.lights
    for n in range(len(numbers)):
        start, towards = vector(rays.starts[n]), vector(rays.towards[n])
        distance, i = _intersect(start, towards, rects, spheres, False)
        if i < 0:
            continue
        hit = shifted(start, distance, towards)
        gloss, whole, number = 0.0, True, i + 1
        if i < rects.shape[0]:
            texture = room.textures[int(rects[i, 14])]
            spans = vector(rays.spans[n, 0]), vector(rays.spans[n, 1])
            albedo = _albedo(
                hit, towards, distance, spans, rects[i], texture, room.table
            )
            normal, gloss, whole = (
                vector(rects[i, 9:]),
                rects[i, 16],
                texture[3] > 0.0,
            )
            if dot(towards, normal) > 0.0:
                normal = scaled(-1.0, normal)
        else:
            ball = spheres[i - rects.shape[0]]
            normal = scaled(1.0 / ball[3], minus(hit, vector(ball)))
            albedo = vector(ball[4:])
        light, shine = vector(room.ambient), (0.0, 0.0, 0.0)
        point = shifted(hit, LIFT_M, normal)
        for k in range(lights.shape[0]):
            lamp, rgb, seen = vector(lights[k]), vector(lights[k, 3:]), 0.0
            facing = dot(normal, lamp)
            if facing > 0.0:
                seen = _visible(
                    point, lamp, lights[k, 6], rects, spheres, rays.turns[n]
                )
            number = 2 * number + (seen > 0.0)
            whole = whole and (seen == 0.0 or seen == 1.0)
            light = shifted(light, seen * facing, rgb)
            if gloss * seen > 0.0:
                half = max(dot(normal, unit(minus(lamp, unit(towards)))), 0.0)
                shine = shifted(shine, seen * gloss * half**_GLOSS_EXPONENT, rgb)
        for c in range(3):
            radiance[n, c] = albedo[c] * light[c] + shine[c]
        numbers[n] = 2 + number % _NUMBERS if whole else 0


def radiance(rays: Rays, room: Room) -> tuple[ndarray, ndarray]:
    """(n, 3) what comes along rays; (n,) uint16 a number for the surface and the lights that it
    sees: 1 where nothing is met, as by a ray that is NaN, 0 where a part of a light is seen,
    and on a print."""
    light, numbers = np.zeros(rays.starts.shape), np.ones(len(rays.starts), np.uint16)
    shade(rays, room, light, numbers)
    if room.sky.size:
        away = (numbers == 1) & np.isfinite(rays.towards[:, 0])
        height, width = room.sky.shape[:2]
        x, y, up = normalise(rays.towards[away]).T
        light[away] = room.sky[
            np.minimum(
                ((0.5 - np.arcsin(up) / np.pi) * height).astype(int), height - 1
            ),
            ((0.5 - np.arctan2(y, x) / (2 * np.pi)) * width).astype(int) % width,
        ]
    return light, numbers


def surfaces(rays: ndarray, room: Room, pose: Pose) -> tuple[ndarray, ndarray]:
    """(depth (h, w) along the axis, object number (h, w) uint8) of the first surface along
    rays (h, w, 2), camera directions; 0 = nothing. pose : room_from_camera
    """
    towards = np.pad(rays.reshape(-1, 2), ((0, 0), (0, 1)), constant_values=1.0)
    starts = np.tile(pose.translation_m, (len(towards), 1))
    distance, index = np.empty(len(towards)), np.empty(len(towards), np.int64)
    towards = towards @ pose.rotation.T
    first_hits(starts, towards, room.rects, room.spheres, distance, index)
    depth, owner = (
        np.where(index < 0, 0.0, distance),
        np.concatenate([room.rects[:, 15], room.spheres[:, 7], [0.0]])[index].astype(
            np.uint8
        ),
    )
    return depth.reshape(rays.shape[:2]), owner.reshape(rays.shape[:2])
