"""Soft light where no direction is known: the picture's surroundings above the anchor's plane, the plane itself below.

The fold of a picture knows a third of what is around, mirrors it, and cannot know what lights the plane: so only its colours
and its broad bright and dark sides are taken, evened out by half, and scaled to what the markers show. What an object's
underside sees is the plane, whose radiance is in the picture. Source: S4's fold (environment.py); SYSTEMS.md S1, cue ladder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.analyse import environment
from arfx.analyse.icosphere import icosphere
from arfx.core.codec import stored
from arfx.core.cube import face_directions, solid_angles
from arfx.core.light import Light, harmonics
from arfx.core.numerics import divide, normalise

FACE_PX = 6  # of the folded cube that is kept
EVEN = 0.5  # share of the surroundings that is taken for even light
RIDGE = 2e-3  # against rough light, per square of its degree: a residual of .2 % of the light is left to noise
AROUND = 1.7  # times the marker's size: where the plane beside it is looked at


@stored
@dataclass(frozen=True, eq=False)
class Look:
    """One frame's surroundings. frame : its number;  cube : (6, n, n, 3) radiance, CAMERA axes (environment.py)
    plane : (3,) radiance beside the marker, as seen"""

    frame: int
    cube: np.ndarray
    plane: np.ndarray


def look(frame: int, picture: np.ndarray, quad: np.ndarray, formula: str = "corrected") -> Look:
    """picture : (h, w, 3) linear, at least 3 x 3, of the whole frame;  quad : (4, 2) a marker's corners in its pixels

    formula : "corrected", folded without a seam, or "paper"
    """
    middle = quad.mean(0)
    share = np.linspace(0, 1, 8, endpoint=False)[:, None]
    sides = np.concatenate([a + share * (b - a) for a, b in zip(quad, np.roll(quad, -1, 0), strict=True)])
    at = np.rint(middle + AROUND * (sides - middle)).astype(int)
    inside = ((at >= 0) & (at < [picture.shape[1], picture.shape[0]])).all(1)
    beside = picture[at[inside, 1], at[inside, 0]] if inside.any() else picture.reshape(-1, 3)
    small = cv2.resize(np.ascontiguousarray(picture, np.float32), (max(3, picture.shape[1] // 2), max(3, picture.shape[0] // 2)))
    folded = environment.fold if formula == "paper" else environment.fold_corrected
    return Look(frame, folded(small, FACE_PX), np.clip(np.median(beside, 0), 0, None))


def soft_light(
    looks: Sequence[Look], room_from_camera: Sequence[np.ndarray], up: np.ndarray, shown: np.ndarray | None
) -> Light:  # fmt: skip
    """Mean of the looks as one light without a direction, ROOM axes.

    room_from_camera : (3, 3) of each look;  up : (3,) unit, out of the plane
    shown : (3,) radiance of a white surface that lies in the plane, None = unknown: the surroundings' own scale
    """
    size = looks[0].cube.shape[1]
    directions, solid = face_directions(size).reshape(-1, 3), np.tile(solid_angles(size).ravel(), 6)
    total, plane = np.zeros((9, 3)), np.mean([s.plane for s in looks], 0)
    for one, turn in zip(looks, room_from_camera, strict=True):
        d = directions @ turn.T
        height = d @ up
        above = (height > 0)[:, None]
        sky = one.cube.reshape(-1, 3)
        even = divide(
            (np.where(above, sky, 0) * (solid * height)[:, None]).sum(0), float((solid * np.clip(height, 0, None)).sum())
        )
        sky = EVEN * even + (1 - EVEN) * sky
        arriving = divide((np.where(above, sky, 0) * (solid * height)[:, None]).sum(0), np.pi)
        if shown is not None:  # a colour that the surroundings lack altogether comes evenly from all of them
            sky = np.where(arriving > 1e-3 * np.max(shown), sky * divide(shown, arriving), shown)
        below = np.minimum(plane, arriving if shown is None else shown)  # no plane is brighter than white
        radiance = np.where(above, sky, below)
        total += environment.soft_light(radiance.reshape(one.cube.shape), turn)
    light = Light.of_soft(total / len(looks), (), "environment")
    if shown is None:
        return light
    return light.scaled(divide(shown, light.radiance(up), where_zero=1.0))  # what degree 2 rounds off


def matched(light: Light, normals: np.ndarray, shown: np.ndarray) -> Light:
    """The soft light bent so that white surfaces with `normals` look as measured, as little as that takes.

    normals : (k, 3) unit, ROOM axes;  shown : (k, 3). Ridge regression of what is missing on the harmonics: one normal moves
    the whole light, many shape it. Never below 0 where it was measured to be above.
    """
    cell = icosphere(3).nearest(normals)
    rows, where = np.unique(cell, return_inverse=True)
    count = np.bincount(where, minlength=len(rows))
    n = normalise(np.stack([np.bincount(where, normals[:, i]) for i in range(3)], -1))
    want = np.stack([np.bincount(where, shown[:, c]) for c in range(3)], -1) / count[:, None]
    basis = harmonics(n)
    soft = np.array(light.soft, float)
    rough = np.diag(np.repeat([0.0, 1.0, 4.0], [1, 3, 5])) * RIDGE + 1e-9 * np.eye(9)
    soft = soft + np.linalg.solve(basis.T @ basis / len(rows) + rough, basis.T @ (want - basis @ soft) / len(rows))
    return Light.of_soft(soft, (), light.source)
