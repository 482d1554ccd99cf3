"""The surroundings, folded out of the frame: a cube of radiance around the camera, and what light it gives.

The direction's angle from the line of sight is the distance from the picture's middle, out to its border at 90 degrees and back
behind. That gives colour and soft shading, never a direction: a picture of a third of the surroundings says little about the
rest, and lamps in it are clipped.

`soft_light` is for where no direction is known: the surroundings above the anchor's plane, evened out by half and scaled to what
the markers show, the plane itself below. `with_environment` is for reflections: one cube per shot, or the panorama that the user
gave. Leaves out the four corners of the picture.
Source: docs/methods/gi.md#environment, docs/methods/light.md#cues. Cost: some 0.3 ms a frame at SIZE 16.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from arfx.analyse.light.given import STANDS_OUT
from arfx.analyse.light.icosphere import icosphere
from arfx.core.codec import serialisable
from arfx.core.cube import CubeMap, face_directions, solid_angles
from arfx.core.facts import FrameFacts
from arfx.core.light import DIFFUSE, Light, harmonics
from arfx.core.numerics import divide, normalise

Folded = Callable[[np.ndarray, int], np.ndarray]
SIZE = 16
FACE_PX = 6  # of the folded cube that is kept
EVEN = 0.5  # share of the surroundings that is taken for even light
RIDGE = 2e-3  # against rough light, per square of its degree: a residual of .2 % of the light is left to noise
AROUND = 1.7  # times the marker's size: where the plane beside it is looked at
PANORAMA_PX = 16  # side of a face


def foldable(image: np.ndarray) -> np.ndarray:
    """(h, w, 3) float64; what is not finite is black. Raises ValueError for less than 3 x 3 pixels."""
    picture = np.asarray(image, np.float64)
    h, w = picture.shape[:2]
    if h < 3 or w < 3:
        raise ValueError(f"image of {w}x{h}: at least 3 x 3 pixels")
    return np.where(np.isfinite(picture), picture, 0.0)


def fold(image: np.ndarray, size: int = SIZE) -> np.ndarray:
    """(6, size, size, 3) float64 radiance, camera frame; faces, rows and columns as in `face_directions`. No seam anywhere: what
    is continuous in the picture is so on the sphere.

    image : (h, w, 3) linear RGB of the whole frame, any size of at least 3 x 3. What is not finite counts as black.
    """
    picture = foldable(image)
    h, w = picture.shape[:2]
    # as coarse as the faces are: a texel of 90 / size degrees spans this many pixels
    small = cv2.resize(picture, (min(w, 2 * size), min(h, 2 * size)), interpolation=cv2.INTER_AREA)
    d = face_directions(size)
    angle = np.arctan2(np.hypot(d[..., 0], d[..., 1]), d[..., 2]) / (np.pi / 2)
    out = 1 - np.abs(1 - angle)  # 0 in the middle, 1 at the border
    across = np.maximum(np.hypot(d[..., 0], d[..., 1]), 1e-12)
    x = (1 + out * d[..., 0] / across) / 2 * small.shape[1] - 0.5
    y = (1 + out * d[..., 1] / across) / 2 * small.shape[0] - 0.5
    return _looked_up(small, x, y, cv2.BORDER_REPLICATE)


def _looked_up(picture: np.ndarray, x: np.ndarray, y: np.ndarray, border: int) -> np.ndarray:
    """(6, n, n, 3) of the picture at places (6, n, n)."""
    places = zip(x.astype(np.float32), y.astype(np.float32), strict=True)
    return np.stack([cv2.remap(picture, a, b, cv2.INTER_LINEAR, borderMode=border) for a, b in places])


def from_panorama(picture: np.ndarray, size: int = SIZE) -> np.ndarray:
    """(6, size, size, 3) radiance of an equirectangular picture (h, w, 3), axes of given.py (z up, middle column x).

    What is more than STANDS_OUT times as bright as the mean belongs to lamps, which are lights of their own: it is cut.
    """
    a = np.asarray(picture, np.float32)
    solid = np.cos((np.arange(a.shape[0]) + 0.5) / a.shape[0] * np.pi - np.pi / 2)[:, None]
    grey = a.mean(-1)
    limit = STANDS_OUT * float((grey * solid).sum() / (solid.sum() * a.shape[1]))
    a = np.ascontiguousarray(a * np.minimum(1, limit / np.maximum(grey, max(limit, 1e-12)))[..., None], np.float32)
    a = np.asarray(cv2.resize(a, (4 * size, 2 * size), interpolation=cv2.INTER_AREA), np.float32)
    d = face_directions(size)
    x = (0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi)) * a.shape[1] - 0.5
    y = (0.5 - np.arcsin(np.clip(d[..., 2], -1, 1)) / np.pi) * a.shape[0] - 0.5
    y = np.clip(y, 0, a.shape[0] - 1)
    return _looked_up(a, x, y, cv2.BORDER_WRAP).astype(float)


def mip_chain(faces: np.ndarray) -> list[np.ndarray]:
    """The cube (6, n, n, 3), n a power of two, and its means over 2 x 2 texels, down to one texel a face."""
    out = [np.asarray(faces)]
    while out[-1].shape[1] > 1:
        n = out[-1].shape[1] // 2
        out.append(out[-1].reshape(6, n, 2, n, 2, 3).mean((2, 4)))
    return out


def look_up(faces: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(k, 3) radiance in directions (k, 3), axes of the cube (6, n, n, 3): linear between the texels of a face."""
    size = faces.shape[1]
    d = np.asarray(directions, float)
    axis = np.abs(d).argmax(1)
    major = np.take_along_axis(d, axis[:, None], 1)[:, 0]
    q = d / np.maximum(np.abs(major), 1e-12)[:, None]
    u, v = np.choose(axis, [-q[:, 2], q[:, 0], q[:, 0]]), np.choose(axis, [q[:, 1], -q[:, 2], q[:, 1]])
    face = 2 * axis + (major < 0)
    x, y = (np.clip((t + 1) / 2 * size - 0.5, 0, size - 1) for t in (u, v))
    i, j = np.minimum(x.astype(int), max(size - 2, 0)), np.minimum(y.astype(int), max(size - 2, 0))
    i1, j1 = np.minimum(i + 1, size - 1), np.minimum(j + 1, size - 1)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    top = faces[face, j, i] * (1 - fx) + faces[face, j, i1] * fx
    return np.asarray(top * (1 - fy) + (faces[face, j1, i] * (1 - fx) + faces[face, j1, i1] * fx) * fy)


