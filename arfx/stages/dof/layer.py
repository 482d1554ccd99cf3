"""One layer of a frame (the real scene, or something cut out before it) on the ladder: deposit once, then any rows.

Light goes in as premultiplied colour and weight; what comes out is the same, spread. Pixels of at most SHARP_PX are left
to the caller: their light stays where it is.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from arfx.core.rect import Rect
from arfx.stages.dof.aperture import STEPS, Shape, shape
from arfx.stages.dof.ladder import ALIGN_PX, Ladder
from arfx.stages.dof.spread import TILE_PX, add_rung, run_sums, spread_cells, spread_pixels
from arfx.stages.dof.work import zeros

DARK = np.zeros((1, 1, 4), np.float32)
STRIP_PX = ALIGN_PX  # rows worked on at once: cells of every rung lie in one strip only


def strips(rect: Rect) -> list[tuple[int, int]]:
    """Rows of `rect`, from its top, cut where the frame's rows are multiples of STRIP_PX."""
    cuts = [rect.y0, *range((rect.y0 // STRIP_PX + 1) * STRIP_PX, rect.y1, STRIP_PX), rect.y1]
    return [(a - rect.y0, b - rect.y0) for a, b in pairwise(cuts)]


class Spread:
    """Light of one layer over `rect`.

    radius : (h, w) float32 px, of every pixel, filled by the caller; -1 = nothing there
    largest_px : no radius is larger
    """

    def __init__(self, rect: Rect, ladder: Ladder, largest_px: float, blades: int, turn_deg: float) -> None:
        self.rect, self.ladder, self.largest_px = rect, ladder, largest_px
        self.radius = np.empty((rect.height, rect.width), np.float32)
        self.rungs = ladder.rungs(largest_px)
        self.shape: Shape = shape(ladder.table_px(largest_px), blades, turn_deg)
        self.busy: list[tuple[int, int]] = []  # strips that hold light
        # memory that is never touched costs nothing: rung 0 holds light only where the radius is small, in `held` tiles
        self.near = np.empty((rect.height, rect.width, 4), np.float32)
        self.lead_x, self.lead_y = rect.x0 % ALIGN_PX, rect.y0 % ALIGN_PX
        tiles = [(lead % TILE_PX + n - 1) // TILE_PX + 1 for lead, n in ((self.lead_y, rect.height), (self.lead_x, rect.width))]
        self.held = np.zeros(tiles, np.uint8)
        self.meta = np.zeros((self.rungs, 3), np.int64)
        first = 0
        for k in range(1, self.rungs):
            width = ((self.lead_x + rect.width - 1) >> k) + 1
            height = ((self.lead_y + rect.height - 1) >> k) + 1
            self.meta[k] = first, width, height
            first += width * height
        self.cells = np.zeros((first, 5), np.float32)

    @property
    def sink(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int, np.ndarray, np.ndarray]:
        """Arguments of the deposit kernels: where light goes."""
        return self.ladder.fade, self.cells, self.meta, self.lead_y, self.lead_x, self.near, self.held

    def note(self, strip: tuple[int, int], any_light: bool) -> None:
        """What a deposit kernel said of a strip."""
        if any_light:
            self.busy.append(strip)

    def rows(self, top: int, bottom: int, name: str) -> tuple[np.ndarray, int, int]:
        """Light (rows, w, 4) that reaches rows top..bottom, and the columns lo..hi outside of which it is 0.

        The array is this thread's, until it asks for the same name again."""
        w = self.radius.shape[1]
        s = self.shape
        far = max(self._far(k) + 2 << k for k in range(self.rungs))
        if not any(a < bottom + far and b > top - far for a, b in self.busy):
            return DARK, 0, 0
        table = s.ends, s.shares, s.unit, s.reach
        until = float(self.ladder.fade[0, 1]) if self.rungs > 1 else np.inf
        out = zeros(name, (bottom - top, w + 1, 4))
        lo, hi = spread_pixels(
            self.near, self.held, self.lead_y, self.lead_x, self.radius, np.float32(until), top, bottom, self._far(0), out, *table
        )  # fmt: skip
        run_sums(out, lo, hi)
        for k in range(1, self.rungs):
            first, width, height = (int(v) for v in self.meta[k])
            low = max(((top + self.lead_y) >> k) - 1, 0)
            high = min(((bottom - 1 + self.lead_y) >> k) + 2, height)
            marks = zeros("rung", (high - low, width + 1, 4))
            cells = self.cells[first : first + width * height]
            a, b = spread_cells(cells, width, height, k, self.ladder.cut_px2[k], low, high, self._far(k), marks, *table)
            if a >= b:
                continue
            run_sums(marks, a, b)
            left, right = max(((a - 1) << k) - self.lead_x, 0), min(((b + 1) << k) - self.lead_x, w)
            add_rung(out, marks, k, low, height, width, top, self.lead_y, self.lead_x, left, right)
            lo, hi = min(lo, left), max(hi, right)
        return out, lo, hi

    def _far(self, rung: int) -> int:
        """Rows that a disc of this rung reaches at most, in its cells."""
        q = min(int(self.ladder.most_px(rung, self.largest_px) / 2**rung * STEPS + 0.5), len(self.shape.reach) - 1)
        return int(self.shape.reach[q])
