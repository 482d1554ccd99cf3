"""Rooms in closed form, and what a clip of one shows: pictures, poses and light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from arfx.analyse.light.seen import Snapshot
from arfx.core.camera import Camera
from arfx.core.cube import face_directions, solid_angles
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.light import Light, triple
from arfx.core.numerics import normalise
from arfx.core.pose import Pose

UP = np.array([0.0, 0.0, 1.0])
DESK = np.array([0.30, 0.26, 0.22])
CAMERA = Camera(
    150, 200, np.array([[140.0, 0, 74.5], [0, 140, 99.5], [0, 0, 1]])
)  # a phone held upright

Radiance = Callable[[np.ndarray, np.ndarray], np.ndarray]


def irradiance(cube: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(3,) radiance of a white diffuse surface of unit normal (3,) under a cube (6, n, n, 3)."""
    n = cube.shape[1]
    weight = np.clip(face_directions(n) @ up, 0, None) * solid_angles(n)
    return np.asarray(np.tensordot(weight, cube, 3) / weight.sum())


def walls(half_m: float, top_m: float = 1.8, tint: float = 1.0) -> Radiance:
    """Of a room about a desk that fills it: striped walls, a plain ceiling."""

    def radiance(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        high, low = np.array([half_m, half_m, top_m]), np.array([-half_m, -half_m, 0])
        away = np.where(directions > 0, high - origins, origins - low) / np.maximum(
            np.abs(directions), 1e-12
        )
        side = np.argmin(np.nan_to_num(away, nan=1e9), -1)
        at = origins + np.take_along_axis(away, side[..., None], -1) * directions
        number = 2 * side + (
            np.take_along_axis(directions, side[..., None], -1)[..., 0] < 0
        )
        along = np.where(side == 0, at[..., 1], at[..., 0])
        stripes = np.sin(2 * np.pi * along / (0.8 * half_m)) * np.sin(
            2 * np.pi * at[..., 2] / (0.9 * half_m)
        )
        colours = np.array(
            [
                [0.7, 0.3, 0.2],
                [0.2, 0.5, 0.3],
                [0.25, 0.3, 0.6],
                [0.6, 0.55, 0.2],
                [0.42, 0.42, 0.4],
                DESK,
            ]
        )
        plain = (side == 2)[..., None]
        return np.asarray(
            colours[number]
            * np.where(plain, 1, (1 + 0.6 * stripes[..., None]) * tint)
        )

    return radiance


def sky(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Far away over an endless desk: clouds."""
    d = normalise(directions)
    clouds = 0.5 + 0.5 * np.sin(4 * d[..., :1] + 2) * np.sin(
        5 * d[..., 1:2]
    ) * np.cos(3 * d[..., 2:])
    return np.where(d[..., 2:] < 0, DESK, 0.15 + clouds * np.array([0.55, 0.6, 0.75]))


@dataclass(frozen=True)
class Clip:
    """A camera that goes round the anchor. looks_at_m : height over it;  seconds : of the clip
    later : radiance in its second half"""

    radiance: Radiance
    azimuth_deg: tuple[float, float]
    elevation_deg: float = 18.0
    distance_m: float = 0.7
    looks_at_m: float = 0.24
    seconds: float = 4.0
    later: Radiance | None = None
    frames: int = 41

    def shown(self, k: int) -> Radiance:
        return self.later if self.later and 2 * k >= self.frames else self.radiance

    def pose(self, k: int) -> Pose:
        """camera_from_world"""
        a = np.radians(np.interp(k, (0, self.frames - 1), self.azimuth_deg))
        e = np.radians(self.elevation_deg)
        eye = self.distance_m * np.array(
            [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
        )
        forward = normalise(np.array([0, 0, self.looks_at_m]) - eye)
        right = normalise(np.cross(forward, UP))
        turn = np.stack([right, np.cross(forward, right), forward])
        return Pose(turn, -turn @ eye)

    def picture(self, k: int, camera: Camera = CAMERA) -> np.ndarray:
        y, x = np.mgrid[0 : camera.height, 0 : camera.width]
        pose = self.pose(k)
        directions = (
            camera.directions(np.stack([x, y], -1).astype(float)) @ pose.rotation
        )
        return np.asarray(
            self.shown(k)(
                np.broadcast_to(pose.inverse().translation_m, directions.shape),
                directions,
            ),
            np.float32,
        )

    def light(self, k: int) -> Light:
        d = face_directions(32)
        return Light(
            triple(
                irradiance(self.shown(k)(np.broadcast_to(UP * 1e-3, d.shape), d), UP)
            ),
            (),
        )

    @cached_property
    def facts(self) -> list[FrameFacts]:
        times = np.linspace(0, self.seconds, self.frames)
        lights = {id(self.shown(k)): self.light(k) for k in (0, self.frames - 1)}
        return [
            FrameFacts(
                k,
                t,
                status=MEASURED,
                camera_from_world=self.pose(k),
                opacity=1.0,
                light=lights[id(self.shown(k))],
            )
            for k, t in enumerate(times.tolist())
        ]

    @cached_property
    def looks(self) -> list[Snapshot]:
        step = max(1, round(0.5 * (self.frames - 1) / self.seconds))
        small = CAMERA.scaled_to(75, 100)
        return [
            Snapshot(k, self.picture(k, small).astype(np.float16), np.zeros(3))
            for k in range(0, self.frames, step)
        ]

    def at_rest(self) -> Clip:
        return replace(self, azimuth_deg=(self.azimuth_deg[0],) * 2)
