"""Pictures and rates of Yao, Tao, Wu 2018: what its object does to the real plane, and mirrors of both.

The reference traces rays through the same scene (`gi` at level reference; in the short form cones take its place)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from arfx.core.layers import Layer
from arfx.core.stage import level_named
from arfx.measure.difference import difference, touched
from arfx.measure.steps import chain_of
from arfx.papers import CORRECTED as CORRECTED_FORMULA
from arfx.papers import PAPER as PAPER_FORMULA
from arfx.reproduce.rows import BEFORE, CORRECTED, PRINTED, REFERENCE, UNDERIVED, Figure, Item, Row, bars, shown
from arfx.reproduce.work import Clip, Shot, Work, shot_of

PAPER = "s4"
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
name = "desk"
size_m = [1.6, 1.2]
position_m = [0, 0.1, "-0.2mm"]
texture = {{ kind = "wood", colour = [0.30, 0.18, 0.10], second = [0.62, 0.46, 0.30], feature_m = "2cm" }}
[[plane]]
name = "wall"
size_m = [9, 2.6]
position_m = [0, 1.5, 0.6]
rotate_deg = [90, 0, 0]
texture = {{ kind = "poster", feature_m = "7cm" }}
[[plane]]
name = "floor"
size_m = [8, 8]
position_m = [0, 0, -0.75]
texture = {{ kind = "carpet", colour = [0.10, 0.11, 0.14], second = [0.30, 0.30, 0.33], feature_m = "3cm" }}
[[box]]
name = "book"
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
LAMP, FLAT_LAMP = (148, 52, 0.42, 0.40, 0.36), (60, 45, 0.5, 0.5, 0.5)  # of the two scenes
Settings = dict[str, dict[str, object]]


def said(item: str, printed: str, values: Sequence[float], holds: bool, reason: str = "", unit: str = "") -> Row:
    """values : by the printed and by the corrected method;  otherwise as `shown`"""
    return shown(PAPER, item, printed, values[0], values[1], holds, reason, unit)


def flat_scene(work: Work) -> Clip:
    """A grey plane, a marker, one lamp."""
    return work.clip(_FLAT.format())


def room(work: Work) -> Clip:
    size = work.scaled(
        {"width": 480, "height": 270, "frames": 12, "samples": 2}, {"width": 128, "height": 72, "frames": 2, "samples": 1}
    )
    return work.clip(_ROOM.format(**size))


def settings(work: Work, model: str, fit: str, light: Sequence[float], **gi: object) -> Settings:
    """light : configured, as in the paper: azimuth, elevation, R, G, B of the scene's lamp"""
    return {
        "model": {"file": work.model(model), "fit": fit}, "gi": {"samples": 32, **gi},
        "pipeline": {"stages": ["lightmap", "gi"], "quality": work.scaled("standard", "draft")}, "light": {"given": list(light)},
    }  # fmt: skip


def under(formula: str, given: Settings) -> Settings:
    """Indirect light by one formula, all else by the corrected one: only this paper's methods differ."""
    return {**given, "gi": {**given["gi"], "formula": formula}}


def pictures(work: Work) -> Iterator[Item]:
    yield from on_the_plane(work)
    cones = "voxels leak and blur; cones are wide; the printed delta is turned round, and is light, not a share of the plane's"
    red = work.scaled("red teapot", "red cube")
    for item, title, model, fit, gi in (
        ("step 4, indirect light of an object and the plane under it", "a red teapot on a desk", red, "13cm", {}),
        ("step 4, the surroundings in a shiny object", "a mirror ball", work.scaled("mirror", "cube"), "9cm", {}),
        ("step 4, the object in a shiny real plane", "a varnished desk", red, "13cm", {"plane_gloss": 0.25}),
    ):
        yield from beside_reference(work, item, title, settings(work, model, fit, LAMP, **gi), cones)
    yield from rates(work)


