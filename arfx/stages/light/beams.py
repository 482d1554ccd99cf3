"""The light of one frame as the shadows need it: directions in the plane's axes, sizes, and
each part's share of the plane.

Directions and sizes are quantised, finely, for shadows only: they are the keys by which
shadows are cached."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.light import DIFFUSE, Light, triple
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose

# Step of a direction, radians. The tip of the shadow of an object 300 px high, under a
# light 30 degrees high, moves by 300 / sin(30 deg)^2 x QUANTUM = 0.4 px.
QUANTUM = np.radians(0.02)
SIZE_STEP_DEG = 0.1
SHAPE_STEP = 1 / 128
SMALLEST_DEG, LARGEST_DEG = 0.5, 90.0
# No shadow is longer than this many heights of its object: lower lights cast it as if they
# stood 4.8 degrees high.
REACH = 12.0


@dataclass(frozen=True)
class Beam:
    """A directional light, rounded: equal beams cast equal shadows. direction : unit,
    anchor axes;  size_deg : full angle
    """

    direction: tuple[float, float, float]
    size_deg: float


@dataclass(frozen=True, eq=False)
class FrameLight:
    """towards (l, 3) unit, WORLD frame; rgb (l, 3) : on a facing surface; on_object (l,)
    share of the disc over the horizon
    beams : the same lights, rounded, anchor axes
    soft (9, 3) harmonics or empty; ambient (3,)
    shape (3,) : the soft light's radiance is 1 + shape . d times its mean, anchor axes;
    rounded, no longer than 1 plane_ambient (3,), plane_direct (l, 3) : radiance of the
    white plane from each part, nothing in the way"""

    towards: ndarray
    rgb: ndarray
    on_object: ndarray
    sizes_deg: ndarray
    beams: tuple[Beam, ...]
    soft: ndarray
    ambient: ndarray
    shape: tuple[float, float, float]
    plane_ambient: ndarray
    plane_direct: ndarray

    @property
    def ambient_fraction(self) -> ndarray:
        """(3,) of the plane's light that is ambient; 0 where there is no light."""
        return divide(
            self.plane_ambient, self.plane_ambient + self.plane_direct.sum(0)
        )

    @property
    def direct_fractions(self) -> ndarray:
        """(l, 3) of the plane's light that each directional light gives."""
        return divide(
            self.plane_direct, self.plane_ambient + self.plane_direct.sum(0)
        )


def frame_light(
    light: Light, world_from_anchor: Pose, hard: bool, plane_blocks: bool
) -> FrameLight:
    """hard : lights without size;  plane_blocks : what is behind the plane does not light
    the object.

    Lights without a direction or without finite colour are left out; negative colour counts
    as none, a size that is not finite as the smallest."""
    t = np.array([li.unit for li in light.lights]).reshape(-1, 3)
    c = np.clip(
        np.array([li.rgb for li in light.lights], float).reshape(-1, 3), 0, None
    )
    sizes_deg = np.array([li.angular_size_deg for li in light.lights], float)
    usable = t.any(1) & np.isfinite(c).all(1) & c.any(1)
    t, c = t[usable], c[usable]
    sizes_deg = np.nan_to_num(sizes_deg[usable], posinf=0)
    s = np.zeros(len(t)) if hard else np.clip(sizes_deg, SMALLEST_DEG, LARGEST_DEG)
    beams = tuple(
        quantised(world_from_anchor.rotation.T @ d, size)
        for d, size in zip(t, s.tolist(), strict=True)
    )
    up = world_from_anchor.rotation[:, 2]
    rise = t @ up
    elevation_deg = np.degrees(np.arcsin(np.clip(rise, -1, 1)))
    seen = (
        np.clip(0.5 + elevation_deg / np.maximum(s, SMALLEST_DEG), 0, 1)
        if plane_blocks
        else np.ones(len(s))
    )
    soft = np.array(light.soft, float).reshape(-1, 3)
    return FrameLight(
        t,
        c,
        seen,
        s,
        beams,
        soft,
        np.asarray(light.ambient_rgb, float),
        _shape(soft, world_from_anchor.rotation),
        np.clip(light.soft_radiance(up), 0, None),
        c * np.clip(rise, 0, None)[:, None],
    )


def _shape(soft: ndarray, world_from_anchor: ndarray) -> tuple[float, float, float]:
    """Of harmonics (9, 3) or none: of all colours together, by their first two degrees."""
    if not len(soft) or not np.isfinite(soft).all():
        return 0.0, 0.0, 0.0
    level = (soft / DIFFUSE[:, None]).mean(1)
    rise = (
        np.sqrt(3) * divide(level[[3, 1, 2]], max(level[0], 0.0)) @ world_from_anchor
    )
    return triple(
        np.round(rise / max(1.0, float(np.linalg.norm(rise))) / SHAPE_STEP)
        * SHAPE_STEP
    )


def quantised(direction: ndarray, size_deg: float) -> Beam:
    """The beam nearest a direction (3,), unit, anchor axes: within QUANTUM of it."""
    d = np.asarray(direction, float)
    steps = np.round(d / QUANTUM)
    # rounded and scaled to a unit again it may round to a neighbour: until it stays, so
    # that equal lights are equal keys
    for _ in range(4):
        d = normalise(steps * QUANTUM)
        again = np.round(d / QUANTUM)
        if (again == steps).all():
            break
        steps = again
    return Beam(triple(d), round(size_deg / SIZE_STEP_DEG) * SIZE_STEP_DEG)


def rim_directions(beam: Beam, count: int, radius: float = 1.0) -> ndarray:
    """(1 + count, 3) `disc_directions` to the middle of the disc, then around it."""
    angles = 2 * np.pi / count * np.arange(count)
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return disc_directions(beam, np.concatenate([np.zeros((1, 2)), rim]))


def disc_directions(beam: Beam, points: ndarray, over_plane: bool = True) -> ndarray:
    """(n, 3) unit directions, anchor axes, to `points` (n, 2) of the light's unit disc.

    The first axis of the disc lies level, the second rises. over_plane : what would lie
    under the horizon is mirrored over it, and no direction is lower than 1 / REACH: a
    shadow has an end."""
    w = np.array(beam.direction)
    level = normalise(np.array([-w[1], w[0], 0.0]))
    if not level.any():
        level = np.array([0.0, 1.0, 0.0])
    rise = np.cross(w, level)
    radius = np.tan(np.radians(beam.size_deg / 2))
    d = normalise(w + radius * (points[:, :1] * level + points[:, 1:] * rise))
    if not over_plane:
        return d
    horizontal = np.linalg.norm(d[:, :2], axis=1)
    d[:, 2] = np.maximum(np.abs(d[:, 2]), horizontal / REACH)
    return normalise(d)
