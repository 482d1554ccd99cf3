"""The picture out of cells, pigment and lines: the last pass over the pixels.

Paint knows of each cell two things of 64 bits each: the root of its colour with its turbulence, and its mean. A row is
painted in steps: what the pixel's own cell and the next one hold is fetched, then all is computed in steps of a vector unit.
Cost: O(pixels). Source: docs/methods/watercolor.md#pigment; the pigment itself is in pigment.py."""

from __future__ import annotations

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.stages.watercolor.label_kernels import SOLID
from arfx.stages.watercolor.pigment import PAPER_PX
from arfx.stages.watercolor.rows import Cells, Picture, read_borders, read_channels, read_labels

_FAST = {"contract", "nsz", "arcp", "nnan", "ninf"}
_U, _F = np.uint64, np.float32
_FLOW = 4.0  # turbulence lies in -_FLOW .. _FLOW


def paint(
    picture: Picture,
    cells: Cells,
    mean: np.ndarray,
    root: np.ndarray,
    flow: np.ndarray,
    paper: tuple[np.ndarray, int, int],
    line: np.ndarray,
    strengths: np.ndarray,
    ink_rgb: np.ndarray,
) -> np.ndarray:
    """(h, w, 3) float32 linear: the picture with pigment.

    mean (n, 3) : linear means of the cells;  root (n, 3) : square roots of the colours to paint them in
    flow (n,) : their turbulence
    paper : grain of `paper_grain`, and x and y of the first pixel in the frame, which anchor it
    line (ceil(h / 2), ceil(w / 2)) : strength of lines, 0..1; empty = none
    strengths (6,) float32 : edge darkening, contrast at which it is whole, flow, grain, opacity of lines, grain in lines
    ink_rgb (3,) : linear colour of lines"""
    out = np.empty((*cells.first.shape, 3), np.float32)
    means, tinted, lines = (
        cell_table(mean, flow),
        cell_table(root, flow),
        (line, strengths, ink_rgb.astype(np.float32)),
    )
    parallel_rows(
        lambda ya, yb: _paint(picture, cells, means, tinted, paper, lines, ya, yb, out), len(out)
    )
    return out


@numba.njit(cache=True, nogil=True)
def cell_table(colour, flow):  # pragma: no cover - compiled
    """(n,) uint64: red, green, blue in 0..1 and the turbulence, 16 bits each."""
    out = np.empty((colour.shape[0], 4), np.uint16)
    for k in range(colour.shape[0]):
        for c in range(3):
            out[k, c] = np.uint16(min(max(colour[k, c], _F(0)), _F(1)) * _F(65535) + _F(0.5))
        out[k, 3] = np.uint16(
            (min(max(flow[k], _F(-_FLOW)), _F(_FLOW)) + _F(_FLOW)) * _F(65535 / (2 * _FLOW))
            + _F(0.5)
        )
    return out.reshape(-1).view(np.uint64)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _paint(
    picture: Picture, cells: Cells, means, tinted, paper, lines, ya, yb, out
):  # pragma: no cover - compiled
    """paper : grain, x, y of the first pixel;  lines : line, strengths, ink, as in `paint`"""
    first, second, inside, mask, ly = cells.first, cells.second, cells.inside, cells.mask, cells.y
    (grain, x0, y0), (line, strengths, ink) = paper, lines
    w = first.shape[1]
    lh, lw = line.shape
    both_a, both_k, both_near = np.empty(w, np.int32), np.empty(w, np.int32), np.empty(w, np.uint8)
    # few arrays: where loops touch many, the compiler gives up proving that they do not overlap
    light = np.zeros((8, w + 1), np.float32)
    cell_data, row = np.empty((4, w), np.uint64), np.empty(max(lw, 1), np.float32)
    for y in range(ya, yb):
        read_channels(picture, y, light[0], light[1], light[2])
        a, k, near = first[y], second[y], inside[y]
        if ly <= y < ly + mask.shape[0]:
            read_labels(cells, y, 0, w, both_a)
            read_borders(cells, y, both_k, both_near)
            a, k, near = both_a, both_k, both_near
        for x in range(w):
            at, to = _U(a[x]), _U(k[x])
            cell_data[0, x], cell_data[1, x], cell_data[2, x], cell_data[3, x] = (
                means[at],
                means[to],
                tinted[at],
                tinted[to],
            )
        grain_row(grain, y0 + y, x0, light[3, :w])
        if lh > 0 and not line_row(line, y, row, light[4]):
            light[4, :] = 0
        _paint_row(cell_data, near, light, strengths, ink)
        for x in range(w):
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = light[5, x], light[6, x], light[7, x]


