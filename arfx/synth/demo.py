"""The clip of `arfx demo`: a desk with an AprilTag and a cube of markers, filmed hand-held on an orbit. No file is needed."""

from __future__ import annotations

from pathlib import Path

from arfx.synth.clip import Progress, make_clip
from arfx.synth.description import parse_scene
from arfx.synth.truth import Truth

DEMO_SCENE = """
description = "a desk, hand-held, one lamp, and a cube of markers that shows where it stands"
seed = 7
truth = []

[clip]
width = 640
height = 360
fps = 24
tone_hz = 330

[lens]
fov_deg = 58

[[shot]]
frames = 72
[shot.path]
kind = "orbit"
target_m = [0, "2cm", "4cm"]
radius_m = "52cm"
azimuth_deg = [-150, -30]
elevation_deg = [34, 46]
hand_deg = 0.25
hand_m = "1.5mm"

[[plane]]
name = "desk"
size_m = [1.6, 1.1]
position_m = [0, 0.1, "-0.2mm"]
texture = { kind = "wood", colour = [0.22, 0.12, 0.06], second = [0.60, 0.42, 0.26], feature_m = "2cm" }

[[plane]]
name = "wall"
size_m = [5, 2.6]
position_m = [0, 1.6, 0.6]
rotate_deg = [90, 0, 0]
texture = { kind = "poster", feature_m = "7cm" }

[[plane]]
name = "floor"
size_m = [8, 8]
position_m = [0, 0, -0.75]
texture = { kind = "carpet", colour = [0.10, 0.11, 0.14], second = [0.30, 0.30, 0.33], feature_m = "3cm" }

[[box]]
name = "book"
size_m = ["17cm", "24cm", "4cm"]
position_m = [0.27, 0.24, 0]
rotate_deg = [0, 0, 18]
texture = { kind = "noise", colour = [0.35, 0.04, 0.03], second = [0.60, 0.12, 0.06], feature_m = "1cm" }

[[sphere]]
name = "orange"
radius_m = "4cm"
position_m = [0.06, 0.24, 0.04]
colour = [0.75, 0.28, 0.03]

[[marker]]
spec = "36h11:3:120mm"

[[box]]
name = "cube"
size_m = ["80mm", "80mm", "80mm"]
position_m = [-0.17, 0.09, 0.0]
rotate_deg = [0, 0, 8]
texture = { kind = "plain", colour = [0.8, 0.8, 0.8] }
[[marker]]
spec = "36h11:10:60mm"
position_m = [-0.16441, 0.05019, 0.04000]
rotate_deg = [90, 0, 8]

[[marker]]
spec = "36h11:11:60mm"
position_m = [-0.13019, 0.09559, 0.04000]
rotate_deg = [90, 0, 98]

[[marker]]
spec = "36h11:12:60mm"
position_m = [-0.20981, 0.08441, 0.04000]
rotate_deg = [90, 0, -82]

[[marker]]
spec = "36h11:13:60mm"
position_m = [-0.17, 0.09, 0.08020]
rotate_deg = [0, 0, 8]

[light]
ambient_rgb = [0.30, 0.32, 0.35]
lamps = [{ azimuth_deg = -10, elevation_deg = 48, rgb = [0.56, 0.53, 0.48], angular_size_deg = 12 }]

[model]
shape = "robot"
fit = "15cm"

[job.settings.light]
most_lights = 1

[job.settings.dof]
focus = "object"
fnumber = 2.0
background_m = 2.2
"""


def make_demo_clip(folder: Path, progress: Progress | None = None, overwrite: bool = False) -> Truth:
    """Make the demo's clip, camera, model and job.toml in a folder, as make_clip. progress(phase, frames done, frames in all)."""
    return make_clip(parse_scene(DEMO_SCENE, "the demo's scene"), folder, progress=progress, overwrite=overwrite)
