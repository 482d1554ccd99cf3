"""The picture out of cells without borders: each pixel takes its own cell's colour, with pigment, paper and lines.

Cells may be those of a picture of half the size: each of their pixels then makes four. Colours stay in threes, as they are
written: three floats and one that the next overwrites cost one store. Cost: O(pixels), a quarter of `paint`'s.
Source: docs/methods/watercolor.md#pigment."""

from __future__ import annotations

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.stages.four import put_four
from arfx.stages.watercolor.paint import grain_row, line_row
from arfx.stages.watercolor.rows import Cells, read_labels

_FAST = {"contract", "nsz", "arcp", "nnan", "ninf"}
_U, _F = np.uint64, np.float32


def paint_plain(
    cells: Cells,
    root: np.ndarray,
    flow: np.ndarray,
    paper: tuple[np.ndarray, int, int],
    line: np.ndarray,
    strengths: np.ndarray,
    ink_rgb: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """(h, w, 3) float32 linear, of that shape: that of the cells, or twice that (odd numbers rounded up).

    root, flow, paper, line, strengths, ink_rgb : as of `paint.paint`; strengths without pigment are 0"""
    (h, w), every = shape, 1 if cells.first.shape == shape else 2
    table, out = _pigments(root, flow, strengths[2], strengths[3]), np.empty((h, w, 3), np.float32)
    lines = line, strengths[4], strengths[5], np.tile(np.asarray(ink_rgb, np.float32), w)
    parallel_rows(
        lambda ya, yb: _paint(cells, table, paper, lines, every, ya, yb, out), len(cells.first)
    )
    return out


@numba.njit(cache=True, nogil=True)
def _pigments(root, flow, much_flow, much_grain):  # pragma: no cover - compiled
    """(n, 8) float32: pigment on even paper, 0, what paper of height 1 takes from it, 0"""
    out = np.zeros((root.shape[0], 8), np.float32)
    for k in range(root.shape[0]):
        tinted = much_flow * flow[k]
        for c in range(3):
            colour = root[k, c] * root[k, c]
            slope = colour * (_F(1) - colour)
            out[k, c], out[k, 4 + c] = colour - slope * tinted, slope * much_grain
    return out


@numba.njit(cache=True, nogil=True)
def _paint(cells: Cells, table, paper, lines, every, ya, yb, out):  # pragma: no cover - compiled
    """Rows ya ... yb - 1 of the cells. table (n, 8) : of `_pigments`"""
    (grain, x0, y0), (line, opacity, dry, ink) = paper, lines
    h, w = out.shape[:2]
    n = cells.first.shape[1]
    labels, row = np.empty(n, np.int32), np.empty(max(line.shape[1], 1), np.float32)
    pigment, taken = (
        np.zeros(3 * n * every + 4, np.float32),
        np.zeros(3 * n * every + 4, np.float32),
    )
    height, ink_at = np.zeros(3 * w + 4, np.float32), np.zeros(3 * w + 4, np.float32)
    paper_row, drawn, flat = np.empty(w, np.float32), np.zeros(w + 1, np.float32), table.reshape(-1)
    for j in range(ya, yb):
        read_labels(cells, j, 0, n, labels)
        for x in range(n):
            c = _U(8) * _U(labels[_U(x)])
            a0, a1, a2, a3 = flat[c], flat[c + _U(1)], flat[c + _U(2)], flat[c + _U(3)]
            b0, b1, b2, b3 = flat[c + _U(4)], flat[c + _U(5)], flat[c + _U(6)], flat[c + _U(7)]
            for k in range(every):
                at = 3 * (every * x + k)
                put_four(pigment, at, a0, a1, a2, a3)
                put_four(taken, at, b0, b1, b2, b3)
        for y in range(every * j, min(every * (j + 1), h)):
            grain_row(grain, y0 + y, x0, paper_row)
            _thrice(paper_row, height)
            if line.shape[0] > 0 and line_row(line, y, row, drawn):
                _thrice(drawn[:w], ink_at)
                _ink_row(pigment, taken, height, ink_at, opacity, dry, ink, out[y].reshape(-1))
            else:
                _paper_row(pigment, taken, height, out[y].reshape(-1))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _paper_row(pigment, taken, height, to):  # pragma: no cover - compiled
    for i in range(to.shape[0]):
        to[i] = max(pigment[i] - taken[i] * height[i], _F(0))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _ink_row(pigment, taken, height, line, opacity, dry, ink, to):  # pragma: no cover - compiled
    zero, one = _F(0), _F(1)
    for i in range(to.shape[0]):
        v = pigment[i] - taken[i] * height[i]
        s = min(max(line[i] * (one + dry * height[i]), zero), one) * opacity
        to[i] = max(v + s * (ink[i] - v), zero)


@numba.njit(cache=True, nogil=True)
def _thrice(a, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        v = a[_U(x)]
        put_four(out, 3 * x, v, v, v, v)