def on_the_plane(work: Work) -> Iterator[Row]:
    """What indirect light alone changes of a grey plane beside a cube: linear light, mean of the pixels around the cube."""
    changes = {}
    for model in ("black cube", "red cube"):
        for formula in (PAPER_FORMULA, CORRECTED_FORMULA):
            shot = work.shot(flat_scene(work), 1, settings=under(formula, settings(work, model, "8cm", FLAT_LAMP)))
            beside = ring(shot.layer(Layer.COVERAGE))
            changed = shot.layer(Layer.IMAGE) - without_planes(shot).layer(Layer.IMAGE)
            changes[model, formula] = changed[beside].mean(0)
    red = {f: float(changes["red cube", f][0] - changes["red cube", f][1]) for f in (PAPER_FORMULA, CORRECTED_FORMULA)}
    yield said(
        "step 2, delta volume: red that a red cube gives the plane", "V_Δ = V_ρ - V_μ",
        (-red[PAPER_FORMULA], red[CORRECTED_FORMULA]), red[PAPER_FORMULA] < 0,
        "with ρ the real scene alone the difference is that without the object less that with it: added as printed, it takes red "
        "from the plane; the printed method here subtracts it", "red less green, linear light",
    )  # fmt: skip
    black = [float(changes["black cube", f].mean()) for f in (PAPER_FORMULA, CORRECTED_FORMULA)]
    yield said(
        "step 4, darkening of the plane by a black cube", "the real surface is lit through V_Δ", black, black[0] < -0.003,
        "points of one plane send each other no light, so V_Δ holds nothing that a black object could take away; corrected: what "
        "it hides of the surroundings", "linear light",
    )  # fmt: skip


def without_planes(shot: Shot) -> Shot:
    """The same frame with indirect light on the object alone."""
    stage = shot.job.stages["gi"]
    weak = type(stage)(dataclasses.replace(stage.params, strength=0.0))
    return shot_of(dataclasses.replace(shot.job, stages={**shot.job.stages, "gi": weak}), shot.renderer.facts.index)


def ring(coverage: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels beside what is covered."""
    covered = (coverage > 0).astype(np.uint8)
    wide = cv2.dilate(covered, np.ones((2 * (coverage.shape[0] // 12) + 1,) * 2, np.uint8))
    return np.asarray((wide > 0) & (covered == 0))


def beside_reference(work: Work, item: str, title: str, given: Settings, reason: str) -> Iterator[Item]:
    """One frame by both methods and by traced rays; the mean error where the effect touches the picture."""
    shots = {
        name: work.shot(room(work), 1, settings=under(formula, given))
        for name, formula in ((PRINTED, PAPER_FORMULA), (CORRECTED, CORRECTED_FORMULA))
    }  # fmt: skip
    made = {name: shot.picture() for name, shot in shots.items()}
    best = shots[CORRECTED]
    levels = {name: level_named(stage.levels, work.scaled("reference", "draft")) for name, stage in best.job.stages.items()}
    made[REFERENCE] = best.renderer.image(chain_of(best.renderer.plan, levels))
    before = shots[PRINTED].renderer.original()
    where = touched(*((before, picture) for picture in made.values()))
    off = [difference(made[REFERENCE], made[name], where).mean for name in (PRINTED, CORRECTED)]
    yield said(item, title, off, max(off) < 1, reason, "grey levels from traced rays, mean where anything changes")
    yield Figure(PAPER, item, title, {BEFORE: before, **made})


def rates(work: Work) -> Iterator[Item]:
    """Whole jobs with a teapot."""
    given = settings(work, work.scaled("red teapot", "red cube"), "13cm", LAMP)
    timed = {f: work.timed(room(work), settings=under(f, given)) for f in (PAPER_FORMULA, CORRECTED_FORMULA)}
    size = f"{room(work).scene.clip.width} x {room(work).scene.clip.height}"
    printed, corrected = timed.values()
    why = (
        "the paper names real time as its aim, and no rate, picture size or machine; it uses a graphics card, here there is none"
    )
    unit = f"frames/s at {size}"
    yield Row(PAPER, "frame rate", "real time", printed.frames_per_s, corrected.frames_per_s, unit, UNDERIVED, why)
    words, unit = "voxels in the memory of the graphics card", "MB of the whole process"
    yield Row(PAPER, "memory", words, printed.peak_mb, corrected.peak_mb, unit, UNDERIVED, why)
    stages = sorted({name for t in timed.values() for name in t.stage_s})
    yield bars(
        PAPER, "frame rate", "time of a frame by stage", "ms", stages,
        {name: [1e3 * t.stage_s.get(s, 0.0) for s in stages] for name, t in ((PRINTED, printed), (CORRECTED, corrected))},
    )  # fmt: skip
