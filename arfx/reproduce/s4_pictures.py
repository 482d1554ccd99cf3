"""Pictures and rates of Yao, Tao, Wu 2018: what its object does to the real plane, and
mirrors of both.

The reference traces rays through the object and the plane (`gi` at level reference; in the
short form cones take its place), and for a mirror ball through the whole synthetic room."""

from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.numerics import normalise
from arfx.core.stage import level_named
from arfx.measure.difference import TOUCHED
from arfx.reproduce.rows import (
    BEFORE,
    CORRECTED,
    REFERENCE,
    Figure,
    Items,
    errors,
    row,
)
from arfx.reproduce.s4_scenes import LAMP, flat_scene, methods, room
from arfx.reproduce.work import Clip, Settings, Shot, Work
from arfx.synth.rays import Rays, radiance
from arfx.synth.world import World

FOOTPRINT_RAD = 0.03  # of a ray: about what a pixel of the ball mirrors
REFLECTED = 0.95  # of the ball's material
_LIFT_M = 1e-4


def pictures(work: Work) -> Items:
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
        settings = methods(work, model, fit, LAMP, **gi)
        yield from beside_reference(
            work, item, title, settings, model == "mirror", why
        )


def on_the_plane(work: Work) -> Items:
    """What indirect light alone changes of a grey plane beside a cube: linear light, mean
    of the pixels around the cube.
    """

    def change(settings: Settings) -> ndarray:
        shot = work.shot(flat_scene(work), settings, 1)
        changed = shot.layer(Layer.IMAGE) - without_planes(shot).layer(Layer.IMAGE)
        return np.asarray(changed[ring(shot.layer(Layer.COVERAGE))].mean(0))

    red, black = (
        [*map(change, methods(work, model, "8cm", plane_gloss=0.0).values())]
        for model in ("red-cube", "black-cube")
    )
    printed, corrected = (change @ [1, -1, 0] for change in red)
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
    printed, corrected = (change.mean() for change in black)
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
    return shot.with_stage(
        type(stage)(stage.params.model_copy(update={"strength": 0.0}))
    )


def ring(coverage: ndarray) -> ndarray:
    """(h, w) bool: pixels beside what is covered."""
    covered = (coverage > 0).astype(np.uint8)
    side = 2 * (len(coverage) // 12) + 1
    return cv2.dilate(covered, np.ones((side, side), np.uint8)) > covered


def beside_reference(
    work: Work,
    item: str,
    title: str,
    settings: dict[str, Any],
    mirror: bool,
    reason: str,
) -> Items:
    """One frame by both methods and by traced rays; the mean error where the effect touches
    the picture.
    """
    clip = room(work)
    shots = {name: work.shot(clip, given, 1) for name, given in settings.items()}
    made = {name: shot.picture() for name, shot in shots.items()}
    best = shots[CORRECTED]
    levels = {
        name: level_named(stage.levels, work.scaled("reference", "draft"))
        for name, stage in best.job.stages.items()
    }
    made[REFERENCE] = best.renderer.image(best.renderer.chain(levels))
    if mirror:
        made[REFERENCE] = mirrored_room(clip, best, made[REFERENCE])
    before = best.renderer.original()
    yield row(
        item,
        title,
        errors(made, before, TOUCHED),
        "grey levels from traced rays, mean where anything changes",
        reason,
        below=1,
    )
    yield Figure(item, title, {BEFORE: before, **made})


def mirrored_room(clip: Clip, shot: Shot, picture: ndarray) -> ndarray:
    """The picture (h, w, 3) uint8 with the object's pixels as a mirror in the room of the
    clip, whose axes are the marker's.
    """
    world = World(clip.scene)
    corners = shot.job.scene.model_corners_m
    low = corners.min(0)
    high = corners.max(0)
    room = world.at(float(world.frame_times_s[shot.facts.index]))
    # it throws its shadow
    ball = [*(low + high) / 2, (high - low).max() / 2, *(0.5, 0.5, 0.5), 0]
    # whatever light of the room comes from no lamp
    sky = np.tile(np.asarray(room.ambient, float), (2, 4, 1))
    room = room._replace(spheres=np.vstack([room.spheres, [ball]]), sky=sky)
    covered = shot.layer(Layer.COVERAGE) > 0.5
    normal, position = (
        shot.layer(name)[covered].astype(float)
        for name in (Layer.NORMAL, Layer.POSITION)
    )
    seen = position - shot.facts.pose.inverse().translation_m
    towards = seen - 2 * (seen * normal).sum(-1, keepdims=True) * normal
    light, _ = radiance(mirror_rays(position + _LIFT_M * normal, towards), room)
    unit = normalise(towards)
    for lamp in room.lights:
        cosine = 1 / np.hypot(1, lamp[6])  # of half its angular size
        light[unit @ lamp[:3] > cosine] += lamp[3:6] / (2 * (1 - cosine))
    out = picture.copy()
    out[covered] = np.rint(
        255 * SRGB.encode(np.clip(REFLECTED * light, 0, 1))
    ).astype(np.uint8)
    return out


def mirror_rays(origins: ndarray, towards: ndarray) -> Rays:
    """From points (n, 3) in directions (n, 3) of any length, each as wide as `FOOTPRINT_RAD`."""
    forward = normalise(towards)
    aside = normalise(np.cross(forward, np.eye(3)[np.abs(forward).argmin(-1)]))
    spans = FOOTPRINT_RAD * np.stack([aside, np.cross(forward, aside)], 1)
    return Rays(origins, forward, spans, np.zeros(len(forward)))
