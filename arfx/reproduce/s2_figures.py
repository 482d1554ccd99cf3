"""Figures of Zhao et al. 2012: a real and a virtual ball on a desk, before a dark wall with bright points.

Their reference shares nothing with the program's blur: both balls are real in it, and the tracer's own lens is open."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.reproduce.rows import BEFORE, CORRECTED, PRINTED, REFERENCE, Figure, Item, shown
from arfx.reproduce.work import Clip, Shot, Work
from arfx.synth.description import Lens, SceneFile, Sphere, parse_scene

FOCUS_M, APERTURE_M = 0.38, 0.03  # before both balls
BLUE, BALL_M = (0.06, 0.12, 0.75), 0.035  # the virtual ball; it stands in the middle of the marker

SCENE = """
seed = 12
[clip]
width = 480
height = 384
[lens]
fov_deg = 46
[[shot]]
frames = 2
[shot.path]
kind = "static"
position_m = [0, -0.52, 0.2]
target_m = [0, 0.05, 0.07]
[[plane]]
size_m = [1.6, 1.2]
position_m = [0, 0.1, "-0.2mm"]
texture = { kind = "wood", colour = [0.20, 0.11, 0.06], second = [0.60, 0.42, 0.26], feature_m = "2cm" }
[[plane]]
size_m = [4, 2]
position_m = [0, 0.7, 0]
rotate_deg = [90, 0, 0]
texture = { kind = "noise", colour = [0.02, 0.02, 0.03], second = [0.05, 0.05, 0.06], feature_m = "4cm" }
[[sphere]]
radius_m = "4cm"
position_m = [-0.13, 0.08, 0.04]
colour = [0.75, 0.20, 0.04]
[[box]]
size_m = ["7cm", "7cm", "12cm"]
position_m = [0.15, 0.2, 0]
rotate_deg = [0, 0, 25]
texture = { kind = "checker", colour = [0.08, 0.25, 0.10], second = [0.7, 0.7, 0.6], feature_m = "2cm" }
[[marker]]
spec = "36h11:3:90mm"
[light]
ambient_rgb = [0.35, 0.36, 0.38]
lamps = [{ azimuth_deg = -60, elevation_deg = 50, rgb = [0.6, 0.58, 0.54], angular_size_deg = 3 }]
[noise]
read = 0.0
shot = 0.0
[depth]
file = "depth.mkv"
[job]
stages = ["lightmap", "dof"]
[job.settings.light]
given = [-60, 50]
"""


def scene(work: Work) -> SceneFile:
    """The desk, with bright points before the wall."""
    read = parse_scene(SCENE)
    points = [
        Sphere(radius_m=0.006, position_m=(x, 0.66, z), colour=(0.98, 0.98, 0.95))
        for x, z in ((-0.3, 0.17), (-0.22, 0.25), (-0.12, 0.2), (0.0, 0.26), (0.09, 0.19), (0.2, 0.25), (0.3, 0.2))
    ]
    clip = read.clip.model_copy(update={"width": work.scaled(480, 160), "height": work.scaled(384, 128), "file": "clip.mkv"})
    return read.model_copy(update={"sphere": (*read.sphere, *points), "clip": clip, "samples": work.scaled(3, 1)})


def photograph(work: Work, desk: SceneFile) -> np.ndarray:
    """What a camera with an open lens sees where the virtual ball is a real one."""
    ball = Sphere(radius_m=BALL_M, position_m=(0.0, 0.0, BALL_M), colour=BLUE)
    lens = desk.lens.model_copy(update={"aperture_m": APERTURE_M, "focus_m": FOCUS_M})
    shot = desk.shot[0].model_copy(update={"frames": 1})
    more = {"sphere": (*desk.sphere, ball), "lens": lens, "shot": (shot,), "samples": work.scaled(12, 3)}
    return work.clip(desk.model_copy(update=more)).frames()[0]
def rows(work):
    import time
    t=time.time()
    desk = scene(work)
    clip = work.clip(desk)
    print("clip", time.time()-t); t=time.time()
    yield Figure("s2","x","x",{"clip":clip.frames()[0]})
    p=photograph(work, desk)
    print("photo", time.time()-t); t=time.time()
    yield Figure("s2","y","x",{"photo":p})
