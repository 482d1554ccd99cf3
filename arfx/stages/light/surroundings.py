"""Which surroundings a frame's object mirrors: the best that is known of them, as an `Environment`.

Three parts add up: what the clip saw (or the panorama that was given), the plane's own
colour below its horizon, and a guess of the rest. Each is filtered once, and a frame weighs
them: as bright as its light, and by how much of what was seen lies between two maps in
time. What is missing of the light on the plane comes from lamps that the clip never saw: a
rough surface sees their mean, a mirror looks through between them, so the guess has two
brightnesses.
Cost: some 50 ms for a map, once; O(texels) a frame. Lamps of the light are no part of the
surroundings: a map has none.
Source: docs/methods/gi.md#environment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.cube import (
    CubeMap,
    SeenEnvironment,
    face_directions,
    resampled,
    solid_angles,
    spread,
)
from arfx.core.facts import FrameFacts
from arfx.core.light import Light, harmonics
from arfx.core.memo import memo_of
from arfx.core.numerics import divide, smoothstep
from arfx.core.scene import Scene
from arfx.errors import RenderError
from arfx.stages.light.environment import (
    ROUGHNESSES,
    SIDES,
    Environment,
    environment_of,
    level_slices,
    prefiltered,
)

SOFT_DEG = (
    25.0  # over the plane's horizon, in which its colour goes over to the guess
)
_GUESS_PX = 16  # texels of a guess's face while it is smoothed
_LEAST_SKY = (
    0.3  # share of the plane's light that comes from what was not seen, at least
)
_LEAST_COLOUR = 1e-3  # of the brightest, that a guess has everywhere of each colour
_MOST = 1e3  # times as bright as it was found
_UP_STEP = 1 / 16  # of the plane's normal where it turns in a cube's axes
# half-angles of lobes: a mirror's, a matt surface's
_NARROW_RAD, _WIDE_RAD = np.radians(6.0), np.radians(30.0)
_KEPT = 8  # maps, 1.3 MB each
_SHAPE_STEPS = 64  # of a harmonic over the first


class SurroundingParts(NamedTuple):
    """seen, plane and guess, in this order, each radiance of one scale: seen as a share of
    the light, the plane's as 1.

    texels (n, 9) : `prefiltered`, side by side;  arriving, mean (3, 3) : on the plane, over the
    sphere
    guess_where_seen (3,) : mean of the guess times how well the place is known
    whole : all is known, only its scale is not"""

    texels: ndarray
    arriving: ndarray
    mean: ndarray
    guess_where_seen: ndarray
    whole: bool

    def towards(self, other: SurroundingParts, share: float) -> SurroundingParts:
        """The mixture with `share` of the other."""
        a, b = np.float32(1 - share), np.float32(share)
        mixed = {
            name: a * getattr(self, name) + b * getattr(other, name)
            for name in self._fields[:-1]
        }
        return SurroundingParts(**mixed, whole=self.whole and other.whole)


@dataclass(frozen=True, eq=False)
class FrameSurroundings:
    """What is known of the surroundings in one frame.

    narrow, wide (3, 3) : factors of the parts for a mirror, and for a surface that sees far around
    axes (3, 3) : rotation to the cubes' axes from the world's"""

    parts: SurroundingParts
    narrow: ndarray
    wide: ndarray
    axes: ndarray

    def environment(self) -> Environment:
        """Filtered, as surfaces of any roughness mirror it: the sum of the parts, each level
        between the two brightnesses.
        """
        share = lobe_width(np.array(ROUGHNESSES))[:, None, None]
        factors = (1 - share) * self.narrow + share * self.wide
        levels = map(self._level, level_slices(), factors)
        return environment_of(np.concatenate(list(levels)), self.axes)

    def cube(self, factors: ndarray) -> ndarray:
        """(6, n, n, 3) radiance of the parts by `narrow` or `wide`; not filtered."""
        side = SIDES[0] + 2
        finest = self._level(level_slices()[0], factors).reshape(6, side, side, 3)
        return finest[:, 1:-1, 1:-1]

    def cubes(self) -> tuple[ndarray, ndarray]:
        """As a mirror sees them, and as a matt surface does."""
        return self.cube(self.narrow), self.cube(self.wide)

    def _level(self, rows: slice, factors: ndarray) -> ndarray:
        """(n, 3) sums of the parts in rows of the texels."""
        weights = (factors[..., None] * np.eye(3)).reshape(9, 3)
        return np.asarray(self.parts.texels[rows] @ weights.astype(np.float32))


def lobe_width(roughness: ndarray | float) -> ndarray:
    """How wide a GGX lobe sees the surroundings, by the cone that blurs as it does
    (`gi.gloss.mirror_tangent`): 0 as a mirror, 1 as a matt surface."""
    half_angle = np.sqrt(8) * np.arctan(np.asarray(roughness) ** 2)
    share = (half_angle - _NARROW_RAD) / (_WIDE_RAD - _NARROW_RAD)
    return np.clip(share, 0, 1)


def frame_environment(facts: FrameFacts, scene: Scene, light: Light) -> Environment:
    """What the frame's object mirrors. As `frame_surroundings`."""
    return frame_surroundings(facts, scene, light).environment()


