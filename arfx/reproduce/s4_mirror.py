"""The room as a mirror ball shows it, by rays through the synthetic scene itself: what no
picture of it holds is there too.
"""

from __future__ import annotations

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.numerics import normalise
from arfx.reproduce.work import Clip, Shot
from arfx.synth.rays import Rays, radiance
from arfx.synth.world import World

FOOTPRINT_RAD = 0.03  # of a ray: about what a pixel of the ball mirrors
REFLECTED = 0.95  # of the ball's material
_LIFT_M = 1e-4


def mirrored_room(clip: Clip, shot: Shot, picture: np.ndarray) -> np.ndarray:
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


def mirror_rays(origins: np.ndarray, towards: np.ndarray) -> Rays:
    """From points (n, 3) in directions (n, 3) of any length, each as wide as `FOOTPRINT_RAD`."""
    forward = normalise(towards)
    aside = normalise(np.cross(forward, np.eye(3)[np.abs(forward).argmin(-1)]))
    spans = FOOTPRINT_RAD * np.stack([aside, np.cross(forward, aside)], 1)
    return Rays(origins, forward, spans, np.zeros(len(forward)))
