"""What the figures and rates of Zhao et al. 2012 are made from: a real and a virtual ball
on a desk, before a dark wall with bright points. The reference is a photograph of it by the
tracer's own open lens, in which both balls are real."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.settings import converted
from arfx.papers import PAPER
from arfx.reproduce.work import Clip, Settings, Shot, Work, scene_named
from arfx.run.parameters import parameters, stage_of
from arfx.synth.description import SceneFile

FOCUS_M, APERTURE_M = 0.38, 0.014  # nearer than both balls
# the largest mean filter that Figure 8's block holds
PRINTED = {"formula": "paper", "mean_px": 7}
BALL_M = 0.035  # radius of the virtual ball, which stands on the middle of the marker

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
    """Scene `desk`: bright points before the wall. parts : of it;  full_px : its size, but in
    the short form
    """
    width, height = work.scaled(full_px, (240, 192))
    parts = {"lens": "", "ball": "", **parts}
    return scene_named("desk", width=width, height=height, samples=samples, **parts)


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
