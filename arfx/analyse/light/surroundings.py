"""The surroundings, folded out of the frame: a cube of radiance around the camera, and what
light it gives.

The direction's angle from the line of sight is the distance from the picture's middle, out
to its border at 90 degrees and back behind. That gives colour and soft shading, never a
direction: a picture of a third of the surroundings says little about the rest, and lamps in
it are clipped.

`soft_light` is for where no direction is known: the surroundings above the anchor's plane,
evened out by half, brighter from above as rooms and skies are, and scaled to what the
markers show; the plane itself below. `with_environment` is for
reflections: one cube per shot, or the panorama that the user gave. Leaves out the four
corners of the picture.
Source: docs/methods/gi.md#environment, docs/methods/light.md#surroundings. Cost: some 0.3
ms a frame at SIZE 16.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.light.brightness import group_means
from arfx.analyse.light.sphere import DEG_8, nearest_cell
from arfx.core.cube import CubeMap, face_directions, look_up, solid_angles
from arfx.core.facts import FrameFacts
from arfx.core.light import DIFFUSE, Light, harmonics
from arfx.core.numerics import divide, normalise, smoothstep

SIZE = 16
FACE_PX = 6  # of the folded cube that is kept
EVEN = 0.5  # share of the surroundings that is taken for even light
# of the radiance's mean, by which it rises towards `overhead`:
# docs/methods/light.md#surroundings
FROM_ABOVE = 1.0
LIES = 0.7  # cosine of the plane's normal to the picture's up from which the plane is taken to lie
# against rough light, per square of its degree: a residual of .2 % of the light is left to
# noise
RIDGE = 2e-3
AROUND = 1.7  # times the marker's size: where the plane beside it is looked at
OUTSTANDING = (
    6.0  # times the panorama's mean radiance from which a pixel belongs to a lamp
)
PANORAMA_PX = 16  # side of a face


def foldable(image: ndarray) -> ndarray:
    """(h, w, 3) float64; what is not finite is black.

    Raises ValueError for less than 3 x 3 pixels.
    """
    picture = np.asarray(image, np.float64)
    h, w = picture.shape[:2]
    if h < 3 or w < 3:
        raise ValueError(f"image of {w}x{h}: at least 3 x 3 pixels")
    return np.where(np.isfinite(picture), picture, 0.0)


def cube_from_picture(image: ndarray, size: int = SIZE) -> ndarray:
    """(6, size, size, 3) float64 radiance, camera frame; faces, rows and columns as in
    `face_directions`. No seam anywhere: what is continuous in the picture is so on the
    sphere.

    image : (h, w, 3) linear RGB of the whole frame, any size of at least 3 x 3. What is not
    finite counts as black.
    """
    picture = foldable(image)
    h, w = picture.shape[:2]
    # as coarse as the faces are: a texel of 90 / size degrees spans this many pixels
    small = cv2.resize(
        picture, (min(w, 2 * size), min(h, 2 * size)), interpolation=cv2.INTER_AREA
    )
    across, ahead = np.split(face_directions(size), [2], -1)
    beside = np.linalg.norm(across, axis=-1, keepdims=True)
    # 0 in the middle, 1 at the border
    out = 1 - np.abs(1 - np.arctan2(beside, ahead) / (np.pi / 2))
    share = (1 + out * across / np.maximum(beside, 1e-12)) / 2
    return _sampled_at(small, share, cv2.BORDER_REPLICATE)


def _sampled_at(picture: ndarray, share: ndarray, border: int) -> ndarray:
    """(6, n, n, 3) of the picture at shares (6, n, n, 2) of its width and height."""
    size = share.shape[1]
    at = (share * picture.shape[1::-1] - 0.5).reshape(-1, size, 2).astype(np.float32)
    x, y = cv2.split(at)
    out = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=border)
    return out.reshape(6, size, size, 3)


def from_panorama(picture: ndarray, size: int = SIZE) -> ndarray:
    """(6, size, size, 3) radiance of an equirectangular picture (h, w, 3), axes of
    static_frame.py (z up, middle column x).

    What is more than OUTSTANDING times as bright as the mean belongs to lamps, which are
    lights of their own: it is cut."""
    a = np.asarray(picture, np.float32)
    solid = np.cos((np.arange(a.shape[0]) + 0.5) / a.shape[0] * np.pi - np.pi / 2)[
        :, None
    ]
    grey = a.mean(-1)
    limit = OUTSTANDING * float((grey * solid).sum() / (solid.sum() * a.shape[1]))
    a = a * np.minimum(1, limit / np.maximum(grey, max(limit, 1e-12)))[..., None]
    a = cv2.resize(a, (4 * size, 2 * size), interpolation=cv2.INTER_AREA)
    x, y, z = np.moveaxis(face_directions(size), -1, 0)
    across = 0.5 - np.arctan2(y, x) / (2 * np.pi)
    half_row = 0.5 / len(a)
    down = np.clip(0.5 - np.arcsin(z) / np.pi, half_row, 1 - half_row)
    return _sampled_at(a, np.stack([across, down], -1), cv2.BORDER_WRAP).astype(float)


def turned(faces: ndarray, source_from_dest: ndarray) -> ndarray:
    """The cube (6, n, n, 3) in other axes. source_from_dest : (3, 3) rotation to the cube's axes"""
    d = face_directions(faces.shape[1])
    return look_up(
        faces, d.reshape(-1, 3) @ np.asarray(source_from_dest, float).T
    ).reshape(faces.shape)


