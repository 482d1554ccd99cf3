"""Which blur radius is spread at which resolution.

Level k works on cells of 2^k x 2^k px: a large disc costs there what a small one costs at full resolution. Between two
levels a pixel's light is shared, so that nothing pops when its radius changes. Averaging over a cell and interpolating back
blur too; the disc of a level is made smaller by just that variance. A highlight far above white shows the disc itself: it
is spread one level finer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHARP_PX = 0.5  # a disc of this radius lies within its own pixel
MAX_LEVELS = 7
ALIGN_PX = 1 << (MAX_LEVELS - 1)  # cells of every level begin at multiples of this


@dataclass(frozen=True, eq=False)
class Pyramid:
    """fade : (n - 1, 2) float32, radius in px at which level k begins to hand over to k + 1, and at which it has done so
    filter_px2 : (n,) float32, to be taken from a squared radius, px, for what the level's own cells blur
    slanted : the discs of a plane that is seen at a slant are moved to where its light goes (`surfaces.move_light`)"""

    fade: np.ndarray
    filter_px2: np.ndarray
    slanted: bool

    def levels(self, largest_px: float) -> int:
        """How many levels discs up to this radius use, >= 1."""
        return 1 + int((self.fade[:, 0] < largest_px).sum())

    def max_radius_px(self, level: int, largest_px: float) -> float:
        """Largest radius, px, that a level spreads: highlights stay one level below the others, but for level 0."""
        last = self.levels(largest_px) - 1
        source = level + 1 if level > 0 else level
        return largest_px if source >= last else min(largest_px, float(self.fade[source, 1]))

    def table_px(self, largest_px: float) -> int:
        """Largest radius in cells of any used level, rounded up to a power of two: the size of the shape table."""
        radii = [self.max_radius_px(k, largest_px) / 2**k for k in range(self.levels(largest_px))]
        return 1 << max(int(np.ceil(np.log2(max(*radii, 1.0) + 1.0))), 2)


def _filter_px2(level: int) -> float:
    """Variance of the disc is r^2 / 4 a axis. A cell of s px adds (s^2 - 1) / 12 by averaging, (s^2 - 1) / 12 by the area
    of the target cells, and s^2 t (1 - t), averaged over the positions t in a cell, by interpolation."""
    s = 2**level
    if s == 1:
        return 0.0
    t = (np.arange(s) + 0.5) / s
    return float(4 * (2 * (s * s - 1) / 12 + s * s * (t * (1 - t)).mean()))


def _pyramid(*fade: tuple[float, float], slanted: bool = False) -> Pyramid:
    ranges = list(fade)
    while len(ranges) < MAX_LEVELS - 1:
        ranges.append((ranges[-1][0] * 2, ranges[-1][1] * 2))
    filter_px2 = np.array([_filter_px2(k) for k in range(MAX_LEVELS)], np.float32)
    return Pyramid(np.array(ranges, np.float32), filter_px2, slanted)


PYRAMIDS = {
    "standard": _pyramid((1.6, 2.1), (6.5, 8.5), (18.0, 23.5)),
    "high": _pyramid((28.0, 36.0), (80.0, 104.0), (160.0, 208.0), slanted=True),
}