def frame_surroundings(
    facts: FrameFacts, scene: Scene, light: Light
) -> FrameSurroundings:
    """The best that is known around the frame's object. What is filtered is kept with the
    scene, for all stages.

    Raises RenderError for radiance that is not finite and >= 0, and for a map that is missing.
    """
    seen, guess = facts.seen_environment, facts.environment
    plane = None if guess is None else guess.plane_rgb
    up = scene.world_from_anchor.rotation[:, 2]
    axes = _axes(seen if seen is not None else guess)
    cube_up = (
        up
        if np.array_equal(axes, np.eye(3))
        else np.round(axes @ up / _UP_STEP) * _UP_STEP
    )

    own = (
        _soft_shape(light).tobytes()
        if guess is None
        else (guess.data, guess.size, plane is None)
    )

    memo = memo_of(scene)

    def kept(name: str | None) -> SurroundingParts:
        def make() -> SurroundingParts:
            rgba = None if name is None else seen_map(name, scene)
            cube = memo.get(own, partial(_guess_of, guess, light), "guess", _KEPT)
            return parts_of(rgba, cube, cube_up, plane is not None)

        key = name, own, cube_up.tobytes()
        found: SurroundingParts = memo.get(key, make, "surroundings", _KEPT)
        return found

    mixed = kept(None if seen is None else seen.maps[0])
    if seen is not None and seen.share > 0:
        mixed = mixed.towards(kept(seen.maps[1]), seen.share)
    plane_rgb = _radiance(np.zeros(3) if plane is None else np.array(plane))
    narrow, wide = brightness(mixed, light, light.soft_radiance(up), plane_rgb)
    return FrameSurroundings(mixed, narrow, wide, axes)


def parts_of(
    seen: ndarray | None, guess: ndarray, up: ndarray, plane_known: bool
) -> SurroundingParts:
    """seen : (6, n, n, 4) radiance times the fourth, how well it is known, or None;  guess
    : (6, n, n, 3)
    up : (3,) the plane's normal, axes of the cubes;  plane_known : its colour is, so that
    the guess ends at its horizon
    """
    size = guess.shape[1]
    rgba = np.zeros((6, size, size, 4), np.float32) if seen is None else seen
    known = rgba[..., 3:]
    above = above_horizon(size, up) if plane_known else np.ones((6, size, size, 1))
    cubes = (
        rgba[..., :3],
        (1 - known) * (1 - above) * np.ones(3),
        (1 - known) * above * guess,
    )
    facing = np.clip(face_directions(size) @ up, 0, None) * solid_angles(size)
    facing /= facing.sum()
    solid = np.tile(solid_angles(size) / (4 * np.pi), (6, 1, 1))
    return SurroundingParts(
        np.concatenate([prefiltered(cube) for cube in cubes], 1),
        np.stack([np.tensordot(facing, cube, 3) for cube in cubes]),
        np.stack([np.tensordot(solid, cube, 3) for cube in cubes]),
        np.tensordot(solid, known * guess, 3),
        bool(known.min() >= 1),
    )


