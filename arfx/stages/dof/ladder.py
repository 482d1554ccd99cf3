"""Which blur radius is spread at which resolution.

Rung k works on cells of 2^k x 2^k px: a large disc costs there what a small one costs at full resolution. Between two
rungs a pixel's light is shared, so that nothing pops when its radius changes. Averaging over a cell and interpolating back
blur too; the disc of a rung is made smaller by just that variance. A highlight far above white shows the disc itself: it
is spread one rung finer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHARP_PX = 0.5  # a disc of this radius lies within its own pixel
MOST_RUNGS = 7
ALIGN_PX = 1 << (MOST_RUNGS - 1)  # cells of every rung begin at multiples of this


@dataclass(frozen=True, eq=False)
class Ladder:
    """fade : (n - 1, 2) float32, radius in px at which rung k begins to hand over to k + 1, and at which it has done so
    cut_px2 : (n,) float32, to be taken from a squared radius, px, for what the rung's own cells blur
    """

    fade: np.ndarray
    cut_px2: np.ndarray

    def rungs(self, largest_px: float) -> int:
        """How many rungs discs up to this radius use, >= 1."""
        return 1 + int((self.fade[:, 0] < largest_px).sum())

    def most_px(self, rung: int, largest_px: float) -> float:
        """Largest radius, px, that a rung spreads: highlights stay one rung below the others, but for rung 0."""
        last = self.rungs(largest_px) - 1
        up_to = rung + 1 if rung > 0 else rung
        return largest_px if up_to >= last else min(largest_px, float(self.fade[up_to, 1]))

    def table_px(self, largest_px: float) -> int:
        """Largest radius in cells of any used rung, rounded up to a power of two: the size of the shape table."""
        of = [self.most_px(k, largest_px) / 2**k for k in range(self.rungs(largest_px))]
        return 1 << max(int(np.ceil(np.log2(max(*of, 1.0) + 1.0))), 2)


def _cut_px2(rung: int) -> float:
    """Variance of the disc is r^2 / 4 a axis. A cell of s px adds (s^2 - 1) / 12 by averaging, (s^2 - 1) / 12 by the area
    of the target cells, and s^2 t (1 - t), averaged over the positions t in a cell, by interpolation."""
    s = 2**rung
    if s == 1:
        return 0.0
    t = (np.arange(s) + 0.5) / s
    return float(4 * (2 * (s * s - 1) / 12 + s * s * (t * (1 - t)).mean()))


def _ladder(*fade: tuple[float, float]) -> Ladder:
    every = list(fade)
    while len(every) < MOST_RUNGS - 1:
        every.append((every[-1][0] * 2, every[-1][1] * 2))
    return Ladder(np.array(every, np.float32), np.array([_cut_px2(k) for k in range(MOST_RUNGS)], np.float32))


LADDERS = {
    "draft": _ladder((1.6, 2.2), (6.0, 8.0), (18.0, 24.0), (48.0, 64.0)),
    "standard": _ladder((2.0, 2.8), (7.0, 9.0), (20.0, 26.0)),
    "high": _ladder((14.0, 18.0), (40.0, 52.0), (80.0, 104.0)),
}
