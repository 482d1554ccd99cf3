"""Figures of Zhao et al. 2012; rates, at their resolution, and the machine that they were
taken on."""

import platform

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB, yuv_from_rgb
from arfx.core.layers import Layer
from arfx.core.machine import usable_cores
from arfx.papers import PAPER
from arfx.papers.s2_dof import PrintedDof
from arfx.reproduce.rows import (
    BEFORE,
    CORRECTED,
    PRINTED,
    REFERENCE,
    Figure,
    Items,
    eight_bit,
    row,
)
from arfx.reproduce.s2_scene import (
    BALL_M,
    desk,
    desk_shot,
    models,
    moving_desk,
    moving_settings,
    photograph,
    under,
)
from arfx.reproduce.work import Shot, Timed, Work, median_s
from arfx.stages import STAGES

GAUSSIAN = "Gaussian filter of figure 12"
BRIGHTER = (
    8  # grey levels above the wall, from which a pixel belongs to a bright point
)
OPEN_LENS = "the tracer's own open lens"
NO_CAMERA = (
    "a photograph by the authors' camera; in its place stands one by an open lens, in which"
    " both balls are real"
)
BALLS_M = {
    "real": ((-0.13, 0.08, 0.04), 0.04),
    "virtual": ((0.0, 0.0, BALL_M), BALL_M),
}
Pictures = dict[str, ndarray]


PC_MB = 2048.0
HERE = (
    "another machine: here the method runs on the cores of a CPU and writes a file without"
    " loss"
)


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
    for item, words in (
        ("figure 4", "photographs with depth of field"),
        ("figure 16", "a photograph"),
    ):
        yield row(item, words, (OPEN_LENS, OPEN_LENS), "", NO_CAMERA)
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
    yield row(
        "figure 1",
        "capture, virtual scene, interaction, communication, display",
        ("clip, analysis, " + order, "clip, analysis, " + order),
        "",
        "input devices, communication and display are no part of a program that processes"
        " recorded clips",
    )
    yield row(
        "figure 2",
        "virtual objects, composition, depth of field",
        (order, order),
        "",
        "",
        order.endswith("composite, dof"),
    )


def _coordinates(shot: Shot, picture: ndarray, camera_m: ndarray) -> Items:
    """The axes of the world, drawn into the picture. camera_m : where the camera stands"""
    pose = shot.facts.pose
    drawn = picture.copy()
    ends = pose.apply(0.08 * np.vstack([np.zeros(3), np.eye(3)]))
    points = np.rint(shot.job.scene.camera.project(ends)).astype(int)
    for end, colour in zip(
        points[1:], ((220, 40, 30), (40, 170, 40), (40, 60, 220)), strict=True
    ):
        cv2.line(drawn, points[0], end, colour, 2, cv2.LINE_AA)
    off_mm = 1e3 * np.linalg.norm(pose.inverse().translation_m - camera_m)
    found = f"axes from a marker; the camera is {off_mm:.1f} mm off"
    yield row(
        "figure 5",
        "axes from feature points",
        (found, found),
        "",
        "found from a marker, whose size makes it metric; which feature points the authors"
        " tracked is not stated",
    )
    yield Figure(
        "figure 5", "axes of the world", {"x red, y green, z blue; 8 cm each": drawn}
    )


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
    yield row(
        "figure 6",
        "depth with blur factor; luminance",
        f"depth {1 / dioptre.max():.2f}-{1 / dioptre.min():.2f} m, blur factor"
        f" {a.min():.2f}-{a.max():.2f}, luminance",
        "",
        "",
        bool(0 <= a.min() <= a.max() <= 1),
    )
    textures = {
        "depth, nearer is brighter": dioptre / dioptre.max(),
        "blur factor a": a,
        "luminance": coded @ yuv_from_rgb("bt601")[0],
        "figure 10, blurred all over": blurred,
    }
    yield Figure("figure 6", "what the printed method makes on its way", textures)
    yield row(
        "figure 9",
        "the scene before",
        ("a scene of the project", "the same"),
        "",
        "",
        True,
    )
    apart = _levels(blurred, made[BEFORE])
    yield row(
        "figure 10",
        "blurred all over",
        f"{apart:.1f} grey levels from figure 9",
        "",
        "nothing was blurred",
        apart > 0.5,
    )
    sharp, printed, corrected = (
        _levels(made[name], made[REFERENCE]) for name in (BEFORE, PRINTED, CORRECTED)
    )
    yield row(
        "figure 11",
        "like a camera",
        [f"{x:.1f} grey levels from the photograph" for x in (printed, corrected)],
        "",
        f"without blur it is {sharp:.1f} away. The printed filter has one size, here 7 px,"
        " and its blend keeps the sharp picture below the blurred one; the open lens makes"
        " discs that grow with the distance",
    )
    yield Figure("figure 11", "sharp and blurred picture blended by (9)", made)


