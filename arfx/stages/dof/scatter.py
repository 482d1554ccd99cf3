"""Light spread evenly over blur circles of any size, energy kept.

Radii lie in bins. A pixel's light goes to the two bins around its squared radius, so that nothing
jumps when a radius changes. Each bin is one convolution with its disc, on cells of 2^k px that
grow with the disc. Averaging over a cell and doubling the resolution blur too: a bin's disc is
smaller by just that variance (`cell_disc`). Cells lie on the frame's grid, so a pixel gets the
same from any
rectangle that holds what its light comes from.

Cost: O(pixels), two convolutions of at most 11 x 11 each, fewer where cells are larger."""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass
from functools import lru_cache, partial

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.parallel import parallel_map
from arfx.stages.dof.aperture import SHARP_PX, disc

_BEYOND = 1e12  # larger than any squared radius, px^2
_RADIUS_STEP = 1 / 16  # of a cell, to which a bin's disc is rounded
_AT_ONCE = 2  # bins, each as large as the layer
_LARGEST_CELLS = 8.0  # more than any radius on cells


@dataclass(frozen=True)
class Accuracy:
    """How finely light is spread.

    ratio : of the radius of a bin to that of the one before
    step_px : at least so much larger it is
    fine_px : discs up to this radius are spread on pixels
    cells : and larger ones on cells of 2^k px up to a radius of so many of them"""

    ratio: float
    step_px: float
    fine_px: float
    cells: float

    def level(self, radius_px: float) -> int:
        """k of the cells on which a disc is spread."""
        if radius_px <= self.fine_px:
            return 0
        return max(int(np.ceil(np.log2(radius_px / self.cells))), 1)

    def radii(self, largest_px: float) -> list[float]:
        """Of the bins, px; the first is that of a sharp pixel, and gets no light spread."""
        radii = [SHARP_PX]
        while len(radii) < 2 or radii[-1] < largest_px:
            radii.append(max(radii[-1] * self.ratio, radii[-1] + self.step_px))
        return radii

    @property
    def sharp_px2(self) -> np.float32:
        """Squared radius from which all of a pixel's light is spread."""
        return np.float32(self.radii(0.0)[1] ** 2)


def scattered(
    light: ndarray,
    radius: ndarray,
    corner: tuple[int, int],
    accuracy: Accuracy,
    blades: int,
    turn_deg: float,
) -> ndarray:
    """(h, w, c) a layer's light, spread.

    light : (h, w, c) float32, 4 channels or more;  radius : (h, w) float32 px
    corner : x, y of the layer in the frame
    accuracy : how finely;  blades, turn_deg : of `disc`"""
    (height, width), largest = radius.shape, float(radius.max())
    radii = accuracy.radii(largest) if largest > SHARP_PX else [SHARP_PX]
    levels = [0, *(accuracy.level(r) for r in radii[1:])]  # the first is not spread
    unit = 1 << levels[-1]
    left, above = (at % unit for at in corner)
    cells = [[_padded(a, above, 0, left, 0) for a in (light, radius)]]
    for _ in range(levels[-1]):  # means of light and radius
        cells.append([_halved(a) for a in cells[-1]])
    ends = np.array([*np.square(radii), _BEYOND], np.float32)
    total = np.zeros_like(cells[-1][0])
    for level in range(levels[-1], -1, -1):
        light, radius = cells[level]
        if level < levels[-1]:
            total = _doubled(total)[: light.shape[0], : light.shape[1]]
        bins = [
            (ends[k - 1 : k + 2], cell_disc(radii[k], level, blades, turn_deg))
            for k in range(1, len(radii))
            if levels[k] == level
        ]
        extents = radius.min(1) ** 2, radius.max(1) ** 2
        spread = partial(_spread, light, radius, extents)
        for start in range(0, len(bins), _AT_ONCE):
            for first, part in parallel_map(spread, bins[start : start + _AT_ONCE]):
                total[first : first + len(part)] += part
    return np.ascontiguousarray(total[above : above + height, left : left + width])