@numba.njit(cache=True, nogil=True, inline="always")
def _channel(v, shift):  # pragma: no cover - compiled
    return _F(np.int32((v >> _U(shift)) & _U(0xFFFF)))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _paint_row(cell_data, near, light, strengths, ink):  # pragma: no cover - compiled
    """One row. cell_data (4, w), as of `cell_table` : mean of a pixel's cell, of the next one, colour of its cell, of the next
    light (8, w + 1) : red, green, blue, height of the paper, line; and the three that come out"""
    zero, one, half, unit = _F(0), _F(1), _F(0.5), _F(1.0 / 65535)
    step = _F(2 * _FLOW / 65535)
    dark, contrast, much_flow, much_grain, opacity, dry = strengths
    sharp = unit / contrast
    ir, ig, ib = ink
    for x in range(near.shape[0]):
        m1, m2, c1, c2 = cell_data[0, x], cell_data[1, x], cell_data[2, x], cell_data[3, x]
        # 1 on the border, 0 from where a pixel is inside its cell
        t = one - _F(near[x]) * _F(1.0 / SOLID)
        t *= t
        r1, g1, b1, f1 = _channel(c1, 0), _channel(c1, 16), _channel(c1, 32), _channel(c1, 48)
        dr, dg, db = _channel(c2, 0) - r1, _channel(c2, 16) - g1, _channel(c2, 32) - b1
        apart = min((abs(dr) + abs(dg) + abs(db)) * sharp, one)
        apart *= apart
        # of the two colours a pixel takes the one that is like it: where it lies between the means of the cells
        mr, mg, mb = _channel(m1, 0), _channel(m1, 16), _channel(m1, 32)
        er, eg, eb = _channel(m2, 0) - mr, _channel(m2, 16) - mg, _channel(m2, 32) - mb
        along = (
            (light[0, x] * _F(65535) - mr) * er
            + (light[1, x] * _F(65535) - mg) * eg
            + (light[2, x] * _F(65535) - mb) * eb
        )
        like = along / (er * er + eg * eg + eb * eb + one)
        # a camera's edge, some 2 px wide, comes out 1 px wide: any steeper, and it would go from pixel to pixel in leaps
        like = min(max((like - half) * _F(2) + half * t, zero), one)
        # alike cells run into each other, unlike ones keep their border, darker towards it
        mix = half * t * (one - apart) + apart * min(_F(3) * t, one) * like
        d = ((f1 + half * t * (_channel(c2, 48) - f1)) * step - _F(_FLOW)) * much_flow
        # the peak of t on the border as a whole pixel sees it
        d += dark * apart * t * (one - _F(0.3) * t * t) + much_grain * light[3, x]
        pr, pg, pb = (r1 + mix * dr) * unit, (g1 + mix * dg) * unit, (b1 + mix * db) * unit
        pr, pg, pb = pr * pr, pg * pg, pb * pb
        pr, pg, pb = (
            pr * (one - (one - pr) * d),
            pg * (one - (one - pg) * d),
            pb * (one - (one - pb) * d),
        )
        s = min(max(light[4, x] * (one + dry * light[3, x]), zero), one) * opacity
        light[5, x] = max(pr + s * (ir - pr), zero)
        light[6, x] = max(pg + s * (ig - pg), zero)
        light[7, x] = max(pb + s * (ib - pb), zero)


@numba.njit(cache=True, nogil=True)
def grain_row(grain, y, x0, height):  # pragma: no cover - compiled
    w, at = height.shape[0], 0
    row, s = y & (PAPER_PX - 1), x0 & (PAPER_PX - 1)
    while at < w:
        n = min(PAPER_PX - s, w - at)
        for x in range(n):
            height[_U(at) + _U(x)] = grain[row, _U(s) + _U(x)]
        at, s = at + n, 0


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def line_row(line, y, row, lines):  # pragma: no cover - compiled
    """One row of the picture's lines, bilinear between the centres of pixels of twice the size. Whether there are any.

    row (lw,), lines (at least w + 1,) are written; lines not where there are none."""
    lh, lw = line.shape
    w = lines.shape[0] - 1
    j = y // 2
    k = min(j + 1, lh - 1) if y % 2 else max(j - 1, 0)
    far, close, most = _F(0.25), _F(0.75), _F(0)
    for x in range(lw):
        row[x] = close * line[j, x] + far * line[k, x]
        most = max(most, row[x])
    if not most > 0:
        return False
    one, two = _U(1), _U(2)
    for x in range(lw - 2):
        at = _U(x) + one
        lines[two * at] = close * row[at] + far * row[at - one]
        lines[two * at + one] = close * row[at] + far * row[at + one]
    for i in (0, lw - 1):
        lines[2 * i] = close * row[i] + far * row[max(i - 1, 0)]
        if 2 * i + 1 <= w:
            lines[2 * i + 1] = close * row[i] + far * row[min(i + 1, lw - 1)]
    return True