def _points(shot: Shot, made: Pictures, points_m: ndarray) -> Items:
    """Figures 12 and 13: the Gaussian filter and the printed method, beside one another."""
    at = shot.job.scene.camera.project(shot.facts.pose.apply(points_m))
    gaussian = under(shot, "gaussian").picture()
    made = {BEFORE: made[BEFORE], GAUSSIAN: gaussian, **made}
    area = {name: _spread(picture, at) for name, picture in made.items()}
    words = {name: f"bright points of {px:.0f} px each" for name, px in area.items()}
    apart = _levels(gaussian, made[REFERENCE])
    yield row(
        "figure 12",
        "Gaussian filter",
        f"{words[GAUSSIAN]}, {apart:.1f} grey levels from the photograph",
        "",
        "nothing was spread",
        area[GAUSSIAN] > area[BEFORE],
    )
    yield row(
        "figure 13",
        "bright points spread more than in figure 12",
        (
            f"{words[PRINTED]}, Gaussian {area[GAUSSIAN]:.0f} px",
            f"{words[CORRECTED]}, photograph {area[REFERENCE]:.0f} px",
        ),
        "",
        "they do not spread more",
        min(area[PRINTED], area[CORRECTED]) > area[GAUSSIAN],
    )
    pad = 0.06 * made[BEFORE].shape[1]
    low = np.maximum(at.min(0) - pad, 0).astype(int)
    high = (at.max(0) + pad).astype(int)
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    near = {name: p[part].repeat(2, 0).repeat(2, 1) for name, p in made.items()}
    yield Figure("figure 13", "the bright points, twice as large", near)


def _in_focus(shot: Shot, before: ndarray) -> Items:
    closed = {
        PRINTED: under(shot, PAPER, aperture_px=0.4).picture(),
        CORRECTED: under(shot, CORRECTED, aperture_px=0.4).picture(),
    }
    changed = [(picture != before).mean() for picture in closed.values()]
    yield row(
        "figure 14",
        "all in focus, nothing blurred",
        [f"{100 * c:.0f} % of the pixels blurred" for c in changed],
        "",
        "some pixels changed",
        not any(changed),
    )
    yield Figure(
        "figure 14", "a real and a virtual (blue) ball, all in focus", closed
    )


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
        "both balls blurred alike",
        [f"outline keeps: {words[name]}" for name in (PRINTED, CORRECTED)],
        "",
        f"of its steepness a ball's outline keeps in the photograph: {words[REFERENCE]}."
        " As printed outlines stay, since what stands in front does not flow into what is"
        " behind, and the sharp picture shows through the blend",
    )


def _levels(a: ndarray, b: ndarray) -> float:
    """Mean difference in grey levels."""
    return float(np.abs(a.astype(float) - b).mean())


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
    yield row(
        "section 4, machine",
        "Intel Core Duo 2.80 GHz, 2 GB, GeForce 9600 GT",
        (here, here),
        "",
        "another machine, without a graphics processor",
    )
    pairs = zip(own, room, strict=True)
    peaks_mb = [max(one.peak_mb for one in pair) for pair in pairs]
    yield row(
        "section 4, memory of the machine",
        "2 GB",
        [f"at most {mb:.0f} MB used" for mb in peaks_mb],
        "",
        "the process with all its libraries needs more than the authors' machine had",
        max(peaks_mb) <= PC_MB,
    )
    yield row(
        "section 4, resolution",
        "1280*1024",
        (size, size),
        "",
        "the short form is smaller",
    )
    augmented = [timed.frames_per_s for timed in own]
    # nothing is filmed and nothing is tracked: the stages alone
    virtual = [1 / sum(timed.stage_s.values()) for timed in room]
    alone = f"The stages alone, all is a model; {_of_dof(room)}"
    whole = f"With decoding, tracking and encoding; {_of_dof(own)}"
    for item, printed, rates, why in (
        ("section 4, all-virtual scene", 48.0, virtual, alone),
        ("section 4, augmented reality, GPU", 21.0, augmented, whole),
        ("section 4, augmented reality, CPU", 14.0, augmented, whole),
        ("section 5, rate that is needed", 25.0, augmented, whole),
    ):
        holds = min(rates) >= printed
        yield row(item, printed, rates, "fps", f"{HERE}. {why}", holds)
    decoding = clip.scene.frames / median_s(clip.frames, work.scaled(3, 1))
    for how, printed in (("DirectShow", 16.0), ("the board's own software", 25.0)):
        yield row(
            f"section 4, capture by {how}",
            printed,
            None,
            "fps",
            f"there is no camera: a clip of this size is decoded at {decoding:.0f} fps here",
        )


def _of_dof(timed: list[Timed]) -> str:
    printed, corrected = (1e3 * one.stage_s["dof"] for one in timed)
    return (
        f"depth of field takes {printed:.0f} ms of a frame as printed, {corrected:.0f} ms"
        " corrected"
    )
