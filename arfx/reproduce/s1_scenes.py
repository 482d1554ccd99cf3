"""Scenes of the figures and of table 1 of Tan, Chen, Sun 2009: a card with a marker, turned
before a camera at rest, one lamp, and a model on it. The paper gives neither the scenes nor
the size of the picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from arfx.core.numerics import normalise

REST_FRAMES = 2  # at the end
TURNS, MOST_DEG = 3, 68.0  # of the spiral of normals, and its end, from the line of sight
EYE_M, CARD_M = np.array([0.0, -0.34, 0.34]), np.array([0.0, 0.0, 0.18])


class Lamp(NamedTuple):
    """Degrees in the room's axes; the card's in its last frames."""

    azimuth_deg: float
    elevation_deg: float
    rgb: tuple[float, float, float] = (0.52, 0.5, 0.46)

    @property
    def towards(self) -> np.ndarray:
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


SITUATIONS = (Lamp(200, 48), Lamp(-20, 34))  # of figure 3
AMBIENT = (0.2, 0.205, 0.22)


def turned_card(lamp: Lamp, size_px: tuple[int, int], frames: int, samples: int = 2) -> str:
    """A scene whose card shows normals on a spiral about the line of sight; first and last
    it lies level.

    samples : of a pixel, a side"""
    return _SCENE.format(
        width=size_px[0],
        height=size_px[1],
        frames=frames,
        samples=samples,
        keys=_keys(frames),
        eye=_vector(CARD_M + EYE_M),
        card=_vector(CARD_M),
        ambient=list(AMBIENT),
        azimuth=lamp.azimuth_deg,
        elevation=lamp.elevation_deg,
        rgb=list(lamp.rgb),
    )


def _keys(frames: int, fps: float = 24.0) -> str:
    """The card's turns, first and last its rest, as key frames."""
    sight = normalise(EYE_M)
    side = np.array([1.0, 0, 0])
    rise = np.cross(sight, side)
    count = 8 * TURNS
    fraction = np.linspace(0, 1, count)
    tilt, phi = np.radians(MOST_DEG) * np.sqrt(fraction), 2 * np.pi * TURNS * fraction
    n = np.cos(tilt)[:, None] * sight + np.sin(tilt)[:, None] * (
        np.cos(phi)[:, None] * side + np.sin(phi)[:, None] * rise
    )
    up = np.array([0.0, 0.0, 1.0])
    normals = np.concatenate([[up], n, [up], [up]])
    turning_s = (frames - REST_FRAMES) / fps
    times = np.append(np.linspace(0, turning_s, len(normals) - 1), frames / fps)
    return "\n".join(
        f"[[marker.motion.keys]]\ntime_s = {t:.4f}\nposition_m ="
        f" {_vector(CARD_M)}\nrotate_deg = {_vector(_turn(n))}"
        for t, n in zip(times, normals, strict=True)
    )


def _turn(n: np.ndarray) -> np.ndarray:
    """(3,) degrees about fixed x, y, z that turn z into n by the shortest way."""
    turn, _ = Rotation.align_vectors(n[None], np.array([[0.0, 0, 1]]))
    return np.asarray(turn.as_euler("xyz", degrees=True))


def _vector(v: np.ndarray) -> list[float]:
    return [round(float(c), 4) for c in v]


_SCENE = """
seed = 7
samples = {samples}
truth = []
[clip]
width = {width}
height = {height}
[lens]
fov_deg = 34
[[shot]]
frames = {frames}
[shot.path]
kind = "static"
position_m = {eye}
target_m = {card}
[[plane]]
size_m = [3, 3]
texture = {{ kind = "wood", colour = [0.20, 0.11, 0.06], second = [0.60, 0.42, 0.26], feature_m = "2cm" }}
[[marker]]
spec = "36h11:7:80mm"
position_m = {card}
[marker.motion]
kind = "keys"
{keys}
[[box]]
size_m = ["22cm", "22cm", "2mm"]
position_m = [0, 0, "-2.2mm"]
attached_to = "36h11:7"
texture = {{ kind = "plain", colour = [0.62, 0.60, 0.55] }}
[light]
ambient_rgb = {ambient}
lamps = [{{ azimuth_deg = {azimuth}, elevation_deg = {elevation}, rgb = {rgb}, angular_size_deg = 2 }}]
[model]
shape = "robot"
fit = "13cm"
[job]
stages = ["lightmap"]
"""
