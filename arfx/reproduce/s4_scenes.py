"""Scenes and settings for the rows of Yao, Tao, Wu 2018."""

from typing import Any

from arfx.core.scene import Scene
from arfx.papers import PAPER
from arfx.reproduce.rows import CORRECTED, PRINTED
from arfx.reproduce.work import Clip, Work

_FLAT = """
samples = 1
[clip]
width = 160
height = 120
[lens]
fov_deg = 50
[[shot]]
frames = 3
[shot.path]
position_m = [0.1, -0.32, 0.26]
end_m = [0.1, -0.32, 0.26]
target_m = [0, 0, "2cm"]
[[plane]]
size_m = [3, 3]
position_m = [0, 0, "-0.2mm"]
texture = { kind = "plain", colour = [0.5, 0.5, 0.5] }
[[marker]]
spec = "36h11:3:120mm"
[light]
ambient_rgb = [0.4, 0.4, 0.4]
lamps = [{ azimuth_deg = 60, elevation_deg = 45, rgb = [0.5, 0.5, 0.5], angular_size_deg = 6 }]
"""
_ROOM = """
samples = {samples}
[clip]
width = {width}
height = {height}
[lens]
fov_deg = 55
[[shot]]
frames = 2
[shot.path]
kind = "orbit"
target_m = [0, 0, "3cm"]
radius_m = "46cm"
azimuth_deg = [-110, -95]
elevation_deg = [38, 40]
[[plane]]
size_m = [1.6, 1.2]
position_m = [0, 0.1, "-0.2mm"]
texture = {{ kind = "wood", colour = [0.30, 0.18, 0.10], second = [0.62, 0.46, 0.30], feature_m = "2cm" }}
[[plane]]
size_m = [9, 2.6]
position_m = [0, 1.5, 0.6]
rotate_deg = [90, 0, 0]
texture = {{ kind = "poster", feature_m = "7cm" }}
[[plane]]
size_m = [8, 8]
position_m = [0, 0, -0.75]
texture = {{ kind = "carpet", colour = [0.10, 0.11, 0.14], second = [0.30, 0.30, 0.33], feature_m = "3cm" }}
[[box]]
size_m = ["12cm", "17cm", "4cm"]
position_m = [-0.21, 0.12, 0]
rotate_deg = [0, 0, 18]
texture = {{ kind = "noise", colour = [0.05, 0.08, 0.35], second = [0.10, 0.16, 0.60], feature_m = "1cm" }}
[[sphere]]
radius_m = "4cm"
position_m = [0.18, 0.13, 0.04]
colour = [0.75, 0.28, 0.03]
[[marker]]
spec = "36h11:3:120mm"
[light]
ambient_rgb = [0.38, 0.39, 0.40]
lamps = [{{ azimuth_deg = 148, elevation_deg = 52, rgb = [0.42, 0.40, 0.36], angular_size_deg = 6 }}]
"""
# of the two scenes: azimuth, elevation, R, G, B
LAMP = [148, 52, 0.42, 0.40, 0.36]
FLAT_LAMP = [60, 45, 0.5, 0.5, 0.5]


def flat_scene(work: Work) -> Clip:
    """A grey plane, a marker, one lamp."""
    return work.clip(_FLAT)


def room(work: Work) -> Clip:
    width, height, samples = work.scaled((480, 270, 2), (128, 72, 1))
    return work.clip(_ROOM.format(width=width, height=height, samples=samples))


def methods(
    work: Work, model: str, fit: str, light: list[float] = FLAT_LAMP, **gi: object
) -> dict[str, Any]:
    """Settings by PRINTED and CORRECTED: indirect light by one formula, all else by the corrected
    one. light : configured, as in the paper: the scene's lamp"""
    given: dict[str, Any] = {
        "model": {"file": work.model(model), "fit": fit},
        "pipeline": {
            "stages": ["lightmap", "gi"],
            "quality": work.scaled("standard", "draft"),
        },
        "light": {"given": light},
    }
    gi = {"samples": 32, **gi}
    printed = {**gi, "formula": PAPER, "voxels": work.scaled(64, 32)}
    return {PRINTED: {**given, "gi": printed}, CORRECTED: {**given, "gi": gi}}


def flat_with(work: Work, model: str, fit: str) -> Scene:
    """The flat scene with a model."""
    settings = methods(work, model, fit)[CORRECTED]
    return work.planned(flat_scene(work), settings).scene
