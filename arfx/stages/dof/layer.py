"""One layer of a frame (the real scene, or something cut out before it) on the ladder: deposit once, then any rows.

Light goes in as premultiplied colour and weight; what comes out is the same, spread. Pixels of at most SHARP_PX are left
to the caller: their light stays where it is.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from arfx.core.parallel import scratch
from arfx.core.rect import Rect
from arfx.stages.dof.aperture import STEPS, Shape, shape
from arfx.stages.dof.ladder import ALIGN_PX, Ladder
from arfx.stages.dof.spread import TILE_PX, Light, Sink, run_sums, spread_cells, spread_pixels

STRIP_PX = ALIGN_PX  # rows worked on at once: cells of every rung lie in one strip only


def strips(rect: Rect) -> list[tuple[int, int]]:
    """Rows of `rect`, from its top, cut where the frame's rows are multiples of STRIP_PX."""
    cuts = [rect.y0, *range((rect.y0 // STRIP_PX + 1) * STRIP_PX, rect.y1, STRIP_PX), rect.y1]
    return [(a - rect.y0, b - rect.y0) for a, b in pairwise(cuts)]


Columns = tuple[int, int]  # first and behind the last; none where they are not in this order


def hull(a: Columns, b: Columns) -> Columns:
    """All columns from the first to the last of both."""
    if a[0] >= a[1]:
        return b
    return a if b[0] >= b[1] else (min(a[0], b[0]), max(a[1], b[1]))


def reached(rows: list[tuple[int, int]], hot: list[Columns], reach: int, width: int) -> list[Columns]:
    """Of each strip the columns that light of the strips' columns `hot` can reach, px, and the strips' own."""
    out = []
    for top, bottom in rows:
        a, b = 0, 0
        for (first, last), columns in zip(rows, hot, strict=True):
            if first < bottom + reach and last > top - reach:
                a, b = hull((a, b), columns)
        out.append((max(a - reach, 0), min(b + reach, width)) if a < b else (0, 0))
    return out


DARK = Light(np.zeros(4, np.float32), np.zeros((0, 7), np.int64), 0, 0, 0, 0)


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
        self.far = [self._far(k) for k in range(self.rungs)]
        self.reach = max(far + 3 << k for k, far in enumerate(self.far))

    @property
    def sink(self) -> Sink:
        return Sink(self.ladder.fade, self.cells, self.meta, self.lead_y, self.lead_x, self.near, self.held)

    def note(self, strip: tuple[int, int], any_light: bool) -> None:
        """What a deposit kernel said of a strip."""
        if any_light:
            self.busy.append(strip)

    def rows(self, top: int, bottom: int, name: str) -> Light:
        """Light that reaches rows top..bottom; its values are this thread's, until it asks for the same name again."""
        if not any(a < bottom + self.reach and b > top - self.reach for a, b in self.busy):
            return DARK
        parts = [(k, *self._cell_rows(k, top, bottom)) for k in range(0 if self._any_near(top, bottom) else 1, self.rungs)]
        sizes = [(high - low) * (width + 1) * 4 for _, low, high, _, width in parts]
        values, first, table = scratch(name, (sum(sizes),)), 0, []
        for (k, low, high, height, width), size in zip(parts, sizes, strict=True):
            left, right = self._spread(k, low, high, values[first : first + size].reshape(high - low, width + 1, 4))
            if left < right:
                table.append((k, first, low, height, width, left, right))
            first += size
        if not table:
            return DARK
        lo, hi = min(row[5] for row in table), max(row[6] for row in table)
        return Light(values, np.array(table, np.int64), self.lead_y, self.lead_x, lo, hi)

    def _spread(self, rung: int, low: int, high: int, marks: np.ndarray) -> tuple[int, int]:
        """Light of one rung to its rows low..high, marks (rows, width + 1, 4). Returns the rectangle's columns it reaches."""
        width = self.radius.shape[1]
        if rung == 0:
            until = np.float32(self.ladder.fade[0, 1] if self.rungs > 1 else np.inf)
            a, b = spread_pixels(self.sink, self.radius, until, low, high, self.far[0], marks, self.shape)
            run_sums(marks, a, b)
            return a, b
        first, columns, height = (int(v) for v in self.meta[rung])
        cells, cut = self.cells[first : first + columns * height], self.ladder.cut_px2[rung]
        a, b = spread_cells(cells, columns, height, rung, cut, low, high, self.far[rung], marks, self.shape)
        run_sums(marks, a, b)
        if a >= b:
            return 0, 0
        return max(((a - 1) << rung) - self.lead_x, 0), min(((b + 1) << rung) - self.lead_x, width)

    def _cell_rows(self, rung: int, top: int, bottom: int) -> tuple[int, int, int, int]:
        """Of a rung: first and last row that rows top..bottom lie between, its height and width."""
        if rung == 0:
            return top, bottom, *self.radius.shape
        _, width, height = (int(v) for v in self.meta[rung])
        low, high = ((top + self.lead_y) >> rung) - 1, ((bottom - 1 + self.lead_y) >> rung) + 2
        return max(low, 0), min(high, height), height, width

    def _any_near(self, top: int, bottom: int) -> bool:
        lead, far = self.lead_y % TILE_PX, self.far[0]
        return bool(self.held[max(top - far + lead, 0) // TILE_PX : (bottom + far - 1 + lead) // TILE_PX + 1].any())

    def _far(self, rung: int) -> int:
        """Rows that a disc of this rung reaches at most, in its cells."""
        q = min(int(self.ladder.most_px(rung, self.largest_px) / 2**rung * STEPS + 0.5), len(self.shape.reach) - 1)
        return int(self.shape.reach[q])
