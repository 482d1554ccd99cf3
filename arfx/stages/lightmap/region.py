"""Where on the plane the shadow shows: points around it, for the rectangle of a frame. Found without the picture.

A darkening shows when it takes more than `faint` of the plane's light. Ambient light: a coarse map of the plane, made
once per clip with rays. Directional lights: the hull of the object, cast from the rim of the light's disc."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from arfx.core.memo import memo_of
from arfx.core.scene import Scene
from arfx.stages.lightmap.beams import Beam, disc_directions
from arfx.stages.lightmap.caster import Caster, make_caster
from arfx.stages.lightmap.plane import PlaneLevel, SoftPicture, ambient_picture, soft_picture
from arfx.stages.lightmap.self_occlusion import OcclusionGrid, OcclusionLevel, occlusion_grid
from arfx.stages.triangles import Triangles

_TEXELS, _RAYS = 64, 400
_BORDER = 2.5  # heights around the footprint: a wall as high takes (1 / 2.5)^2 / 4 = 4 % of the hemisphere, an object less
_FRACTION_STEPS = 32  # outlines are kept for shares of the light in steps of 1 / 32, rounded up
SHAPED = (
    2.0  # times what it takes of even light that an object takes of light from one side, at most
)
_PLACEMENTS = 4  # of one model, whose regions are kept
_SIDES = 4  # points a side of an outline: a lens bends it


class ShadowRegion:
    """The plane around one scene's object. caster, rays : the object;  centre_m, half_m (2,) : the map's box
    soft_picture : of it;  hidden : of even light"""

    def __init__(self, scene: Scene) -> None:
        self.caster: Caster = make_caster(scene)
        self.rays = Triangles(self.caster.vertices[self.caster.faces])
        footprint = self.caster.outline[:, :2]
        border = max(_BORDER * self.caster.height_m, 1e-3 * self.caster.extent_m)
        low, high = footprint.min(0) - border, footprint.max(0) + border
        self.centre_m, self.half_m = (low + high) / 2, (high - low) / 2
        self.soft_picture = soft_picture(
            self.caster, self.rays, self.centre_m, self.half_m, _TEXELS, _RAYS
        )
        self.hidden = self.soft_picture.hidden[0]
        self.ambient_outline_m = lru_cache(maxsize=64)(self._ambient_outline_m)
        self.beam_outline_m = lru_cache(maxsize=256)(self._beam_outline_m)
        self._whole_outline_m = lru_cache(maxsize=256)(self._joined)
        self.ambient_picture = lru_cache(maxsize=4)(self._ambient_picture)
        self.occlusion_grid = lru_cache(maxsize=4)(self._occlusion_grid)

    def outline_m(
        self, ambient_fraction: float, beams: list[tuple[Beam, float]], faint: float
    ) -> np.ndarray:
        """(k, 2) metres: points around the shadow; none where nothing shows.

        ambient_fraction, and beside each beam its fraction : of the plane's light, 0..1"""
        shown = tuple(
            beam for beam, fraction in beams if fraction > faint and beam.direction[2] > 0
        )
        return self._whole_outline_m(int(np.ceil(ambient_fraction * _FRACTION_STEPS)), shown, faint)

    def _joined(self, fraction: int, beams: tuple[Beam, ...], faint: float) -> np.ndarray:
        points = np.concatenate(
            [self.ambient_outline_m(fraction, faint), *(self.beam_outline_m(b) for b in beams)]
        )
        return _subdivided(_hull(points)) if len(points) else points

    def _occlusion_grid(self, level: OcclusionLevel) -> OcclusionGrid:
        return occlusion_grid(self.caster, self.rays, self.soft_picture, level)

    def _ambient_picture(self, faint: float, level: PlaneLevel) -> SoftPicture:
        """What the object takes of the soft light, where that can be more than `faint` whatever its shape."""
        points, centre, half = (
            self.ambient_outline_m(int(SHAPED * _FRACTION_STEPS), faint),
            self.centre_m,
            self.half_m,
        )
        if len(points):
            low, high = points.min(0), points.max(0)
            centre, half = (low + high) / 2, (high - low) / 2
        return ambient_picture(self.caster, self.rays, centre, half, level)

    def _ambient_outline_m(self, fraction: int, faint: float) -> np.ndarray:
        dark = np.argwhere(self.hidden * fraction / _FRACTION_STEPS > faint)[:, ::-1]
        if not len(dark):
            return np.zeros((0, 2))
        # a texel and its neighbours: the coarse map may miss the border by one
        grown = _hull(
            (dark[:, None] + np.array([[-1, -1], [2, -1], [2, 2], [-1, 2]]))
            .reshape(-1, 2)
            .astype(float)
        )
        return self.centre_m + self.half_m * (grown / _TEXELS * 2 - 1)

    def _beam_outline_m(self, beam: Beam) -> np.ndarray:
        angle = np.arange(12) * np.pi / 6
        d = disc_directions(
            beam,
            np.concatenate(
                [np.zeros((1, 2)), 1.04 * np.column_stack([np.cos(angle), np.sin(angle)])]
            ),
        )
        p = self.caster.outline
        return _hull(
            (p[None, :, :2] - (d[:, :2] / d[:, 2:])[:, None] * p[None, :, 2:]).reshape(-1, 2)
        )


def shadow_region(scene: Scene) -> ShadowRegion:
    region: ShadowRegion = memo_of(scene.model).get(
        scene.placed_by, lambda: ShadowRegion(scene), "shadow region", _PLACEMENTS
    )
    return region


def _hull(points: np.ndarray) -> np.ndarray:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # a point, or a line
        low, high = points.min(0), points.max(0)
        return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _subdivided(hull: np.ndarray) -> np.ndarray:
    t = np.linspace(0, 1, _SIDES + 1)[:-1, None, None]
    return (hull * (1 - t) + np.roll(hull, -1, 0) * t).reshape(-1, 2)
