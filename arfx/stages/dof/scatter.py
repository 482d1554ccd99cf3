"""Light spread evenly over blur circles of any size, energy kept.

Radii lie in bins. A pixel's light goes to the two bins around its squared radius, so that nothing
jumps when a radius changes. Each bin is one convolution with its disc, on cells of 2^k px that
grow with the disc. Averaging over a cell and doubling the resolution blur too: a bin's disc is
smaller by just that variance (`cell_disc`). Cells lie on the frame's grid, so a pixel gets the
same from any
rectangle that holds what its light comes from.

Cost: O(pixels), two convolutions of at most 11 x 11 each, fewer where cells are larger."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import cv2
import numpy as np

from arfx.core.compiled import FAST, line_kernel
from arfx.core.parallel import parallel_map
from arfx.stages.dof.aperture import SHARP_PX, disc

BAND_PX = 64  # rows that are spread together, few enough for the processor's cache
_BEYOND = 1e12  # larger than any squared radius, px^2
_RADIUS_STEP = 1 / 16  # of a cell, to which a bin's disc is rounded
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


@dataclass(frozen=True, eq=False)
class _Bin:
    """hat : squared radii, px^2, where its share of a pixel's light begins, is all, and ends
    level : cells have 2^level px;  weights : (n, n) float32 of its disc on them, turned by 180
        degrees
    rows : first row of cells with light of it, and the one behind the last"""

    hat: np.ndarray
    level: int
    weights: np.ndarray
    rows: tuple[int, int]


class Scatter:
    """A layer's light, spread.

    light : (h, w, c) float32, 4 channels or more;  radius : (h, w) float32 px
    corner : x, y of the layer in the frame
    accuracy : how finely;  blades, turn_deg : of `disc`"""

    def __init__(
        self,
        light: np.ndarray,
        radius: np.ndarray,
        corner: tuple[int, int],
        accuracy: Accuracy,
        blades: int,
        turn_deg: float,
    ) -> None:
        self.height, self.width = radius.shape
        largest = float(radius.max())
        radii = accuracy.radii(largest) if largest > SHARP_PX else [SHARP_PX]
        levels = [0, *(accuracy.level(r) for r in radii[1:])]  # the first is not spread
        unit = 1 << levels[-1]
        self.above, self.left = corner[1] % unit, corner[0] % unit
        light = _padded(light, self.above, 0, self.left, 0)
        radius = _padded(radius, self.above, 0, self.left, 0)
        self.cells = [(light, radius)]  # of each level: means of light and radius
        for _ in range(levels[-1]):
            self.cells.append((_halved(self.cells[-1][0]), _halved(self.cells[-1][1])))
        self.bins: list[_Bin] = []
        extents = [(r.min(1), r.max(1)) for _, r in self.cells]
        ends = [*np.square(radii), _BEYOND]
        for k in range(1, len(radii)):
            level, last = levels[k], radii[k + 1] if k + 1 < len(radii) else np.inf
            low, high = extents[level]
            rows = np.flatnonzero((high > radii[k - 1]) & (low < last))
            if len(rows):
                weights = cell_disc(radii[k], level, blades, turn_deg)[::-1, ::-1]
                hat = np.array(ends[k - 1 : k + 2], np.float32)
                self.bins.append(
                    _Bin(hat, level, weights, (int(rows[0]), int(rows[-1]) + 1))
                )
        self.coarse = self._coarse()

    def _coarse(self) -> np.ndarray | None:
        """Light on cells of 2 px of all bins that are spread on cells; None where there are
        none."""
        total = None
        for level in range(max((b.level for b in self.bins), default=0), 0, -1):
            shape = self.cells[level][0].shape
            if total is None:
                total = np.zeros(shape, np.float32)
            else:
                total = _doubled(total)[: shape[0], : shape[1]]
            bins = [b for b in self.bins if b.level == level]
            rows = shape[0]
            for first, light in parallel_map(partial(self._spread, 0, rows), bins):
                total[first : first + len(light)] += light
        return total

    def _spread(self, top: int, bottom: int, of: _Bin) -> tuple[int, np.ndarray]:
        """(first row, light (n, columns, c)) of a bin within rows top..bottom of its level."""
        light, radius = self.cells[of.level]
        half = len(of.weights) // 2
        first, last = max(of.rows[0], top - half), min(of.rows[1], bottom + half)
        if first >= last:
            return top, light[:0]
        begin, end = max(first - half, top), min(last + half, bottom)
        above, below = min(first, begin), max(last, end)
        share = np.zeros((below - above, *light.shape[1:]), np.float32)
        take_share(
            light[first:last],
            radius[first:last],
            of.hat,
            share[first - above : last - above],
        )
        spread = cv2.filter2D(share, -1, of.weights, borderType=cv2.BORDER_CONSTANT)
        return begin, spread[begin - above : end - above]

    def rows(self, top: int, bottom: int) -> np.ndarray:
        """(bottom - top, w, c) light that reaches these rows of the layer."""
        top, bottom = top + self.above, bottom + self.above
        out = self._coarse_rows(top, bottom)
        for of in self.bins:
            if of.level == 0:
                first, light = self._spread(top, bottom, of)
                out[first - top : first - top + len(light)] += light
        return np.ascontiguousarray(out[:, self.left : self.left + self.width])

    def _coarse_rows(self, top: int, bottom: int) -> np.ndarray:
        """Rows of the coarse light on pixels."""
        shape = self.cells[0][0].shape
        if self.coarse is None:
            return np.zeros((bottom - top, *shape[1:]), np.float32)
        first, last = max(top // 2 - 1, 0), (bottom + 1) // 2 + 1
        doubled = _doubled(self.coarse[first:last])
        return doubled[top - 2 * first : bottom - 2 * first, : shape[1]]


def _padded(a: np.ndarray, above: int, below: int, left: int, right: int) -> np.ndarray:
    """Light (h, w, c) with nothing around it, or radii (h, w) with those of the border."""
    if not (above or below or left or right):
        return a
    sides = (above, below), (left, right)
    return np.pad(a, sides, "edge") if a.ndim == 2 else np.pad(a, (*sides, (0, 0)))


def _halved(a: np.ndarray) -> np.ndarray:
    """Means over 2 x 2."""
    even = _padded(a, 0, a.shape[0] % 2, 0, a.shape[1] % 2)
    size = even.shape[1] // 2, even.shape[0] // 2
    return cv2.resize(even, size, interpolation=cv2.INTER_AREA)


def _doubled(a: np.ndarray) -> np.ndarray:
    size = 2 * a.shape[1], 2 * a.shape[0]
    return cv2.resize(a, size, interpolation=cv2.INTER_LINEAR)


def cell_disc(radius_px: float, level: int, blades: int, turn_deg: float) -> np.ndarray:
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
def _variances(blades: int, turn_deg: float) -> np.ndarray:
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
    of `_Bin`"""
    one, zero = np.float32(1), np.float32(0)
    rise, fall = one / (hat[1] - hat[0]), one / (hat[2] - hat[1])
    for y in range(light.shape[0]):
        for x in range(light.shape[1]):
            px2 = radius[y, x] * radius[y, x]
            share = min(min((px2 - hat[0]) * rise, (hat[2] - px2) * fall), one)
            if share > zero:
                for c in range(light.shape[2]):
                    out[y, x, c] = share * light[y, x, c]