def turned(faces: np.ndarray, source_from_dest: np.ndarray) -> np.ndarray:
    """The cube (6, n, n, 3) in other axes. source_from_dest : (3, 3) rotation to the cube's axes"""
    d = face_directions(faces.shape[1])
    return look_up(faces, d.reshape(-1, 3) @ np.asarray(source_from_dest, float).T).reshape(faces.shape)


def soft_of(faces: np.ndarray, world_from_camera: np.ndarray) -> np.ndarray:
    """(9, 3) harmonics, WORLD frame, of the radiance of a white diffuse surface over its normal (core.light.Light.soft).

    faces : (6, n, n, 3) of `fold`;  world_from_camera : (3, 3) rotation
    """
    n = faces.shape[1]
    basis = _basis(n, np.asarray(world_from_camera, float).round(12).tobytes())
    return DIFFUSE[:, None] * (basis.T @ faces.reshape(-1, 3))


@lru_cache(maxsize=2)
def _basis(size: int, rotation: bytes) -> np.ndarray:
    """(6 n n, 9) harmonics of the texels' world directions times their solid angles."""
    directions = face_directions(size).reshape(-1, 3) @ np.frombuffer(rotation).reshape(3, 3).T
    return harmonics(directions) * np.tile(solid_angles(size).ravel(), 6)[:, None]


@serialisable
@dataclass(frozen=True, eq=False)
class Look:
    """One frame's surroundings. frame : its number;  cube : (6, n, n, 3) radiance, CAMERA axes (`fold`)
    plane : (3,) radiance beside the marker, as seen"""

    frame: int
    cube: np.ndarray
    plane: np.ndarray


def look(frame: int, picture: np.ndarray, quad: np.ndarray, folded: Folded = fold) -> Look:
    """picture : (h, w, 3) linear, at least 3 x 3, of the whole frame;  quad : (4, 2) a marker's corners in its pixels

    folded : makes the cube of a picture
    """
    middle = quad.mean(0)
    share = np.linspace(0, 1, 8, endpoint=False)[:, None]
    sides = np.concatenate([a + share * (b - a) for a, b in zip(quad, np.roll(quad, -1, 0), strict=True)])
    at = np.rint(middle + AROUND * (sides - middle)).astype(int)
    inside = ((at >= 0) & (at < [picture.shape[1], picture.shape[0]])).all(1)
    beside = picture[at[inside, 1], at[inside, 0]] if inside.any() else picture.reshape(-1, 3)
    small = cv2.resize(np.ascontiguousarray(picture, np.float32), (max(3, picture.shape[1] // 2), max(3, picture.shape[0] // 2)))
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
        total += soft_of(radiance.reshape(one.cube.shape), turn)
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


def with_environment(
    facts: Sequence[FrameFacts], looks: Sequence[Look], still_camera: bool, panorama: np.ndarray | None,
    world_from_anchor: np.ndarray,
) -> tuple[FrameFacts, ...]:  # fmt: skip
    """The facts with `environment` in every frame that has a pose and a look in its shot.

    still_camera : the room is the camera's, else the world's;  world_from_anchor : (3, 3)
    """
    given = None if panorama is None else turned(from_panorama(panorama, PANORAMA_PX), np.asarray(world_from_anchor).T)
    bias = np.array(next((f.bias_rgb for f in facts if f.light is not None), (0.0, 0.0, 0.0)))  # is no light
    by_shot: dict[int, list[np.ndarray]] = {}
    for look in looks:
        f = facts[look.frame]
        if f.camera_from_world is None:
            continue
        cube = np.clip(look.cube - bias, 0, None)
        by_shot.setdefault(f.shot, []).append(cube if still_camera else turned(cube, f.camera_from_world.rotation))
    mean = {shot: np.mean(cubes, 0) for shot, cubes in by_shot.items()}
    plane = {
        shot: np.clip(np.mean([s.plane for s in looks if facts[s.frame].shot == shot], 0) - bias, 0, None) for shot in by_shot
    }

    def cube_map(faces: np.ndarray, plane_rgb: np.ndarray | None = None) -> CubeMap:
        return CubeMap.of(np.maximum(faces, 0), None, plane_rgb)

    whole = {shot: cube_map(cube, plane[shot]) for shot, cube in mean.items()}
    always = None if given is None else cube_map(given)
    out = []
    for f in facts:
        pose = f.camera_from_world
        if pose is None or (always is None and f.shot not in mean):
            out.append(f)
        elif always is not None:
            out.append(f.with_(environment=always))
        elif still_camera:
            out.append(f.with_(environment=cube_map(turned(mean[f.shot], pose.rotation), plane[f.shot])))
        else:
            out.append(f.with_(environment=whole[f.shot]))
    return tuple(out)