def _spread(
    light: ndarray,
    radius: ndarray,
    extents: tuple[ndarray, ndarray],
    of: tuple[ndarray, ndarray],
) -> tuple[int, ndarray]:
    """(first row, light (n, columns, c)) of a bin on the cells of its level.

    extents : least and greatest squared radius of each row
    of : squared radii, px^2, where the bin's share of a pixel's light begins, is all, and ends, and
    its disc on the cells"""
    (low, high), (hat, weights) = extents, of
    rows = np.flatnonzero((high > hat[0]) & (low < hat[2]))
    if not len(rows):
        return 0, light[:0]
    first, last, half = int(rows[0]), int(rows[-1]) + 1, len(weights) // 2
    begin, end = max(first - half, 0), min(last + half, len(light))
    share = np.zeros_like(light[begin:end])
    some = slice(first, last)
    take_share(light[some], radius[some], hat, share[first - begin : last - begin])
    turned = weights[::-1, ::-1]
    return begin, cv2.filter2D(share, -1, turned, borderType=cv2.BORDER_CONSTANT)


def _padded(a: ndarray, above: int, below: int, left: int, right: int) -> ndarray:
    """Light (h, w, c) with nothing around it, or radii (h, w) with those of the border."""
    if not (above or below or left or right):
        return a
    sides = (above, below), (left, right)
    return np.pad(a, sides, "edge") if a.ndim == 2 else np.pad(a, (*sides, (0, 0)))


def _halved(a: ndarray) -> ndarray:
    """Means over 2 x 2."""
    even = _padded(a, 0, a.shape[0] % 2, 0, a.shape[1] % 2)
    size = even.shape[1] // 2, even.shape[0] // 2
    return cv2.resize(even, size, interpolation=cv2.INTER_AREA)


def _doubled(a: ndarray) -> ndarray:
    size = 2 * a.shape[1], 2 * a.shape[0]
    return cv2.resize(a, size, interpolation=cv2.INTER_LINEAR)


def cell_disc(radius_px: float, level: int, blades: int, turn_deg: float) -> ndarray:
    """The disc on cells of 2^level px that is as wide, after all else that blurs, as this one on
    pixels.

    Variance on an axis, px^2: (4^k - 1) / 12 by averaging over a cell, and 3/4 x 4^j of each
    doubling of the resolution; the disc itself has r^2 / 4 + 1/12."""
    if level == 0:
        return disc(round(radius_px / _RADIUS_STEP) * _RADIUS_STEP, blades, turn_deg)
    wanted = (radius_px**2 / 4 + 1 / 12 - (4**level - 1) / 3) / 4**level
    variances = _variances(blades, turn_deg)
    step = int(np.abs(variances - wanted).argmin())
    return disc(step * _RADIUS_STEP, blades, turn_deg)


@lru_cache(maxsize=16)
def _variances(blades: int, turn_deg: float) -> ndarray:
    """Of discs on the grid, by radius in steps of _RADIUS_STEP, cells^2 on an axis."""
    out = []
    for step in range(round(_LARGEST_CELLS / _RADIUS_STEP)):
        light = disc(step * _RADIUS_STEP, blades, turn_deg)
        away = np.arange(len(light)) - len(light) // 2
        out.append((light.sum(0) * away**2 + light.sum(1) * away**2).sum() / 2)
    return np.array(out)


@line_kernel(fastmath=FAST)
def take_share(light, radius, hat, out):  # pragma: no cover - compiled
    """out (h, w, c) = the light (h, w, c) that a bin takes from pixels of a radius (h, w). hat :
    of `_spread`"""
    one, zero = np.float32(1), np.float32(0)
    rise, fall = one / (hat[1] - hat[0]), one / (hat[2] - hat[1])
    for y in range(light.shape[0]):
        for x in range(light.shape[1]):
            px2 = radius[y, x] * radius[y, x]
            share = min(min((px2 - hat[0]) * rise, (hat[2] - px2) * fall), one)
            if share > zero:
                for c in range(light.shape[2]):
                    out[y, x, c] = share * light[y, x, c]
