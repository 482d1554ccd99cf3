"""Compiled pictures: rectangles and spheres, lit directly with true shadows, textures averaged
exactly over a footprint.

A texture is a summed-area table. Its bilinear interpolation integrates a picture of
constant cells exactly, so the edges of a print are anti-aliased without sampling error
(Crow 1984, "Summed-area tables for texture mapping"). Radiance follows arfx.core.light:
ambient + sum of rgb * max(n·d, 0) * visible, times albedo.

Rows as in arfx.synth.rays, and (float64):
texture    0 first row of the table, 1 columns, 2 rows, 3 smallest box in texels (0: cells
stay hard-edged)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.pose import Pose
from arfx.core.vectors import dot, minus, scaled, shifted, turned, unit, vector
from arfx.synth.rays import nearest, visible

_NUMBERS = 65521  # below 2^16, prime: of two surfaces under many lights few get the same
# start of a shadow ray above its surface: float64 hit points are off by 1e-15 m, sheets lie
# 2e-4 m apart
LIFT_M = 2e-5
_BLACK = (0.0, 0.0, 0.0)


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
    """What there is, by rows, and its ambient light (3,);  table (n, 3): of the textures
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
def _integral(table, first, columns, x, y):
    """Of a texture over the box from its first corner to (x, y)."""
    left, top = int(x), int(y)
    total = _BLACK
    for j in range(2):
        for i in range(2):
            weight = abs(1 - i - (x - left)) * abs(1 - j - (y - top))
            if weight > 0.0:
                at = first + (top + j) * (columns + 1) + left + i
                total = shifted(total, weight, vector(table[at]))
    return total


@line_kernel(error_model="numpy")
def _mean(table, first, columns, across, down):
    """Mean of a texture over a box, (low, high) texels each way."""
    (left, right), (top, bottom) = across, down
    lower = minus(
        _integral(table, first, columns, right, bottom),
        _integral(table, first, columns, left, bottom),
    )
    upper = minus(
        _integral(table, first, columns, left, top),
        _integral(table, first, columns, right, top),
    )
    scale = 1.0 / ((right - left) * (bottom - top))
    return scaled(scale, shifted(lower, 1.0, upper))


@line_kernel(error_model="numpy")
def _span(centre, half, size):
    """A box of the texture along one axis, kept inside it without becoming empty."""
    half = max(half, 1e-4)
    low, high = max(centre - half, 0.0), min(centre + half, float(size))
    if high - low < 1e-6:
        low, high = (0.0, min(1e-4, size)) if centre <= 0 else (size - 1e-4, float(size))
    return low, high


@line_kernel(error_model="numpy")
def _direction(rays, y, x):
    """Of a pixel in camera axes, z = 1; NaN where the lens maps nothing."""
    return rays[y, x, 0], rays[y, x, 1], 1.0


@line_kernel(error_model="numpy")
def _footprint(rays, x, y, width):
    """What a sample spans of the picture, right and down, as camera directions without z."""
    height, columns = rays.shape[:2]
    here = _direction(rays, y, x)
    beside = _direction(rays, y, x + 1 if x + 1 < columns else x - 1)
    below = _direction(rays, y + 1 if y + 1 < height else y - 1, x)
    right, down = scaled(width, minus(beside, here)), scaled(width, minus(below, here))
    if not math.isfinite(right[0]):  # the neighbour lies beyond the lens's field: assume
        right = down[1], -down[0], 0.0  # square pixels
    if not math.isfinite(down[0]):
        down = -right[1], right[0], 0.0
    return (right, down) if math.isfinite(down[0] + right[0]) else (_BLACK, _BLACK)


@line_kernel(error_model="numpy")
def _albedo(hit, towards, distance, spans, room: Room, i):
    """Of rectangle i at a point, over what a sample's two spans cover there; `towards` is
    the ray's direction, its length the unit of `distance`."""
    rects, textures = room.rects, room.textures
    normal, u, v = vector(rects[i, 9:]), vector(rects[i, 3:]), vector(rects[i, 6:])
    per_rise = 1.0 / dot(towards, normal)
    wide, high = 0.0, 0.0  # squared extents on the surface, along u and v
    for span in spans:
        on_surface = shifted(span, -(dot(span, normal) * per_rise), towards)
        on_surface = scaled(distance, on_surface)
        along_u, along_v = dot(on_surface, u), dot(on_surface, v)
        wide += along_u * along_u
        high += along_v * along_v
    tex = int(rects[i, 14])
    first = int(textures[tex, 0])
    columns = int(textures[tex, 1])
    rows = int(textures[tex, 2])
    half_w, half_h, smallest = rects[i, 12], rects[i, 13], 0.5 * textures[tex, 3]
    per_u, per_v = columns / (2 * half_w), rows / (2 * half_h)
    offset = minus(hit, vector(rects[i]))
    across = _span(
        (dot(offset, u) + half_w) * per_u,
        max(0.5 * math.sqrt(wide) * per_u, smallest),
        columns,
    )
    down = _span(
        (half_h - dot(offset, v)) * per_v,
        max(0.5 * math.sqrt(high) * per_v, smallest),
        rows,
    )
    return _mean(room.table, first, columns, across, down)


