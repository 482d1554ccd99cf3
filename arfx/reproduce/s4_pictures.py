"""Pictures and rates of Yao, Tao, Wu 2018: what its object does to the real plane, and
mirrors of both.

The reference traces rays through the object and the plane (`gi` at level reference; in the
short form cones take its place), and for a mirror ball through the whole synthetic room."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from arfx.core.layers import Layer
from arfx.core.stage import level_named
from arfx.measure.difference import difference, touched
from arfx.papers import CORRECTED as CORRECTED_FORMULA
from arfx.papers import PAPER
from arfx.reproduce.rows import (
    BEFORE,
    CORRECTED,
    PRINTED,
    REFERENCE,
    Bars,
    Figure,
    Item,
    Row,
    row,
)
from arfx.reproduce.s4_mirror import mirrored_room
from arfx.reproduce.s4_scenes import (
    FLAT_LAMP,
    LAMP,
    Settings,
    flat_scene,
    room,
    settings,
    under,
)
from arfx.reproduce.work import Shot, Work


def pictures(work: Work) -> Iterator[Item]:
    red = work.scaled("red-teapot", "red-cube")
    mirror = work.scaled("mirror", "cube")
    matte = {"plane_gloss": 0.0}
    for item, title, model, fit, gi, why in (
        (
            "step 4, indirect light of an object and the plane under it",
            "a red teapot on a desk",
            red,
            "13cm",
            matte,
            "only lamps are in the printed volumes, so that nothing darkens the plane around"
            " the object; voxels leak and blur",
        ),
        (
            "step 4, the surroundings in a shiny object",
            "a mirror ball",
            mirror,
            "9cm",
            matte,
            "one picture does not show what is above it and behind the camera: both guess it"
            " from the same picture",
        ),
        (
            "step 4, the object in a shiny real plane",
            "a varnished desk",
            red,
            "13cm",
            {"plane_gloss": 0.25},
            "as above; the printed mirror cone meets the volumes' voxels, and again lamps'"
            " light alone",
        ),
    ):
        yield from beside_reference(
            work, item, title, model, settings(work, model, fit, LAMP, **gi), why
        )
    yield from rates(work)


def on_the_plane(work: Work) -> Iterator[Row]:
    """What indirect light alone changes of a grey plane beside a cube: linear light, mean
    of the pixels around the cube.
    """
    changes = {}
    for model in ("black-cube", "red-cube"):
        given = settings(work, model, "8cm", FLAT_LAMP, plane_gloss=0.0)
        for formula in (PAPER, CORRECTED_FORMULA):
            shot = work.shot(flat_scene(work), 1, settings=under(work, formula, given))
            changed = shot.layer(Layer.IMAGE) - without_planes(shot).layer(Layer.IMAGE)
            changes[model, formula] = changed[ring(shot.layer(Layer.COVERAGE))].mean(0)
    printed, corrected = (
        float(changes["red-cube", f] @ [1, -1, 0]) for f in (PAPER, CORRECTED_FORMULA)
    )
    yield row(
        "step 2, delta volume: red that a red cube gives the plane",
        "V_Δ = V_ρ - V_μ",
        (-printed, corrected),
        "red less green, linear light",
        "with ρ the real scene alone the difference is that without the object less that"
        " with it: added as printed, it takes red from the plane; the printed method here"
        " subtracts it",
        printed < 0,
    )
    printed, corrected = (
        float(changes["black-cube", f].mean()) for f in (PAPER, CORRECTED_FORMULA)
    )
    yield row(
        "step 2, delta volume: what a black cube takes from the plane",
        "the object's shadow is in V_Δ",
        (printed, corrected),
        "linear light",
        "points of one plane send each other no light, so V_Δ holds little that a black"
        " object could take away; corrected: what it hides of the surroundings",
        printed < corrected / 2,
    )


def without_planes(shot: Shot) -> Shot:
    """The same frame with indirect light on the object alone."""
    stage = shot.stages["gi"]
    return shot.with_stage(type(stage)(stage.params.model_copy(update={"strength": 0.0})))


def ring(coverage: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels beside what is covered."""
    covered = (coverage > 0).astype(np.uint8)
    wide = cv2.dilate(
        covered, np.ones((2 * (coverage.shape[0] // 12) + 1,) * 2, np.uint8)
    )
    return np.asarray((wide > 0) & (covered == 0))


def beside_reference(
    work: Work, item: str, title: str, model: str, given: Settings, reason: str
) -> Iterator[Item]:
    """One frame by both methods and by traced rays; the mean error where the effect touches
    the picture.
    """
    shots = {
        name: work.shot(room(work), 1, settings=under(work, formula, given))
        for name, formula in ((PRINTED, PAPER), (CORRECTED, CORRECTED_FORMULA))
    }
    made = {name: shot.picture() for name, shot in shots.items()}
    best = shots[CORRECTED]
    levels = {
        name: level_named(stage.levels, work.scaled("reference", "draft"))
        for name, stage in best.job.stages.items()
    }
    made[REFERENCE] = best.renderer.image(best.renderer.chain(levels))
    if model == "mirror":
        made[REFERENCE] = mirrored_room(room(work), best, made[REFERENCE])
    before = shots[PRINTED].renderer.original()
    where = touched(*((before, picture) for picture in made.values()))
    off = [
        difference(made[REFERENCE], made[name], where).mean
        for name in (PRINTED, CORRECTED)
    ]
    yield row(
        item,
        title,
        off,
        "grey levels from traced rays, mean where anything changes",
        reason,
        max(off) < 1,
    )
    yield Figure(item, title, {BEFORE: before, **made})


def rates(work: Work) -> Iterator[Item]:
    """Whole jobs with a teapot."""
    given = settings(work, work.scaled("red-teapot", "red-cube"), "13cm", LAMP)
    timed = {
        f: work.timed(room(work), settings=under(work, f, given))
        for f in (PAPER, CORRECTED_FORMULA)
    }
    size = f"{room(work).scene.clip.width} x {room(work).scene.clip.height}"
    printed, corrected = timed.values()
    why = (
        "the paper names real time as its aim, and no rate, picture size or machine; it"
        " uses a graphics card, here there is none"
    )
    yield row(
        "frame rate",
        "real time",
        (printed.frames_per_s, corrected.frames_per_s),
        f"frames/s at {size}, 64³ voxels",
        why,
    )
    words, unit = "voxels in the memory of the graphics card", "MB of the whole process"
    yield row("memory", words, (printed.peak_mb, corrected.peak_mb), unit, why)
    stages = sorted({name for t in timed.values() for name in t.stage_s})
    yield Bars(
        "frame rate",
        "time of a frame by stage",
        "ms",
        stages,
        {
            name: [1e3 * t.stage_s.get(s, 0.0) for s in stages]
            for name, t in ((PRINTED, printed), (CORRECTED, corrected))
        },
    )
