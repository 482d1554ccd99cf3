"""Where on the plane the shadow shows: points around it, for the rectangle of a frame.
Found without the picture.

The soft light: a coarse picture of the plane. Lamps: the hull of the object, cast from the
rim of the lamp's disc."""

from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.memo import memo_of
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.light.beams import Beam, FrameLight, rim_directions
from arfx.stages.light.caster import Caster, make_caster
from arfx.stages.light.plane_lookup import PlaneTexture
from arfx.stages.light.plane_shadow import (
    PlaneLevel,
    soft_picture,
    soft_pictures,
)
from arfx.stages.light.surfels import ObjectRays
from arfx.stages.viewing import seen_rect

_TEXELS, _SKY = 96, 256
# Heights around the footprint: a wall as high takes (1 / 2.5)^2 / 4 = 4 % of the
# hemisphere, an object less.
_BORDER = 2.5
# times what it takes of even light that an object takes of light from one side, at most
UNEVEN = 2.0
_PLACEMENTS = 4  # of one model, whose regions are kept
_SIDES = 4  # points a side of an outline: a lens bends it
_RIM = 1.04  # of a lamp's disc, as seen by the corners of a hull of twelve


class ShadowRegion:
    """The plane around one scene's object.

    caster, rays : the object;  soft : coarse picture of the plane around it
    """

    def __init__(self, scene: Scene) -> None:
        self.caster: Caster = make_caster(scene)
        self.rays = ObjectRays(scene)
        footprint = self.caster.outline[:, :2]
        border = max(_BORDER * self.caster.height_m, 1e-3 * self.caster.extent_m)
        low, high = footprint.min(0) - border, footprint.max(0) + border
        self.soft = soft_picture(self.caster, low, high, _TEXELS**2, _SKY)
        self.outline_m = lru_cache(maxsize=256)(self._outline_m)
        self.soft_pictures = lru_cache(maxsize=2)(self._soft_pictures)

    @property
    def hidden(self) -> float:
        """The most that the object hides of the plane's hemisphere, 0..1."""
        return float(self.soft.dark[0].max())

    def _soft_pictures(
        self, level: PlaneLevel, least: float
    ) -> tuple[PlaneTexture, ...]:
        """What the object takes of the soft light, where that can be more than `least`
        whatever its shape.
        """
        points = self._soft_outline_m(least / UNEVEN)
        if not len(points):
            return ()
        return soft_pictures(self.caster, points.min(0), points.max(0), level)

    def _outline_m(self, least_hidden: float, beams: tuple[Beam, ...]) -> ndarray:
        """(k, 2) metres: points around the shadow; none where nothing shows.

        least_hidden : share of the soft light that has to be hidden to show;  beams : lamps
        whose shadow shows
        """
        parts = [
            self._soft_outline_m(least_hidden),
            *map(self._beam_outline_m, beams),
        ]
        points = np.concatenate(parts)
        return _subdivided(_hull(points)) if len(points) else points

    def _soft_outline_m(self, least_hidden: float) -> ndarray:
        dark = np.argwhere(self.soft.dark[0] > least_hidden)[:, ::-1]
        if not len(dark):
            return np.zeros((0, 2))
        # a texel and its neighbours: the coarse picture may miss the border by one
        around = dark[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        matrix = self.soft.texel_from_m
        texels = _hull(around.reshape(-1, 2).astype(float))
        return (texels - matrix[:, 2]) / np.diag(matrix[:, :2])

    def _beam_outline_m(self, beam: Beam) -> ndarray:
        return _hull(self.caster.cast(rim_directions(beam, 12, _RIM)))


def shadow_region(scene: Scene) -> ShadowRegion:
    region: ShadowRegion = memo_of(scene.model).get(
        scene.placed_by, lambda: ShadowRegion(scene), "shadow region", _PLACEMENTS
    )
    return region


def plane_rect(points_m: ndarray, facts: FrameFacts, scene: Scene) -> Rect:
    """Pixels that hold points (n, 2) of the anchor's plane; the whole frame where some are
    not before the camera.
    """
    points = np.column_stack([points_m, np.zeros(len(points_m))])
    return seen_rect(
        scene.camera, facts.pose.apply(scene.world_from_anchor.apply(points)), 1.0
    )


def darkest(light: FrameLight, scene: Scene) -> float:
    """The largest share of the plane's light, 0..1, that the object can take: every
    directional light, and of the ambient one what it hides where it hides most."""
    hidden = min(shadow_region(scene).hidden * unevenness(light), 1.0)
    return float(
        (light.ambient_fraction * hidden + light.direct_fractions.sum(0)).max()
    )


def unevenness(light: FrameLight) -> float:
    """How many times as bright as its mean over the plane's hemisphere the soft light is at
    most, as far as pictures hold it.
    """
    return min(
        (1 + float(np.linalg.norm(light.shape))) / (1 + 2 / 3 * light.shape[2]),
        UNEVEN,
    )


def _hull(points: ndarray) -> ndarray:
    """(k, 2) corners of the convex hull of points (n, 2)."""
    return cv2.convexHull(points.astype(np.float32))[:, 0].astype(float)


def _subdivided(hull: ndarray) -> ndarray:
    t = np.linspace(0, 1, _SIDES + 1)[:-1, None, None]
    return (hull * (1 - t) + np.roll(hull, -1, 0) * t).reshape(-1, 2)