@line_kernel(error_model="numpy")
def _sky(sky, towards):
    up = towards[2] / math.sqrt(dot(towards, towards))
    height, width = sky.shape[:2]
    column = int((0.5 - math.atan2(towards[1], towards[0]) / (2 * math.pi)) * width) % width
    row = min(int((0.5 - math.asin(up) / math.pi) * height), height - 1)
    return vector(sky[row, column])


@line_kernel(error_model="numpy")
def render_rows(y0, y1, lens: Lens, room: Room, samples: Samples, out, met):
    """Add samples of rows y0..y1 to `out` (h, w, 3).
    met (h, w) uint16 gets a number for the surface and the lights that it sees; 0 where it
    sees a part of one, and on a print"""
    rays, rotation, origin, lens_m, focus_m = lens
    for y in range(y0, y1):
        for x in range(rays.shape[1]):
            if not samples.chosen[y, x]:
                continue
            met[y, x] = 1
            ahead, start = _direction(rays, y, x), vector(origin)
            if not math.isfinite(ahead[0]):
                continue
            number = y * rays.shape[1] + x
            if lens_m > 0.0:
                radius = 0.5 * lens_m * math.sqrt(_noise(samples.seed, 2 * number))
                angle = 2 * math.pi * _noise(samples.seed, 2 * number + 1)
                on_lens = radius * math.cos(angle), radius * math.sin(angle), 0.0
                ahead = shifted(ahead, -1.0 / focus_m, on_lens)
                start = shifted(start, 1.0, turned(rotation, on_lens))
            towards = turned(rotation, ahead)
            turn = 2 * math.pi * _noise(samples.seed + 7, number)
            right, down = _footprint(rays, x, y, samples.footprint)
            spans = turned(rotation, right), turned(rotation, down)
            radiance, seen = _radiance(start, towards, spans, room, turn)
            for c in range(3):
                out[y, x, c] += samples.weight * radiance[c]
            met[y, x] = seen


@line_kernel(error_model="numpy")
def _radiance(start, towards, spans, room: Room, turn):
    """What comes to a point from a direction; and a number as in `met`."""
    rects, spheres, lights = room.rects, room.spheres, room.lights
    distance, i = nearest(start, towards, rects, spheres)
    if i < 0:
        return (_sky(room.sky, towards) if room.sky.shape[0] > 0 else _BLACK), 1
    hit = shifted(start, distance, towards)
    gloss, whole, number = 0.0, True, i + 1
    if i < rects.shape[0]:
        normal, gloss = vector(rects[i, 9:]), rects[i, 16]
        albedo = _albedo(hit, towards, distance, spans, room, i)
        whole = room.textures[int(rects[i, 14]), 3] > 0.0  # a print's edges are hard
        if dot(towards, normal) > 0.0:
            normal = scaled(-1.0, normal)
    else:
        ball = i - rects.shape[0]
        normal = scaled(1.0 / spheres[ball, 3], minus(hit, vector(spheres[ball])))
        albedo = vector(spheres[ball, 4:])
    light = vector(room.ambient)
    shine = _BLACK
    point = shifted(hit, LIFT_M, normal)
    for k in range(lights.shape[0]):
        facing = dot(normal, vector(lights[k]))
        number *= 2
        if facing <= 0.0:
            continue
        seen = visible(point, lights, k, rects, spheres, turn)
        whole = whole and (seen == 0.0 or seen == 1.0)
        if seen == 0.0:
            continue
        number += 1
        rgb = vector(lights[k, 3:])
        light = shifted(light, seen * facing, rgb)
        if gloss > 0.0:
            between = minus(vector(lights[k]), unit(towards))
            half = dot(normal, between) / math.sqrt(dot(between, between))
            shine = shifted(shine, seen * gloss * max(half, 0.0) ** 40, rgb)
    radiance = (
        albedo[0] * light[0] + shine[0],
        albedo[1] * light[1] + shine[1],
        albedo[2] * light[2] + shine[2],
    )
    return radiance, 2 + number % _NUMBERS if whole else 0


@line_kernel(error_model="numpy")
def probe(rays, rotation, origin, rects, spheres, depth, owner):
    """Depth along the axis (0 = nothing) and object number (0 = nothing) at the rays (h, w,
    2) of pixel centres.
    """
    start = vector(origin)
    for y in range(rays.shape[0]):
        for x in range(rays.shape[1]):
            ahead = _direction(rays, y, x)
            depth[y, x], owner[y, x] = 0.0, 0
            if not math.isfinite(ahead[0]):
                continue
            distance, i = nearest(start, turned(rotation, ahead), rects, spheres)
            if i >= rects.shape[0]:
                depth[y, x], owner[y, x] = distance, int(spheres[i - rects.shape[0], 7])
            elif i >= 0:
                depth[y, x], owner[y, x] = distance, int(rects[i, 15])


def surfaces(rays: np.ndarray, pose: Pose, room: Room) -> tuple[np.ndarray, np.ndarray]:
    """(depth (h, w) along the axis, object number (h, w) uint8) of the first surface along
    rays (h, w, 2), camera directions; 0 = nothing. pose : room_from_camera
    """
    depth, owner = np.zeros(rays.shape[:2]), np.zeros(rays.shape[:2], np.uint8)
    rotation = np.ascontiguousarray(pose.rotation)
    probe(rays, rotation, pose.translation_m, room.rects, room.spheres, depth, owner)
    return depth, owner