def brightness(
    parts: SurroundingParts, light: Light, want: ndarray, plane_rgb: ndarray
) -> tuple[ndarray, ndarray]:
    """(narrow, wide), (3, 3) each: factors of the parts for a mirror, and for a surface
    that sees far around.

    want : (3,) radiance of a white surface on the plane under the light without its lamps;
    plane_rgb : (3,)
    """
    want, scale = _radiance(want), _radiance(light.mean_radiance)
    shown = scale * parts.arriving[0] + plane_rgb * parts.arriving[1]
    missing = divide(np.maximum(want - shown, _LEAST_SKY * want), parts.arriving[2])
    missing = np.minimum(missing, _MOST)
    factor = divide(want, shown + missing * parts.arriving[2])
    wide = np.minimum(factor, _MOST) * np.stack([scale, plane_rgb, missing])
    if parts.whole or not parts.guess_where_seen.any():
        return wide, wide
    as_seen = divide(scale * parts.mean[0], parts.guess_where_seen)
    return np.stack([scale, plane_rgb, as_seen]), wide


def _radiance(values: ndarray) -> ndarray:
    """What of them is radiance: not what is below 0 or not finite."""
    return np.where(np.isfinite(values), np.clip(values, 0, None), 0)


def seen_map(name: str, scene: Scene) -> ndarray:
    """(6, n, n, 4) float32 of the scene's maps.

    Raises RenderError where it is missing or holds no radiance.
    """
    if name not in scene.environment_maps:
        raise RenderError(
            f"facts: environment map {name} is not among the job's",
            "analyse the clip again",
        )
    rgba = np.asarray(scene.environment_maps[name], np.float32)
    return resampled(_checked(rgba, "an environment map"), SIDES[0])


def _checked(radiance: ndarray, name: str) -> ndarray:
    if not np.isfinite(radiance).all() or (radiance < 0).any():
        raise RenderError(f"facts: {name} holds values that are not finite and >= 0")
    return radiance


def checked_faces(environment: CubeMap) -> ndarray:
    """(6, n, n, 3) float64, its own axes.

    Raises RenderError for values that are not finite and >= 0.
    """
    return _checked(environment.faces().astype(float), "the environment")


def above_horizon(size: int, up: ndarray) -> ndarray:
    """(6, size, size, 1) from 0 at the plane's horizon to 1 from SOFT_DEG on."""
    return smoothstep((face_directions(size) @ up) / np.sin(np.radians(SOFT_DEG)))[
        ..., None
    ]


def _axes(found: SeenEnvironment | CubeMap | None) -> ndarray:
    """(3, 3) rotation to the axes of what was found from the world's."""
    if found is None or found.axes is None:
        return np.eye(3)
    return np.array(found.axes, float).reshape(3, 3)


def _soft_shape(light: Light) -> ndarray:
    """(9, 3) harmonics of the light's soft part over their first, in steps: the same for
    all brightnesses.
    """
    shape = np.zeros((9, 3))
    if light.soft:
        soft = np.asarray(light.soft, float)
        shape = np.round(divide(soft, soft[0]) * _SHAPE_STEPS) / _SHAPE_STEPS
    shape[0] = 1
    return shape


def _guess_of(environment: CubeMap | None, light: Light) -> ndarray:
    """(6, n, n, 3) float32, of every colour everywhere; what the light's soft part comes
    from where there is no guess.
    """
    if environment is None:
        cube = _from_light(light)
    else:
        cube = resampled(checked_faces(environment), _GUESS_PX)
        cube = spread(cube, 90 / environment.size / 2)
    most = float(cube.max())
    cube = np.maximum(cube, _LEAST_COLOUR * most) if most > 0 else np.ones_like(cube)
    return resampled(cube.astype(np.float32), SIDES[0])


def _from_light(light: Light) -> ndarray:
    """(6, n, n, 3), about what gives the light's soft radiance, but for its scale."""
    # a cosine lobe leaves 2/3 and 1/4 of degrees 1 and 2; the latter is given back by half
    # only, as it rings
    gain = np.repeat([1.0, 1.5, 2.0], [1, 3, 5])[:, None]
    return np.clip(
        harmonics(face_directions(_GUESS_PX)) @ (_soft_shape(light) * gain), 0, None
    )
