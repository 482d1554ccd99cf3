"""The picture out of cells, pigment and lines: the last pass over the pixels.

Without borders a pixel takes its own cell's colour. With them, alike cells run into each other,
unlike ones keep their border, darker towards it. Cost: O(pixels).
Source: docs/methods/watercolor.md#pigment; pigment itself is in pigment.py."""

from functools import partial

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, kernel
from arfx.core.parallel import parallel_rows
from arfx.stages.watercolor.label_kernels import SOLID
from arfx.stages.watercolor.labels import Labels
from arfx.stages.watercolor.pigment import PAPER_PX

CONTRAST = (
    0.25  # difference of two washes' square roots, summed, at which a border is whole
)
DRY_BRUSH = 2.3  # how much more the grain shows in lines than in washes
_F = np.float32


How = tuple[np.float32, np.float32, ndarray]


def painted(
    image: ndarray,
    lines: ndarray,
    corner: tuple[int, int],
    cells: ndarray,
    paper: ndarray,
    how: How,
    labels: Labels,
) -> ndarray:
    """(h, w, 3) float32 linear: the picture with pigment.

    image : (h, w, 3) linear, of which the means are;  lines (h, w) : their strength, 0..1
    corner : x, y of the first pixel in the frame, which anchor the paper
    cells (n, 7) float32 : their linear mean, square root of the colour to paint them in, and
        turbulence, times its strength
    paper (PAPER_PX, PAPER_PX) float32 : its height, times the grain's strength
    how : darkening of the border between unlike washes, opacity of lines, their linear colour"""
    out = np.empty(image.shape, np.float32)
    layers = labels.first, labels.second, labels.inside

    of_rows = image, layers, cells, how, paper, corner, lines, out
    parallel_rows(partial(_paint_rows, *of_rows), len(out))
    return out


@kernel(fastmath=FAST, error_model="numpy")
def _paint_rows(
    image, labels, cells, how, paper, corner, lines, out, first, last
):  # pragma: no cover - compiled
    """`painted` of rows first ... last - 1"""
    own_cell, next_cell, inside = labels
    dark, opacity, ink = how
    x0, y0 = corner
    borders = inside.size > 0
    zero = _F(0)
    one = _F(1)
    for y in range(first, last):
        grain_row = paper[(y0 + y) & (PAPER_PX - 1)]
        for x in range(out.shape[1]):
            k = own_cell[y, x]
            m = k
            mix = zero
            height = grain_row[(x0 + x) & (PAPER_PX - 1)]
            density = cells[k, 6] + height
            if borders and inside[y, x] < SOLID:
                m = next_cell[y, x]
                near = one - _F(inside[y, x]) * _F(1.0 / SOLID)  # 1 on the border
                near *= near
                apart = zero
                for c in range(3, 6):
                    apart += abs(cells[m, c] - cells[k, c])
                apart = min(apart * _F(1 / CONTRAST), one)
                apart *= apart
                like = _likeness(image[y, x], cells[k], cells[m], near)
                mix = (
                    _F(0.5) * near * (one - apart)
                    + apart * min(_F(3) * near, one) * like
                )
                density += _F(0.5) * near * (cells[m, 6] - cells[k, 6])
                # the peak on the border as a whole pixel sees it
                density += dark * apart * near * (one - _F(0.3) * near * near)
            line = lines[y, x] * (one + _F(DRY_BRUSH) * height)
            line = min(max(line, zero), one) * opacity
            for c in range(3):
                root = cells[k, 3 + c] + mix * (cells[m, 3 + c] - cells[k, 3 + c])
                colour = root * root
                colour *= one - (one - colour) * density  # under thicker pigment
                out[y, x, c] = max(colour + line * (ink[c] - colour), zero)


@kernel(fastmath=FAST, error_model="numpy", inline="always")
def _likeness(pixel, own, other, near):  # pragma: no cover - compiled
    """0..1: how much more a pixel is like the other cell's mean than its own cell's.

    A camera's edge, some 2 px wide, comes out 1 px wide: any steeper, and it would go from pixel
    to pixel in leaps. near : 1 on the border"""
    along = _F(0)
    length = _F(0)
    for c in range(3):
        step = other[c] - own[c]
        along += (pixel[c] - own[c]) * step
        length += step * step
    between = along / (length + _F(1e-9))
    half = _F(0.5)
    return min(max((between - half) * _F(2) + half * near, _F(0)), _F(1))
