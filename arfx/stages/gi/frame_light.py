"""One frame's surroundings: the environment, and the picture on the real planes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from arfx.core.cube import CubeMap, SeenEnvironment, face_directions, look_up, resampled, spread
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import divide, smoothstep
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import View
from arfx.errors import RenderError
from arfx.stages.gi.plane_change import measured
from arfx.stages.gi.surroundings import (
    COARSE_PX,
    HALF_ANGLES_DEG,
    Background,
    from_light,
    irradiance,
    octahedral,
)
from arfx.stages.light.planes import Planes, bounding_ball, filled, mip_chain, picture_on_planes

SOFT_DEG = 25.0
_LIGHT_STEP = 0.03
_STEP = 0.05  # the plane's mean brightness is rounded to 5 %: of the planes' change that is 1 %


@dataclass(frozen=True, eq=False)
class IncomingLight:
    """picture (p, side, side, 3) : radiance of the planes, filled where the frame does not show them
    mean (3,) : of it near the object, rounded;  background : as mirrors see it, without the object"""

    picture: np.ndarray
    mean: np.ndarray
    background: Background

    def background_with(self, left: np.ndarray) -> Background:
        """As mirrors see it, the planes darkened and lit by the object. left (p, n, n, 3) : of `Indirect`"""
        side = self.picture.shape[1]
        shares = [cv2.resize(a.astype(np.float32), (side, side)) for a in left]
        picture = (self.picture * np.stack(shares)).astype(np.float32)
        known = np.ones(picture.shape[:3], np.float32)
        textures, mips = mip_chain(picture, known, self.mean)
        return self.background._replace(textures=textures, mips=mips)


def surroundings_of(facts: FrameFacts, scene: Scene, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """(narrow, wide), (6, n, n, 3) radiance each, WORLD axes: what the clip saw of the surroundings, and a guess of the rest.

    In `narrow` the guess is as bright as what was seen. In `wide` it is such that the irradiance on the anchor's plane is that
    of the light without its directional lights: what is missing comes from lamps that the clip never saw, between which a mirror
    looks through. Raises RenderError for radiance that is not finite and >= 0, and for a map that is missing."""
    seen, environment = facts.seen_environment, facts.environment
    if seen is None or environment is None:
        cube, factor = environment_cube(facts, scene, light)
        return cube * factor, cube * factor
    rgba = seen_map(seen, scene)
    n, up = rgba.shape[1], scene.world_from_anchor.rotation[:, 2]
    known, guess = rgba[..., 3:], _smooth(environment, n)
    shown, sky = rgba[..., :3] * light.mean_radiance.astype(np.float32), (1 - known) * guess
    as_seen = divide(shown.mean((0, 1, 2)), (guess - sky).mean((0, 1, 2)), where_zero=1.0).astype(
        np.float32
    )
    if environment.plane_rgb is not None and np.isfinite(environment.plane_rgb).all():
        share = above_horizon(n, up).astype(np.float32)
        shown += (
            (1 - known) * (1 - share) * np.clip(environment.plane_rgb, 0, None).astype(np.float32)
        )
        sky *= share
    want, narrow = light.soft_radiance(up), shown + as_seen * sky
    missing = divide(np.clip(want - irradiance(shown, up), 0, None), irradiance(sky, up))
    wide = shown + missing.astype(np.float32) * sky
    factor = divide(want, irradiance(wide, up), where_zero=-1.0)
    if not (
        (factor >= 0).all() and (factor < 1e3).all()
    ):  # black, or without a colour that the plane shows
        cube, factor = environment_cube(facts, scene, light)
        wide = resampled(cube, n)
    wide = wide * factor.astype(np.float32)
    return narrow if known.min() < 1 else wide, wide  # where all is known, only its scale is not


@lru_cache(maxsize=8)
def _smooth(environment: CubeMap, size: int) -> np.ndarray:
    """(6, size, size, 3) float32 of a guess with few texels, none of which shows."""
    return resampled(
        spread(resampled(checked(environment), COARSE_PX), 90 / environment.size / 2), size
    )


def seen_map(seen: SeenEnvironment, scene: Scene) -> np.ndarray:
    """(6, n, n, 4) of the scene's maps, WORLD axes. Raises RenderError where one is missing."""
    missing = [name for name in seen.maps if name not in scene.environment_maps]
    if missing:
        raise RenderError(
            f"facts: environment map {missing[0]} is not among the job's", "analyse the clip again"
        )
    first, second = (scene.environment_maps[name].astype(np.float32) for name in seen.maps)
    rgba = first + np.float32(seen.share) * (second - first)
    if not np.isfinite(rgba).all() or rgba.min() < 0:
        raise RenderError("facts: an environment map holds values that are not finite and >= 0")
    if seen.axes is None:
        return rgba
    d = face_directions(rgba.shape[1]).reshape(-1, 3)
    return look_up(rgba, d @ np.array(seen.axes).reshape(3, 3).T).reshape(rgba.shape)


def environment_cube(
    facts: FrameFacts, scene: Scene, light: Light
) -> tuple[np.ndarray, np.ndarray]:
    """((6, n, n, 3) radiance, WORLD axes, (3,) factor): the facts' environment, to be multiplied so that its irradiance on the
    anchor's plane is what the light has without its directional lights; the light's own soft part where there is none."""
    seen = facts.environment
    up = scene.world_from_anchor.rotation[:, 2]
    want = light.soft_radiance(up)
    if seen is not None:
        cube = checked(seen)
        softened = (
            None if seen.plane_rgb is None else at_horizon(cube, up, np.array(seen.plane_rgb), want)
        )
        if softened is not None:
            return softened
        factor = divide(want, irradiance(cube, up), where_zero=-1.0)
        # not a black picture, nor one that lacks a colour that the plane shows
        if (factor >= 0).all() and (factor < 1e3).all():
            return cube, factor
    cube = from_light(light)
    return cube, divide(want, irradiance(cube, up))


