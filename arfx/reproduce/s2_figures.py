"""Figures of Zhao et al. 2012; rates, at their resolution, and the machine that they were
taken on.

They show a real and a virtual ball on a desk, before a dark wall with bright points. The reference
is a photograph of it by the tracer's own open lens, in which both balls are real."""

import platform
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB, yuv_from_rgb
from arfx.core.layers import Layer
from arfx.core.machine import usable_cores
from arfx.core.settings import converted
from arfx.papers import PAPER
from arfx.papers.s2_dof import PrintedDof
from arfx.reproduce.rows import (
    BEFORE,
    CORRECTED,
    PRINTED,
    REFERENCE,
    Items,
    eight_bit,
    rows_of,
)
from arfx.reproduce.work import Clip, Settings, Shot, Work, median_s, scene_named
from arfx.run.parameters import parameters, stage_of
from arfx.stages import STAGES
from arfx.synth.description import SceneFile

row = rows_of("s2")

FOCUS_M, APERTURE_M = 0.38, 0.014  # nearer than both balls
# the largest mean filter that Figure 8's block holds
PRINTED_DOF = {"formula": "paper", "mean_px": 7}
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

GAUSSIAN = "Gaussian filter of figure 12"
BRIGHTER = (
    8  # grey levels above the wall, from which a pixel belongs to a bright point
)
BALLS_M = {
    "real": ((-0.13, 0.08, 0.04), 0.04),
    "virtual": ((0.0, 0.0, BALL_M), BALL_M),
}
PC_MB = 2048.0
Pictures = dict[str, ndarray]


def rows(work: Work) -> Items:
    scene = desk(work, work.scaled(3, 1))
    ball = models(work)["augmented"]
    shot = desk_shot(work, work.clip(scene), ball)
    made = {
        BEFORE: shot.renderer.image(shot.up_to("composite")),
        PRINTED: shot.picture(),
        CORRECTED: under(shot, CORRECTED).picture(),
        REFERENCE: photograph(work),
    }
    yield from _diagrams()
    for item in ("figure 4", "figure 16"):
        yield row(item, ["the tracer's own open lens"] * 2)
    camera_m = np.array(scene.shot[0].path.position_m)
    yield from _coordinates(shot, made[BEFORE], camera_m)
    yield from _steps(shot, made)
    points_m = np.array([ball.position_m for ball in scene.sphere[1:]])
    yield from _points(shot, made, points_m)
    yield from _in_focus(shot, made[BEFORE])
    yield from _out_of_focus(shot, made)


def _diagrams() -> Items:
    order = ", ".join(
        name for name in STAGES if name in ("raster", "composite", "dof")
    )
    yield row("figure 1", [f"clip, analysis, {order}"] * 2)
    yield row("figure 2", (order, order), order.endswith("composite, dof"))


def _coordinates(shot: Shot, picture: ndarray, camera_m: ndarray) -> Items:
    """The axes of the world, drawn into the picture. camera_m : where the camera stands"""
    pose = shot.facts.pose
    drawn = picture[..., ::-1].copy()
    camera = shot.job.scene.camera
    placed = pose.rotvec, pose.translation_m
    cv2.drawFrameAxes(drawn, camera.matrix, np.zeros(4), *placed, 0.08, 2)
    off_mm = 1e3 * np.linalg.norm(pose.inverse().translation_m - camera_m)
    found = f"axes from a marker; the camera is {off_mm:.1f} mm off"
    pictures = {"x red, y green, z blue; 8 cm each": drawn[..., ::-1]}
    yield row("figure 5", (found, found), None, pictures)


def _steps(shot: Shot, made: Pictures) -> Items:
    """Figures 6 and 9 to 11: what the printed method keeps and makes on its way."""
    stage = shot.stages["dof"]
    assert isinstance(stage, PrintedDof)
    run = shot.renderer.run(shot.chain)
    scene = shot.job.scene
    now = run.layers.view(scene.camera.rect)
    dioptre, a = stage.depth_and_blur(
        now, shot.facts, scene, stage.prepare(scene, "standard")
    )
    coded = SRGB.encode(now[Layer.IMAGE]).astype(np.float32)
    blurred = eight_bit(stage.blurred(coded, dioptre))
    textures = {
        "depth, nearer is brighter": dioptre / dioptre.max(),
        "blur factor a": a,
        "luminance": coded @ yuv_from_rgb("bt601")[0],
        "figure 10, blurred all over": blurred,
    }
    yield row(
        "figure 6",
        f"depth {1 / dioptre.max():.2f}-{1 / dioptre.min():.2f} m, blur factor"
        f" {a.min():.2f}-{a.max():.2f}, luminance",
        bool(0 <= a.min() <= a.max() <= 1),
        textures,
    )
    yield row("figure 9", ("a scene of the project", "the same"), True)
    apart = cv2.absdiff(blurred, made[BEFORE]).mean()
    yield row("figure 10", f"{apart:.1f} grey levels from figure 9", apart > 0.5)
    sharp, printed, corrected = (
        cv2.absdiff(made[name], made[REFERENCE]).mean()
        for name in (BEFORE, PRINTED, CORRECTED)
    )
    yield row(
        "figure 11",
        [f"{x:.1f} grey levels from the photograph" for x in (printed, corrected)],
        None,
        made,
        sharp=sharp,
    )


