"""How borders of cells stray: a displacement of pixels that goes with the things, to a quarter of
a pixel.

A tile of smooth noise repeats over the picture and is moved as a whole: with the background by its
median motion, on the object with its origin. Whole pixels would not do: the noise is so steep that
borders would tremble by a ninth of a pixel (rms). The tile is made at each place between pixels
when it is first asked for. Cost: some 5 ms each, once.
Leaves out: how the picture turns or grows; the noise does neither."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor

import numpy as np

from arfx.core.camera import Camera
from arfx.core.memo import Memo
from arfx.core.pose import Pose
from arfx.stages.watercolor.labels import STILL, Wobble, make_wobble
from arfx.stages.watercolor.pigment import wobble_tile
from arfx.stages.watercolor.sites import GRID_PX, Place, SiteField

PARTS = 4  # of a pixel
_FAR_PX = 1e6


@dataclass(frozen=True, eq=False)
class Wobbles:
    """amplitude_px : how far a border strays, px of the picture, 0 = not at all"""

    seed: int
    amplitude_px: float
    _memo: Memo = field(default_factory=Memo)

    def at(self, x_px: float, y_px: float, place: Place = (0.0, 0.0)) -> Wobble:
        """Moved so that pixel (0, 0) of the frame has what lies at (x_px, y_px).

        place : of the pixels that ask"""
        if not self.amplitude_px > 0:
            return STILL
        x = round(x_px * PARTS) / PARTS + place[0]
        y = round(y_px * PARTS) / PARTS + place[1]
        between = x % 1, y % 1
        wobble: Wobble = self._memo.get(between, lambda: self._make(between), most=64)
        return wobble._replace(x=floor(x), y=floor(y))

    def _make(self, between: Place) -> Wobble:
        wavelength_px = 4 * self.amplitude_px + 6
        return make_wobble(
            wobble_tile(self.seed, self.amplitude_px, wavelength_px, between)
        )

    def of_field(self, where: SiteField, place: Place = (0.0, 0.0)) -> Wobble:
        """Moved with what is painted."""
        rows, columns = where.u.shape
        x = where.x0 + GRID_PX * np.arange(columns)
        y = where.y0 + GRID_PX * np.arange(rows)[:, None]
        return self.at(
            float(np.median(where.u - x)), float(np.median(where.v - y)), place
        )

    def of_object(
        self,
        camera: Camera,
        camera_from_world: Pose,
        origin_m: np.ndarray,
        place: Place = (0.0, 0.0),
    ) -> Wobble:
        """Moved with the object. origin_m (3,) WORLD"""
        x, y = camera.project(camera_from_world.apply(origin_m[None]))[0]
        if not (abs(x) < _FAR_PX and abs(y) < _FAR_PX):  # not in front of the camera
            x, y = 0.0, 0.0
        return self.at(-x, -y, place)