def soft_of(faces: ndarray, world_from_camera: ndarray) -> ndarray:
    """(9, 3) harmonics, WORLD frame, of the radiance of a white diffuse surface over its
    normal (core.light.Light.soft).

    faces : (6, n, n, 3) of `cube_from_picture`;  world_from_camera : (3, 3) rotation"""
    directions = (
        face_directions(faces.shape[1]).reshape(-1, 3)
        @ np.asarray(world_from_camera, float).round(12).T
    )
    basis = (
        harmonics(directions)
        * np.tile(solid_angles(faces.shape[1]).ravel(), 6)[:, None]
    )
    return DIFFUSE[:, None] * (basis.T @ faces.reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class EnvironmentSample:
    """One frame's surroundings. frame : its number;  cube : (6, n, n, 3) radiance, CAMERA
    axes (`cube_from_picture`)
    plane : (3,) radiance beside the marker, as seen
    darkest : of `seen.Snapshot`"""

    frame: int
    cube: ndarray
    plane: ndarray
    darkest: ndarray


def environment_sample(
    frame: int,
    picture: ndarray,
    quad: ndarray,
    width: int,
    darkest: ndarray,
) -> EnvironmentSample:
    """picture : (h, w, 3) linear, at least 3 x 3, of the whole frame, made smaller;  quad :
    (4, 2) a marker's corners in the frame's pixels;  width : of the frame
    """
    quad = (quad + 0.5) * (picture.shape[1] / width) - 0.5
    middle = quad.mean(0)
    fraction = np.linspace(0, 1, 8, endpoint=False)[:, None]
    sides = (1 - fraction) * quad[:, None] + fraction * np.roll(quad, -1, 0)[:, None]
    at = np.rint(middle + AROUND * (sides.reshape(-1, 2) - middle)).astype(int)
    inside = ((at >= 0) & (at < picture.shape[1::-1])).all(1)
    beside = (
        picture[at[inside, 1], at[inside, 0]]
        if inside.any()
        else picture.reshape(-1, 3)
    )
    small = cv2.resize(
        np.ascontiguousarray(picture, np.float32),
        (max(3, picture.shape[1] // 2), max(3, picture.shape[0] // 2)),
    )
    return EnvironmentSample(
        frame,
        cube_from_picture(small, FACE_PX),
        np.clip(np.median(beside, 0), 0, None),
        darkest,
    )


def overhead(static_from_camera: Sequence[ndarray], normal: ndarray) -> ndarray:
    """(3,) unit, STATIC axes: where most of the light of a room or a sky is taken to come from.

    A plane that lies faces it. An upright one sees the half of the room before it: halfway
    between its normal and the picture's up, because cameras are held upright. So it is from
    above in the picture too where a camera looks straight down.
    static_from_camera : (3, 3) of each look;  normal : (3,) unit, of the plane"""
    picture_up = normalise(-np.sum([turn[:, 1] for turn in static_from_camera], 0))
    rise = float(picture_up @ normal)
    return normalise(
        normal + (1 - smoothstep(rise / LIES)) * normalise(picture_up - rise * normal)
    )


def soft_light(
    samples: Sequence[EnvironmentSample],
    static_from_camera: Sequence[ndarray],
    up: ndarray,
    shown: ndarray | None,
) -> Light:
    """Mean of the looks as one light without a direction, STATIC axes.

    static_from_camera : (3, 3) of each look;  up : (3,) unit, out of the plane
    shown : (3,) radiance of a white surface that lies in the plane, None = unknown: the
    surroundings' own scale
    """
    size = samples[0].cube.shape[1]
    directions = face_directions(size).reshape(-1, 3)
    solid = np.tile(solid_angles(size).ravel(), 6)
    total, plane = np.zeros((9, 3)), np.mean([s.plane for s in samples], 0)
    sky = overhead(static_from_camera, up)
    for one, turn in zip(samples, static_from_camera, strict=True):
        d = directions @ turn.T
        facing = solid * np.clip(d @ up, 0, None)
        seen = one.cube.reshape(-1, 3)
        even = divide(facing @ seen, facing.sum())
        brighter = (1 + FROM_ABOVE * d @ sky)[:, None]
        incoming = (EVEN * even + (1 - EVEN) * seen) * brighter
        white = facing @ incoming / np.pi
        if shown is not None:
            # a colour that the surroundings lack altogether comes evenly from all of them
            known = white > 1e-3 * np.max(shown)
            incoming = np.where(known, incoming * divide(shown, white), shown)
            white = shown
        # no plane is brighter than white
        radiance = np.where((facing > 0)[:, None], incoming, np.minimum(plane, white))
        total += soft_of(radiance.reshape(one.cube.shape), turn)
    light = Light.of_soft(total / len(samples), (), "environment")
    # what degree 2 rounds off
    return light if shown is None else scaled_to(light, up[None], shown[None])


def scaled_to(light: Light, normals: ndarray, radiance: ndarray) -> Light:
    """The light, channel by channel as bright as white surfaces are measured, on average.

    normals : (k, 3), axes of the light;  radiance : (k, 3)"""
    shown = light.radiance(normals).mean(0)
    return light.scaled(divide(radiance.mean(0), shown, where_zero=1.0))


def matched(light: Light, normals: ndarray, shown: ndarray) -> Light:
    """The soft light bent so that white surfaces with `normals` look as measured, as little
    as that takes.

    normals : (k, 3) unit, STATIC axes;  shown : (k, 3). Ridge regression of what is missing
    on the harmonics: one normal moves
    the whole light, many shape it. Never below 0 where it was measured to be above."""
    cell = nearest_cell(normals, DEG_8)
    rows, where = np.unique(cell, return_inverse=True)
    equal = np.ones(len(cell))
    basis = harmonics(normalise(group_means(where, normals, equal)))
    soft = np.array(light.soft, float)
    missing = group_means(where, shown, equal) - basis @ soft
    rough = np.diag(np.repeat([0.0, 1.0, 4.0], [1, 3, 5])) * RIDGE + 1e-9 * np.eye(9)
    normal = basis.T @ basis / len(rows) + rough
    soft = soft + np.linalg.solve(normal, basis.T @ missing / len(rows))
    return Light.of_soft(soft, (), light.source)


def with_environment(
    facts: Sequence[FrameFacts],
    samples: Sequence[EnvironmentSample],
    still_camera: bool,
) -> tuple[FrameFacts, ...]:
    """The facts with `environment` in every frame that has a pose and a look in its shot.

    samples : of frames with a pose;  still_camera : the static frame is the camera's, else
    the world's
    """
    # is no light
    bias = np.array(next((f.bias_rgb for f in facts if f.light), (0.0,) * 3))
    seen: dict[int, list[EnvironmentSample]] = {}
    for sample in samples:
        seen.setdefault(facts[sample.frame].shot, []).append(sample)
    whole: dict[int, CubeMap] = {}
    for shot, looks in seen.items():
        cubes = [np.clip(look.cube - bias, 0, None) for look in looks]
        if not still_camera:
            turns = (facts[look.frame].pose.rotation for look in looks)
            cubes = list(map(turned, cubes, turns))
        plane = np.mean([look.plane for look in looks], 0) - bias
        whole[shot] = CubeMap.of(np.mean(cubes, 0), None, np.clip(plane, 0, None))
    out = []
    for f in facts:
        environment = whole.get(f.shot)
        if f.camera_from_world is not None and environment is not None:
            if still_camera:
                environment = replace(environment, axes=camera_axes(f))
            f = f.with_(environment=environment)
        out.append(f)
    return tuple(out)


def camera_axes(f: FrameFacts) -> tuple[float, ...]:
    """`axes` of surroundings that rest before the camera."""
    return tuple(f.pose.rotation.ravel().tolist())
