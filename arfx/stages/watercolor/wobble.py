"""How borders of cells stray: a displacement of pixels that goes with the things, to a quarter of a pixel.

A tile of smooth noise repeats over the picture and is moved as a whole: with the background by its median motion, on the object
with its origin. Whole pixels would not do: the noise is so steep that borders would tremble by a ninth of a pixel (rms).
The tile is made at each of 4 x 4 positions between pixels when it is first asked for. Cost: some 5 ms each, once; 11 MB together.
Leaves out: how the picture turns or grows; the noise does neither."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from arfx.core.camera import Camera
from arfx.core.memo import Memo
from arfx.core.pose import Pose
from arfx.stages.watercolor.labels import STILL, Wobble, make_wobble
from arfx.stages.watercolor.pigment import wobble_tile
from arfx.stages.watercolor.sites import GRID_PX, SiteField

PARTS = 4  # of a pixel
_FAR_PX = 1e6


@dataclass(frozen=True, eq=False)
class Wobbles:
    """amplitude_px : how far a border strays, px of the picture, 0 = not at all
    every : the wobbles are for a picture that is so many times smaller"""

    seed: int
    amplitude_px: float
    every: int = 1
    _memo: Memo = field(default_factory=Memo)

    def at(self, x_px: float, y_px: float) -> Wobble:
        """Moved so that pixel (0, 0) of the frame has what lies at (x_px, y_px)."""
        if not self.amplitude_px > 0:
            return STILL
        x, y, step = round(x_px * PARTS), round(y_px * PARTS), PARTS * self.every
        between = x % step, y % step
        made: Wobble = self._memo.get(between, lambda: self._make(*between), most=step * step)
        return made.at(x // step, y // step)

    def _make(self, x: int, y: int) -> Wobble:
        """x, y : place of the first pixel, in parts of one of the picture."""
        first = x / PARTS + (self.every - 1) / 2, y / PARTS + (self.every - 1) / 2
        tile = wobble_tile(self.seed, self.amplitude_px, 4 * self.amplitude_px + 6, first)
        return make_wobble(np.rint(tile[:, :: self.every, :: self.every] / self.every))

    def of_field(self, where: SiteField, corner: tuple[int, int] = (0, 0)) -> Wobble:
        """Moved with what is painted. corner : pixel of the frame that the wobble's first is"""
        gh, gw = where.u.shape
        x, y = where.x0 + GRID_PX * np.arange(gw), where.y0 + GRID_PX * np.arange(gh)[:, None]
        return self.at(
            float(np.median(where.u - x)) + corner[0], float(np.median(where.v - y)) + corner[1]
        )

    def of_object(
        self,
        camera: Camera,
        camera_from_world: Pose,
        origin_m: np.ndarray,
        corner: tuple[int, int] = (0, 0),
    ) -> Wobble:
        """Moved with the object. origin_m (3,) WORLD;  corner : as above"""
        x, y = camera.project(camera_from_world.apply(origin_m[None]))[0]
        if not (abs(x) < _FAR_PX and abs(y) < _FAR_PX):  # not in front of the camera
            x, y = 0.0, 0.0
        return self.at(corner[0] - x, corner[1] - y)
