"""What arrives at the object in one frame: the environment, and the picture on the real planes."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from arfx.core.cube import CubeMap, SeenEnvironment, face_directions, look_up
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import divide
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import View
from arfx.stages.gi.background import Background
from arfx.stages.gi.plane_change import measured
from arfx.stages.light.environment import Environment
from arfx.stages.light.planes import (
    Planes,
    PlatePicture,
    filled,
    mip_chain,
    texel_positions,
)
from arfx.stages.light.surroundings import frame_environment, frame_surroundings
from arfx.stages.light.transport import SKY

_LIGHT_STEP = 0.03
_PLANE_STEP = 0.05  # of the planes' mean: of their change that is 1 %
# Of the way from one map of the surroundings to the next, a second later. What the sky sends
# straight to the object is that of the frame: steps are left in what bounces.
_SHARE_STEP = 1 / 4
_AXES_STEP = 1 / 16
_FAR_SHARE = (
    6  # of a plane's texture, on each side: beyond some 3 radii of the object
)


@dataclass(frozen=True, eq=False)
class IncomingLight:
    """shown : what the frame shows of the planes
    picture (p, side, side, 3) : radiance of the planes, filled where the frame does not
    show them
    mean (3,) : of it near the object;  environment : with the turn from the anchor's axes
    """

    planes: Planes
    shown: PlatePicture
    picture: ndarray
    mean: ndarray
    environment: Environment

    def change(self, mean: ndarray, left: ndarray) -> ndarray:
        """(p n^2, 3) radiance of the picture on the planes less `mean` (3,), where the object
        leaves that share.

        left (p, n, n, 3) : of `Indirect`
        """
        size = left.shape[1:3]
        seen = [
            cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in self.picture
        ]
        return np.asarray(((np.stack(seen) - mean) * left).reshape(-1, 3))

    def background(self, left: ndarray) -> Background:
        """As mirrors see it, the planes darkened and lit by the object.

        left (p, n, n, 3) : of `Indirect`
        """
        planes, side = self.planes, self.picture.shape[1]
        shares = [cv2.resize(a.astype(np.float32), (side, side)) for a in left]
        picture = (self.picture * np.stack(shares)).astype(np.float32)
        extents = np.column_stack(
            [np.full(len(planes.axes), planes.half_m), planes.bounds]
        )
        textures = mip_chain(picture)
        return Background(
            planes.axes, extents.astype(np.float32), *textures, self.environment
        )


def incoming_light(
    view: View, seen: Rect, planes: Planes, side: int
) -> IncomingLight:
    """seen : the pixels that may be looked at (the same for every part of the frame that is
    rendered);  side : texels a side of the picture on a plane"""
    facts, scene, light = view.facts, view.scene, view.light
    shown = PlatePicture(
        view[Layer.PLATE],
        view.rect,
        seen,
        scene.camera,
        view.pose @ scene.world_from_anchor,
        np.array(facts.bias_rgb, np.float32),
        measured(view.layers),
    )
    each = zip(texel_positions(planes, side), planes.axes.astype(float), strict=True)
    found = [shown.radiance(places, axes) for places, axes in each]
    picture, known = (np.stack(a) for a in zip(*found, strict=True))
    turn = scene.world_from_anchor.rotation
    mean = _plane_mean(picture, known, 0.4 * light.radiance(turn[:, 2]))
    environment = frame_environment(facts, scene, light)
    cube_from_anchor = (environment.turn @ turn).astype(np.float32)
    environment = environment._replace(turn=cube_from_anchor)
    return IncomingLight(
        planes, shown, filled(picture, known, mean), mean, environment
    )


def sky_radiance(facts: FrameFacts, scene: Scene, light: Light) -> ndarray:
    """(6 SKY^2, 3) of the surroundings as matt surfaces see them, the anchor's axes, as
    `sky_texels` numbers them.
    """
    around = frame_surroundings(facts, scene, light)
    cube = around.cube(around.wide).astype(np.float32)
    coarse = [
        cv2.resize(face, (SKY, SKY), interpolation=cv2.INTER_AREA) for face in cube
    ]
    cube_from_anchor = around.axes @ scene.world_from_anchor.rotation
    return look_up(
        np.stack(coarse), face_directions(SKY).reshape(-1, 3) @ cube_from_anchor.T
    )


def in_steps(facts: FrameFacts, light: Light) -> FrameFacts:
    """The light and its surroundings in steps too small to show by what bounces, so that it
    can be kept.
    """
    seen, guess = facts.seen_environment, facts.environment
    if seen is not None:
        share = float(_nearest(seen.share, _SHARE_STEP))
        seen = replace(seen, share=share, axes=_axes_in_steps(seen))
    if guess is not None:
        plane = guess.plane_rgb
        rgb = None if plane is None else triple(_powers(plane, _PLANE_STEP))
        guess = replace(guess, axes=_axes_in_steps(guess), plane_rgb=rgb)
    return facts.with_(
        light=light_in_steps(light), seen_environment=seen, environment=guess
    )


def mean_in_steps(mean: ndarray) -> ndarray:
    """The planes' mean radiance (3,), as `in_steps` has the light."""
    return _powers(mean, _PLANE_STEP)


def light_in_steps(light: Light) -> Light:
    def coarse(lamp: DirectionalLight) -> DirectionalLight:
        rgb, size_deg = (
            triple(_powers(lamp.rgb, _LIGHT_STEP)),
            round(lamp.angular_size_deg),
        )
        direction = triple(np.round(lamp.unit, 2))
        return replace(lamp, direction=direction, rgb=rgb, angular_size_deg=size_deg)

    soft = np.asarray(light.soft, float).reshape(-1, 3)
    if light.soft:
        shape = _nearest(divide(soft, soft[0]), _LIGHT_STEP)
        soft = shape * _powers(soft[0], _LIGHT_STEP)
    return replace(
        light,
        ambient_rgb=triple(_powers(light.ambient_rgb, _LIGHT_STEP)),
        lights=tuple(map(coarse, light.lights)),
        soft=tuple(map(triple, soft)),
    )


def _axes_in_steps(found: SeenEnvironment | CubeMap) -> tuple[float, ...] | None:
    return (
        None
        if found.axes is None
        else tuple(_nearest(found.axes, _AXES_STEP).tolist())
    )


def _nearest(values: ArrayLike, step: float) -> ndarray:
    return np.asarray(np.round(np.asarray(values, float) / step) * step)


def _powers(values: ArrayLike, step: float) -> ndarray:
    """The nearest power of e^step; 0 up to 1e-6."""
    a = np.asarray(values, float)
    return np.where(
        a > 1e-6, np.exp(_nearest(np.log(np.maximum(a, 1e-6)), step)), 0.0
    )


def _plane_mean(picture: ndarray, known: ndarray, otherwise: ndarray) -> ndarray:
    """(3,) mean radiance of the first plane near the object; `otherwise` if unknown."""
    edge = picture.shape[1] // _FAR_SHARE
    weight = known[0, edge:-edge, edge:-edge]
    if not weight.any():
        return otherwise
    near = picture[0, edge:-edge, edge:-edge]
    return np.asarray(np.tensordot(weight, near, 2) / weight.sum())
