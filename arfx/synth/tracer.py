"""Radiance along rays: rectangles and spheres, lit directly with true shadows, textures averaged
exactly over a footprint.

A texture is a summed-area table. Its bilinear interpolation integrates a picture of
constant cells exactly, so the edges of a print are anti-aliased without sampling error
(Crow 1984, "Summed-area tables for texture mapping"). Radiance follows arfx.core.light:
ambient + sum of rgb * max(n·d, 0) * visible, times albedo.
"""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.synth.rays import Rays, Room, first_hits, shade


def radiance(rays: Rays, room: Room) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) what comes along rays; (n,) uint16 a number for the surface and the lights that it
    sees: 1 where nothing is met, as by a ray that is NaN, 0 where a part of a light is seen,
    and on a print."""
    light, numbers = np.zeros(rays.starts.shape), np.ones(len(rays.starts), np.uint16)
    shade(rays, room, light, numbers)
    if room.sky.size:
        away = (numbers == 1) & np.isfinite(rays.towards[:, 0])
        height, width = room.sky.shape[:2]
        x, y, up = normalise(rays.towards[away]).T
        column = ((0.5 - np.arctan2(y, x) / (2 * np.pi)) * width).astype(int) % width
        light[away] = room.sky[
            np.minimum(
                ((0.5 - np.arcsin(up) / np.pi) * height).astype(int), height - 1
            ),
            column,
        ]
    return light, numbers


def surfaces(
    rays: np.ndarray, room: Room, pose: Pose
) -> tuple[np.ndarray, np.ndarray]:
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
