"""How borders of cells stray: a displacement of pixels that goes with the things, to a quarter of
a pixel.

A tile of smooth noise repeats over the picture and is moved as a whole: with the background by its
median motion, on the object with its origin. Whole pixels would not do: the noise is so steep that
borders would tremble by a ninth of a pixel (rms). The tile is made at each place between pixels
when it is first asked for. Cost: some 5 ms each, once.
Leaves out: how the picture turns or grows; the noise does neither."""

from dataclasses import dataclass, field
from math import floor

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.memo import Memo
from arfx.core.pose import Pose
from arfx.stages.watercolor.labels import STILL, Wobble, make_wobble
from arfx.stages.watercolor.pigment import wobble_tile
from arfx.stages.watercolor.sites import Place, SiteField

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

        def make() -> Wobble:
            return make_wobble(wobble_tile(self.seed, self.amplitude_px, between))

        wobble: Wobble = self._memo.get(between, make, most=64)
        return wobble._replace(x=floor(x), y=floor(y))


def field_shift(where: SiteField) -> tuple[float, float]:
    """(x, y) px at which what is painted lies that pixel (0, 0) shows, or would."""
    x, y = where.nodes()
    return float(np.median(where.u - x)), float(np.median(where.v - y))


def object_shift(
    camera: Camera, camera_from_world: Pose, origin_m: ndarray
) -> tuple[float, float]:
    """(x, y) px of pixel (0, 0) from the object's origin (3,), WORLD."""
    x, y = camera.project(camera_from_world.apply(origin_m[None]))[0]
    if not (abs(x) < _FAR_PX and abs(y) < _FAR_PX):  # not in front of the camera
        return 0.0, 0.0
    return -x, -y
