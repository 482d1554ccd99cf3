"""The clip of `arfx demo`: a desk with one AprilTag, filmed hand-held on an orbit. No file is needed."""

from __future__ import annotations

from pathlib import Path

from arfx.synth.clip import Progress, make_clip
from arfx.synth.description import parse_scene
from arfx.synth.truth import Truth

DEMO_SCENE = """
description = "a desk, hand-held, one lamp and a bright room"
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
azimuth_deg = [-125, -62]
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
position_m = [-0.26, 0.16, 0]
rotate_deg = [0, 0, 18]
texture = { kind = "noise", colour = [0.35, 0.04, 0.03], second = [0.60, 0.12, 0.06], feature_m = "1cm" }

[[sphere]]
name = "orange"
radius_m = "4cm"
position_m = [0.20, 0.15, 0.04]
colour = [0.75, 0.28, 0.03]

[[marker]]
spec = "36h11:3:120mm"

[light]
ambient_rgb = [0.30, 0.32, 0.35]
lamps = [{ azimuth_deg = 52, elevation_deg = 55, rgb = [0.56, 0.53, 0.48], angular_size_deg = 12 }]

[model]
shape = "robot"
fit = "15cm"
"""


def make_demo_clip(folder: Path, progress: Progress | None = None) -> Truth:
    """Make the demo's clip, camera, model and job.toml in a new folder. progress(phase, frames done, frames in all)."""
    return make_clip(parse_scene(DEMO_SCENE, "the demo's scene"), folder, progress=progress)
