"""Display orientation: how coded pixels lie when the clip is shown upright."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.core.rect import Rect

# (transpose, flip_x, flip_y) by degrees counter-clockwise, without a mirror
_DEGREES = {(False, False, False): 0, (True, False, True): 90, (False, True, True): 180, (True, True, False): 270}


@dataclass(frozen=True)
class Orientation:
    """upright = flips of (the transpose of) coded. All eight orientations of a rectangle."""

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @property
    def rotation_deg(self) -> int:
        """Counter-clockwise rotation from coded to upright, 0, 90, 180 or 270; of a mirrored one, that before the mirror."""
        key = (self.transpose, self.flip_x, self.flip_y)
        return _DEGREES.get(key, _DEGREES.get((self.transpose, not self.flip_x, self.flip_y), 0))

    @property
    def mirrored(self) -> bool:
        return (self.transpose, self.flip_x, self.flip_y) not in _DEGREES

    def upright(self, coded: np.ndarray) -> np.ndarray:
        """View of coded (h, w, ...) as it is shown."""
        v = coded.swapaxes(0, 1) if self.transpose else coded
        return v[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]

    def coded(self, upright: np.ndarray) -> np.ndarray:
        """The inverse of `upright`, also a view."""
        v = upright[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]
        return v.swapaxes(0, 1) if self.transpose else v

    def coded_rect(self, rect: Rect, width: int, height: int) -> Rect:
        """Where an upright rectangle lies among the coded pixels. width, height : of the upright picture, px."""
        x0, x1 = (width - rect.x1, width - rect.x0) if self.flip_x else (rect.x0, rect.x1)
        y0, y1 = (height - rect.y1, height - rect.y0) if self.flip_y else (rect.y0, rect.y1)
        return Rect(y0, x0, y1, x1) if self.transpose else Rect(x0, y0, x1, y1)


def orientation_of(matrix: Sequence[int] | None) -> tuple[Orientation, bool]:
    """Orientation of an FFmpeg display matrix (9 integers), and whether it is one exactly.

    x' = a x + c y, y' = b x + d y with a, b, c, d at 0, 1, 3, 4 (FFmpeg libavutil/display.h). A turn that is no
    multiple of 90 degrees is taken to the nearest one.
    """
    if matrix is None:
        return Orientation(), True
    a, b, c, d = (float(matrix[i]) for i in (0, 1, 3, 4))
    straight, turned = abs(a) + abs(d), abs(b) + abs(c)
    if straight == 0 and turned == 0:
        return Orientation(), False
    if straight >= turned:
        return Orientation(False, a < 0, d < 0), turned < 1e-3 * straight
    return Orientation(True, c < 0, b < 0), straight < 1e-3 * turned


def matrix_from_side_data(data: bytes) -> tuple[int, ...]:
    """Nine int32 in the machine's byte order, as FFmpeg stores a display matrix."""
    return struct.unpack("=9i", data[:36])
