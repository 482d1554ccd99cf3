"""One layer of a frame (the real scene, or an occluder before it) on a pyramid: splatted once, read back for any rows.

Light goes in as premultiplied colour and weight; what comes out is the same, spread. Pixels of at most SHARP_PX are left
to the caller: their light stays where it is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from arfx.core.parallel import scratch
from arfx.core.rect import Rect
from arfx.stages.dof.aperture import STEPS, Shape, shape
from arfx.stages.dof.pyramid import ALIGN_PX, Pyramid
from arfx.stages.dof.spread import (
    TILE_PX,
    BlurredRows,
    SplatBuffers,
    run_sums,
    spread_cells,
    spread_pixels,
)

STRIP_PX = ALIGN_PX  # rows worked on at once: cells of every level lie in one strip only


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


def reached_columns(
    rows: list[tuple[int, int]], blurred: list[Columns], margin_px: int, width: int
) -> list[Columns]:
    """Of each strip the columns that light of the strips' columns `blurred` can reach, px, and the strips' own."""
    out = []
    for top, bottom in rows:
        a, b = 0, 0
        for (first, last), columns in zip(rows, blurred, strict=True):
            if first < bottom + margin_px and last > top - margin_px:
                a, b = hull((a, b), columns)
        out.append((max(a - margin_px, 0), min(b + margin_px, width)) if a < b else (0, 0))
    return out


DARK = BlurredRows(np.zeros(4, np.float32), np.zeros((0, 7), np.int64), 0, 0, 0, 0)


class BlurLayer:
    """Light of one layer over `rect`.

    radius : (h, w) float32 px, of every pixel, filled by the caller; -1 = nothing there
    largest_px : no radius is larger"""

    def __init__(
        self, rect: Rect, pyramid: Pyramid, largest_px: float, blades: int, turn_deg: float
    ) -> None:
        self.rect, self.pyramid, self.largest_px = rect, pyramid, largest_px
        self.radius = np.empty((rect.height, rect.width), np.float32)
        self.levels = pyramid.levels(largest_px)
        self.shape: Shape = shape(pyramid.table_px(largest_px), blades, turn_deg)
        self.lit_strips: list[tuple[int, int]] = []  # strips that hold light
        # memory that is never touched costs nothing: level 0 holds light only where the radius is small, in `occupied` tiles
        self.finest = np.empty((rect.height, rect.width, 4), np.float32)
        self.offset_x, self.offset_y = rect.x0 % ALIGN_PX, rect.y0 % ALIGN_PX
        tiles = [
            (start % TILE_PX + n - 1) // TILE_PX + 1
            for start, n in ((rect.y0, rect.height), (rect.x0, rect.width))
        ]
        self.occupied = np.zeros(tiles, np.uint8)
        self.meta = np.zeros((self.levels, 3), np.int64)
        first = 0
        for k in range(1, self.levels):
            width = ((self.offset_x + rect.width - 1) >> k) + 1
            height = ((self.offset_y + rect.height - 1) >> k) + 1
            self.meta[k] = first, width, height
            first += width * height
        self.cells = np.zeros((first, 5), np.float32)
        self.margins = [self._margin(k) for k in range(self.levels)]
        self.margin_px = max(margin + 3 << k for k, margin in enumerate(self.margins))

    @property
    def buffers(self) -> SplatBuffers:
        at, to = (self.offset_y, self.offset_x), (self.finest, self.occupied)
        return SplatBuffers(self.pyramid.fade, self.cells, self.meta, *at, *to)

    def record(self, strip: tuple[int, int], any_light: bool) -> None:
        """What a splat kernel returned for a strip."""
        if any_light:
            self.lit_strips.append(strip)

    def rows(self, top: int, bottom: int, name: str) -> BlurredRows:
        """Light that reaches rows top..bottom; its values are this thread's, until it asks for the same name again."""
        if not any(
            a < bottom + self.margin_px and b > top - self.margin_px for a, b in self.lit_strips
        ):
            return DARK
        offset, margin = self.offset_y % TILE_PX, self.margins[0]
        any_finest = self.occupied[
            max(top - margin + offset, 0) // TILE_PX : (bottom + margin - 1 + offset) // TILE_PX + 1
        ].any()
        parts = [
            (k, *self._cell_rows(k, top, bottom))
            for k in range(0 if any_finest else 1, self.levels)
        ]
        sizes = [(high - low) * (width + 1) * 4 for _, low, high, _, width in parts]
        values, first, table = scratch(name, (sum(sizes),)), 0, []
        for (k, low, high, height, width), size in zip(parts, sizes, strict=True):
            left, right = self._spread(
                k, low, high, values[first : first + size].reshape(high - low, width + 1, 4)
            )
            if left < right:
                table.append((k, first, low, height, width, left, right))
            first += size
        if not table:
            return DARK
        lo, hi = min(row[5] for row in table), max(row[6] for row in table)
        return BlurredRows(values, np.array(table, np.int64), self.offset_y, self.offset_x, lo, hi)

    def _spread(self, level: int, low: int, high: int, marks: np.ndarray) -> tuple[int, int]:
        """Light of one level to its rows low..high, marks (rows, width + 1, 4). Returns the rectangle's columns reached."""
        width = self.radius.shape[1]
        if level == 0:
            limit_px = np.float32(self.pyramid.fade[0, 1] if self.levels > 1 else np.inf)
            a, b = spread_pixels(
                self.buffers, self.radius, limit_px, low, high, self.margins[0], marks, self.shape
            )
            run_sums(marks, a, b)
            return a, b
        first, columns, height = (int(v) for v in self.meta[level])
        cells, blur_px2 = (
            self.cells[first : first + columns * height],
            self.pyramid.filter_px2[level],
        )
        a, b = spread_cells(
            cells,
            columns,
            height,
            level,
            blur_px2,
            low,
            high,
            self.margins[level],
            marks,
            self.shape,
        )
        run_sums(marks, a, b)
        if a >= b:
            return 0, 0
        return max(((a - 1) << level) - self.offset_x, 0), min(
            ((b + 1) << level) - self.offset_x, width
        )

    def _cell_rows(self, level: int, top: int, bottom: int) -> tuple[int, int, int, int]:
        """Of a level: first and last row that rows top..bottom lie between, its height and width."""
        if level == 0:
            return top, bottom, *self.radius.shape
        _, width, height = (int(v) for v in self.meta[level])
        low, high = (
            ((top + self.offset_y) >> level) - 1,
            ((bottom - 1 + self.offset_y) >> level) + 2,
        )
        return max(low, 0), min(high, height), height, width

    def _margin(self, level: int) -> int:
        """Rows that a disc of this level reaches at most, in its cells."""
        q = min(
            int(self.pyramid.max_radius_px(level, self.largest_px) / 2**level * STEPS + 0.5),
            len(self.shape.half_rows) - 1,
        )
        return int(self.shape.half_rows[q])