def _points(shot: Shot, made: Pictures, points_m: ndarray) -> Items:
    """Figures 12 and 13: the Gaussian filter and the printed method, beside one another."""
    at = shot.job.scene.camera.project(shot.facts.pose.apply(points_m))
    gaussian = under(shot, "gaussian").picture()
    made = {BEFORE: made[BEFORE], GAUSSIAN: gaussian, **made}
    area = {name: _spread(picture, at) for name, picture in made.items()}
    words = {name: f"bright points of {px:.0f} px each" for name, px in area.items()}
    apart = cv2.absdiff(gaussian, made[REFERENCE]).mean()
    yield row(
        "figure 12",
        f"{words[GAUSSIAN]}, {apart:.1f} grey levels from the photograph",
        area[GAUSSIAN] > area[BEFORE],
    )
    pad = 0.06 * made[BEFORE].shape[1]
    low = np.maximum(at.min(0) - pad, 0).astype(int)
    high = (at.max(0) + pad).astype(int)
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    near = {name: p[part].repeat(2, 0).repeat(2, 1) for name, p in made.items()}
    yield row(
        "figure 13",
        (
            f"{words[PRINTED]}, Gaussian {area[GAUSSIAN]:.0f} px",
            f"{words[CORRECTED]}, photograph {area[REFERENCE]:.0f} px",
        ),
        min(area[PRINTED], area[CORRECTED]) > area[GAUSSIAN],
        near,
    )


def _in_focus(shot: Shot, before: ndarray) -> Items:
    closed = {
        PRINTED: under(shot, PAPER, aperture_px=0.4).picture(),
        CORRECTED: under(shot, CORRECTED, aperture_px=0.4).picture(),
    }
    changed = [(picture != before).mean() for picture in closed.values()]
    found = [f"{100 * c:.0f} % of the pixels blurred" for c in changed]
    yield row("figure 14", found, not any(changed), closed)


def _out_of_focus(shot: Shot, made: Pictures) -> Items:
    camera = shot.job.scene.camera
    words = {}
    for name, picture in made.items():
        kept = []
        for ball, (centre, radius_m) in BALLS_M.items():
            middle = shot.facts.pose.apply(np.array([centre]))
            where = camera.project(middle)[0], camera.fx * radius_m / middle[0, 2]
            share = _steepest(picture, *where) / _steepest(made[BEFORE], *where)
            kept.append(f"{ball} {100 * share:.0f} %")
        words[name] = ", ".join(kept)
    yield row(
        "figure 15",
        [f"outline keeps: {words[name]}" for name in (PRINTED, CORRECTED)],
        photographed=words[REFERENCE],
    )


def _spread(picture: ndarray, at: ndarray) -> float:
    """Pixels of a bright point, on average: those around it that are brighter than the wall
    there.
    """
    luma = picture @ [0.299, 0.587, 0.114]
    half = round(0.035 * picture.shape[1])
    found = []
    for x, y in np.rint(at).astype(int):
        part = luma[max(y - half, 0) : y + half + 1, x - half : x + half + 1]
        found.append((part > np.median(part) + BRIGHTER).sum())
    return float(np.mean(found))


def _steepest(picture: ndarray, centre: ndarray, radius: float) -> float:
    """Greatest slope across the ball's left and right outline, grey levels a pixel, mean of
    rows around its middle.
    """
    x, y = np.rint(centre).astype(int)
    reach = max(round(0.35 * radius), 2)
    found = []
    for edge in (round(x - radius), round(x + radius)):
        part = picture[y - reach : y + 1, edge - reach : edge + reach + 1].astype(
            float
        )
        found.append(np.abs(np.diff(part, axis=1)).max((1, 2)))
    return float(np.mean(found))


def rates(work: Work) -> Items:
    clip = work.clip(moving_desk(work))
    own, room = (
        [
            work.timed(clip, moving_settings(model, formula))
            for formula in (PAPER, CORRECTED)
        ]
        for model in models(work).values()
    )
    size = f"{clip.scene.clip.width}*{clip.scene.clip.height}"
    here = f"{platform.machine()}, {usable_cores()} cores"
    yield row("section 4, machine", (here, here))
    pairs = zip(own, room, strict=True)
    peaks_mb = [max(one.peak_mb for one in pair) for pair in pairs]
    yield row(
        "section 4, memory of the machine",
        [f"at most {mb:.0f} MB used" for mb in peaks_mb],
        max(peaks_mb) <= PC_MB,
    )
    yield row("section 4, resolution", (size, size))
    augmented = [timed.frames_per_s for timed in own]
    # nothing is filmed and nothing is tracked: the stages alone
    virtual = [1 / sum(timed.stage_s.values()) for timed in room]
    alone = "The stages alone, all is a model", virtual, room
    whole = "With decoding, tracking and encoding", augmented, own
    for item, least, (counted, rates, timed) in (
        ("section 4, all-virtual scene", 48, alone),
        ("section 4, augmented reality, GPU", 21, whole),
        ("section 4, augmented reality, CPU", 14, whole),
        ("section 5, rate that is needed", 25, whole),
    ):
        dof_ms = [1e3 * one.stage_s["dof"] for one in timed]
        fast = min(rates) >= least
        yield row(item, rates, fast, counted=counted, dof_ms=dof_ms)
    decoding = clip.scene.frames / median_s(clip.frames, work.scaled(3, 1))
    for how in ("DirectShow", "the board's own software"):
        yield row(f"section 4, capture by {how}", None, decoding=decoding)


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
    dof = {**PRINTED_DOF, "focus": f"{FOCUS_M}m", "aperture_px": infinite_px}
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
    return {
        "model": model,
        "dof": {**lens, **(PRINTED_DOF if formula == PAPER else {})},
    }
