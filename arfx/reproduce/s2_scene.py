"""What the figures and rates of Zhao et al. 2012 are made from: a real and a virtual ball
on a desk, before a dark wall with bright points. The reference is a photograph of it by the
tracer's own open lens, in which both balls are real."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.settings import converted
from arfx.papers import PAPER
from arfx.reproduce.work import Clip, Settings, Shot, Work
from arfx.run.parameters import parameters, stage_of
from arfx.synth.description import SceneFile, parse_scene

FOCUS_M, APERTURE_M = 0.38, 0.014  # nearer than both balls
# the largest mean filter that Figure 8's block holds
PRINTED = {"formula": "paper", "mean_px": 7}
BALL_M = 0.035  # radius of the virtual ball, which stands on the middle of the marker

# With bright points before the wall
SCENE = """
seed = 12
samples = {samples}
[clip]
width = {width}
height = {height}
file = "{file}"
[lens]
fov_deg = 46
{lens}[[shot]]
frames = {frames}
[shot.path]
{path}
position_m = [0.07, -0.52, 0.2]
target_m = [0, 0.05, 0.07]
[[plane]]
size_m = [1.6, 1.2]
position_m = [0, 0.1, "-0.2mm"]
texture = {{ kind = "wood", colour = [0.20, 0.11, 0.06], second = [0.60, 0.42, 0.26], feature_m = "2cm" }}
[[plane]]
size_m = [4, 2]
position_m = [0, 0.7, 0]
rotate_deg = [90, 0, 0]
texture = {{ kind = "noise", colour = [0.02, 0.02, 0.03], second = [0.05, 0.05, 0.06], feature_m = "4cm" }}
[[sphere]]
radius_m = "4cm"
position_m = [-0.13, 0.08, 0.04]
colour = [0.75, 0.20, 0.04]
[[sphere]]
radius_m = 0.006
position_m = [-0.3, 0.7, 0.17]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [-0.22, 0.7, 0.25]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [-0.12, 0.7, 0.2]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [0.0, 0.7, 0.26]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [0.09, 0.7, 0.19]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [0.2, 0.7, 0.25]
colour = [0.98, 0.98, 0.95]
[[sphere]]
radius_m = 0.006
position_m = [0.3, 0.7, 0.2]
colour = [0.98, 0.98, 0.95]
{ball}[[box]]
size_m = ["7cm", "7cm", "12cm"]
position_m = [0.15, 0.2, 0]
rotate_deg = [0, 0, 25]
texture = {{ kind = "checker", colour = [0.08, 0.25, 0.10], second = [0.7, 0.7, 0.6], feature_m = "2cm" }}
[[marker]]
spec = "36h11:3:90mm"
[light]
ambient_rgb = [0.35, 0.36, 0.38]
lamps = [{{ azimuth_deg = -60, elevation_deg = 50, rgb = [0.6, 0.58, 0.54], angular_size_deg = 3 }}]
[noise]
read = 0.0
shot = 0.0
{depth}
[job]
stages = ["lightmap", "dof"]
[job.settings.light]
given = [-60, 50]
"""
STILL = {
    "path": 'kind = "static"',
    "frames": 1,
    "file": "clip.mkv",
    "depth": '[depth]\nfile = "depth.mkv"',
}
DOLLY = 'kind = "dolly"\nend_m = [0.02, -0.5, 0.21]'
OPEN = f"aperture_m = {APERTURE_M}\nfocus_m = {FOCUS_M}\n"
BALL = f"""[[sphere]]
radius_m = {BALL_M}
position_m = [0, 0, {BALL_M}]
colour = [0.06, 0.12, 0.75]
"""


def scene_of(
    work: Work, full_px: tuple[int, int], samples: int, **parts: Any
) -> SceneFile:
    """parts : of SCENE;  full_px : its size, but in the short form"""
    width, height = work.scaled(full_px, (240, 192))
    size = {"width": width, "height": height, "samples": samples}
    return parse_scene(SCENE.format(**{"lens": "", "ball": "", **size, **parts}))


def desk(work: Work, samples: int, **parts: str) -> SceneFile:
    """One frame, with its depth."""
    return scene_of(work, (400, 320), samples, **STILL, **parts)


def photograph(work: Work) -> ndarray:
    """(h, w, 3) uint8 of what a camera with an open lens sees where the virtual ball is a
    real one.
    """
    return work.clip(desk(work, work.scaled(8, 4), lens=OPEN, ball=BALL)).frames()[0]


def desk_shot(work: Work, clip: Clip, model: Mapping[str, Any]) -> Shot:
    """The frame with a model and the photograph's lens, as printed."""
    width = clip.scene.clip.width
    fov = np.radians(clip.scene.lens.fov_deg)
    infinite_px = float(APERTURE_M * width / 2 / np.tan(fov / 2) / FOCUS_M)
    dof = {**PRINTED, "focus": f"{FOCUS_M}m", "aperture_px": infinite_px}
    return work.shot(clip, {"model": model, "dof": dof})


def under(shot: Shot, formula: str, **dof: Any) -> Shot:
    """The same with depth of field under another formula, and with other settings of it."""
    now = shot.stages["dof"].params
    kind = parameters()["dof"][formula]
    return shot.with_stage(stage_of("dof", converted(now, kind, **dof)))


def models(work: Work) -> dict[str, dict[str, Any]]:
    """Sections `model` of a blue ball, and of one that fills the picture: desk, wall, both balls,
    all of them virtual.
    """
    ball = {"file": work.model("blue-ball"), "fit": f"{2 * BALL_M}m"}
    offset = ["0m", "0.15m", "-0.01m"]
    room = {"file": work.model("desk-with-balls"), "fit": "3m", "offset": offset}
    return {"augmented": ball, "all virtual": room}


def moving_desk(work: Work) -> SceneFile:
    """The same filmed by a moving camera, at the paper's resolution, as coded video and
    without depth.
    """
    moving = {
        "path": DOLLY,
        "frames": work.scaled(8, 4),
        "file": "clip.mp4",
        "depth": "",
    }
    return scene_of(work, (1280, 1024), 1, **moving)


def moving_settings(model: Mapping[str, Any], formula: str) -> Settings:
    lens = {"focus": f"{FOCUS_M}m", "aperture_px": 40.0, "background_m": 1.2}
    return {"model": model, "dof": {**lens, **(PRINTED if formula == PAPER else {})}}