def at_horizon(
    cube: np.ndarray, up: np.ndarray, colour: np.ndarray, want: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """(cube, factor) of a guessed environment that begins at the plane's horizon with the plane's own radiance.

    A mirror would show a hard ring there, between a picture and a guess; so the lowest SOFT_DEG go over from one to the other,
    and the rest is scaled so that the light on the plane stays. None where that cannot be.
    up (3,), cube : WORLD axes;  colour (3,) of the plane;  want (3,) : radiance of a white surface in the plane"""
    if not np.isfinite(colour).all():
        return None
    sky = above_horizon(cube.shape[1], up)
    colour = np.clip(colour, 0, None)
    remaining = want - irradiance((1 - sky) * np.ones(3), up) * colour
    factor = divide(remaining, irradiance(sky * cube, up))
    if not ((factor > 1e-3) & (factor < 1e3)).all() or not (remaining > 0.3 * want).all():
        return None
    return sky * cube + (1 - sky) * colour / factor, factor


def above_horizon(size: int, up: np.ndarray) -> np.ndarray:
    """(6, size, size, 1) from 0 at the plane's horizon to 1 from SOFT_DEG on."""
    return smoothstep((face_directions(size) @ up) / np.sin(np.radians(SOFT_DEG)))[..., None]


def rounded(light: Light) -> Light:
    """The light in steps too small to show by what bounces, so that it can be kept."""

    def coarse(li: DirectionalLight) -> DirectionalLight:
        rgb, size_deg = triple(_in_steps(li.rgb, _LIGHT_STEP)), round(li.angular_size_deg)
        return replace(
            li, direction=triple(np.round(li.unit, 2)), rgb=rgb, angular_size_deg=size_deg
        )

    soft = np.asarray(light.soft, float).reshape(-1, 3)
    if light.soft:
        soft = (
            np.round(divide(soft, soft[0]) / _LIGHT_STEP)
            * _LIGHT_STEP
            * _in_steps(soft[0], _LIGHT_STEP)
        )
    return replace(
        light,
        ambient_rgb=triple(_in_steps(light.ambient_rgb, _LIGHT_STEP)),
        lights=tuple(map(coarse, light.lights)),
        soft=tuple(map(triple, soft)),
    )


def _in_steps(value: ArrayLike, step: float) -> np.ndarray:
    """The nearest power of e^step; 0 up to 1e-6."""
    a = np.asarray(value, float)
    return np.where(a > 1e-6, np.exp(np.round(np.log(np.maximum(a, 1e-6)) / step) * step), 0.0)


def checked(environment: CubeMap) -> np.ndarray:
    """(6, n, n, 3) float64. Raises RenderError for values that are not finite and >= 0."""
    cube = environment.faces().astype(float)
    if not np.isfinite(cube).all() or (cube < 0).any():
        raise RenderError("facts: the environment holds values that are not finite and >= 0")
    return cube


def incoming_light(view: View, seen: Rect, planes: Planes, positions: np.ndarray) -> IncomingLight:
    """seen : the pixels that may be looked at (the same for every part of the frame that is rendered);  positions : of the
    texels of the picture on the planes"""
    facts, scene, light = view.facts, view.scene, view.light
    picture, known = picture_on_planes(
        view[Layer.PLATE],
        view.rect,
        seen,
        scene.camera,
        view.pose @ scene.world_from_anchor,
        positions,
        planes.axes.astype(float),
        np.array(facts.bias_rgb, np.float32),
        measured(view.layers),
    )
    up = scene.world_from_anchor.rotation[:, 2]
    mean = plane_mean(picture, known, positions, planes, scene, 0.4 * light.radiance(up))
    p = len(planes.axes)
    textures, mips = mip_chain(
        np.zeros((p, 1, 1, 3), np.float32), np.zeros((p, 1, 1), np.float32), mean
    )
    if facts.seen_environment is None:
        cube, factor = environment_cube(facts, scene, light)
        maps = factor.astype(np.float32) * view.memo.of_light.get(
            cube.tobytes(), lambda: octahedral(cube)
        )
    else:  # another in each frame
        maps = octahedral(*surroundings_of(facts, scene, light))
    widths, turn = (
        np.array(HALF_ANGLES_DEG, np.float32),
        scene.world_from_anchor.rotation.astype(np.float32),
    )
    extents = np.column_stack([np.full(p, planes.half_m), planes.bounds]).astype(np.float32)
    background = Background(planes.axes, extents, textures, mips, maps, widths, turn)
    return IncomingLight(filled(picture, known, mean), mean, background)


def plane_mean(
    picture: np.ndarray,
    known: np.ndarray,
    positions: np.ndarray,
    planes: Planes,
    scene: Scene,
    otherwise: np.ndarray,
) -> np.ndarray:
    """(3,) mean radiance of the first plane within three radii of the object, in steps of 5 %; `otherwise` if unknown."""
    radius = bounding_ball(scene)[1]
    step = max(picture.shape[1] // 64, 1)
    near = ((positions[0, ::step, ::step] - planes.axes[0, 0]) ** 2).sum(-1) < (3 * radius) ** 2
    weight = known[0, ::step, ::step] * near
    if not weight.sum() > 0:
        return otherwise
    return _in_steps(
        (picture[0, ::step, ::step] * weight[..., None]).sum((0, 1)) / weight.sum(), _STEP
    )
