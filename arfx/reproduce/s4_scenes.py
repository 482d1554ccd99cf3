"""Scenes and settings for the rows of Yao, Tao, Wu 2018."""

from __future__ import annotations

from collections.abc import Sequence

from arfx.papers import PAPER
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
texture = {{ kind = "plain", colour = [0.5, 0.5, 0.5] }}
[[marker]]
spec = "36h11:3:120mm"
[light]
ambient_rgb = [0.4, 0.4, 0.4]
lamps = [{{ azimuth_deg = 60, elevation_deg = 45, rgb = [0.5, 0.5, 0.5], angular_size_deg = 6 }}]
"""
_ROOM = """
samples = {samples}
[clip]
width = {width}
height = {height}
[lens]
fov_deg = 55
[[shot]]
frames = {frames}
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
LAMP, FLAT_LAMP = (
    (148, 52, 0.42, 0.40, 0.36),
    (60, 45, 0.5, 0.5, 0.5),
)  # of the two scenes
Settings = dict[str, dict[str, object]]


def flat_scene(work: Work) -> Clip:
    """A grey plane, a marker, one lamp."""
    return work.clip(_FLAT.format())


def room(work: Work) -> Clip:
    size = work.scaled(
        {"width": 480, "height": 270, "frames": 2, "samples": 2},
        {"width": 128, "height": 72, "frames": 2, "samples": 1},
    )
    return work.clip(_ROOM.format(**size))


def settings(
    work: Work, model: str, fit: str, light: Sequence[float], **gi: object
) -> Settings:
    """light : configured, as in the paper: azimuth, elevation, R, G, B of the scene's lamp"""
    return {
        "model": {"file": work.model(model), "fit": fit},
        "gi": {"samples": 32, **gi},
        "pipeline": {
            "stages": ["lightmap", "gi"],
            "quality": work.scaled("standard", "draft"),
        },
        "light": {"given": list(light)},
    }


def under(work: Work, formula: str, given: Settings) -> Settings:
    """Indirect light by one formula, all else by the corrected one: only this paper's
    methods differ.
    """
    voxels: dict[str, object] = (
        {"voxels": work.scaled(64, 32)} if formula == PAPER else {}
    )  # as many as the other has
    return {**given, "gi": {**given["gi"], **voxels, "formula": formula}}
