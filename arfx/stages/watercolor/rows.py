"""What the passes over the picture read: a row of the composite with the toon-shaded object in its place, and a row of labels
with the object's own cells where it covers the background. Rows are put together in buffers that stay in the cache, so that
no pass needs a copy of the picture. Kernels only."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.rect import Rect
from arfx.stages.watercolor.labels import Labels

_U = np.uint64  # an index of that type is not looked at for a minus: loops stay simple
_NO_IMAGE = np.zeros((0, 0, 3), np.float32)
_NO_MASK = np.zeros((0, 0), bool)


class Picture(NamedTuple):
    """image (h, w, 3) linear;  patch (bh, bw, 3) : replaces it from pixel (y, x) on, may be empty"""

    image: np.ndarray
    patch: np.ndarray = _NO_IMAGE
    y: int = 0
    x: int = 0

    def whole(self) -> np.ndarray:
        if not self.patch.size:
            return self.image
        out = self.image.copy()
        out[self.y : self.y + self.patch.shape[0], self.x : self.x + self.patch.shape[1]] = (
            self.patch
        )
        return out


class Cells(NamedTuple):
    """Labels of the whole picture, first, second, inside as of `Labels`, and own_… of the object, which stands where mask
    (bh, bw) says so from pixel (y, x) on;  start : number of the object's first cell;  cell_count : of all"""

    first: np.ndarray
    second: np.ndarray
    inside: np.ndarray
    own_first: np.ndarray
    own_second: np.ndarray
    own_inside: np.ndarray
    mask: np.ndarray
    start: int
    cell_count: int
    y: int
    x: int


def combine_labels(
    back: Labels, own: Labels | None = None, mask: np.ndarray = _NO_MASK, y: int = 0, x: int = 0
) -> Cells:
    """The object's cells are numbered on from the background's."""
    of, count = own or back, back.count + (own.count if own else 0)
    return Cells(
        back.first,
        back.second,
        back.inside,
        of.first,
        of.second,
        of.inside,
        mask,
        back.count,
        count,
        y,
        x,
    )


def offset(box: Rect, rect: Rect) -> tuple[int, int]:
    return box.y0 - rect.y0, box.x0 - rect.x0


@numba.njit(cache=True, nogil=True)
def read_channels(picture: Picture, y, r, g, b):  # pragma: no cover - compiled
    """r, g, b (w,) float32 : row y of the picture."""
    image, patch, py, px = picture
    line = image[y].reshape(
        -1
    )  # that a pixel has three numbers is known to the compiler in this form only
    for x in range(image.shape[1]):
        i = _U(3) * _U(x)
        r[x], g[x], b[x] = line[i], line[i + _U(1)], line[i + _U(2)]
    if py <= y < py + patch.shape[0]:
        for x in range(patch.shape[1]):
            to = _U(px) + _U(x)
            r[to], g[to], b[to] = patch[y - py, x, 0], patch[y - py, x, 1], patch[y - py, x, 2]


@numba.njit(cache=True, nogil=True)
def union_span(px, pw, lx, lw):  # pragma: no cover - compiled
    """(left, right): the columns of the patch and of the mask, either of which may be empty."""
    if pw == 0 or lw == 0:
        return (px, px + pw) if lw == 0 else (lx, lx + lw)
    return min(px, lx), max(px + pw, lx + lw)


@numba.njit(cache=True, nogil=True)
def read_labels(cells: Cells, y, left, right, a):  # pragma: no cover - compiled
    """a (w,) int32 : in columns left ... right - 1 row y of the labels."""
    first, own_first, mask, start, ly, lx = (
        cells.first,
        cells.own_first,
        cells.mask,
        cells.start,
        cells.y,
        cells.x,
    )
    for x in range(left, right):
        a[_U(x)] = first[y, _U(x)]
    if ly <= y < ly + mask.shape[0]:
        own, inside, part = own_first[y - ly], mask[y - ly], a[lx : lx + mask.shape[1]]
        for x in range(inside.shape[0]):
            part[x] = own[x] + np.int32(start) if inside[x] else part[x]


@numba.njit(cache=True, nogil=True)
def read_borders(cells: Cells, y, k, near):  # pragma: no cover - compiled
    """k (w,) int32, near (w,) uint8 : row y of the next cells and of how far inside a pixel is."""
    _, second, inside, _, own_second, own_inside, mask, start, _, ly, lx = cells
    for x in range(second.shape[1]):
        k[x] = second[y, x]
    for x in range(second.shape[1]):
        near[x] = inside[y, x]
    if ly <= y < ly + mask.shape[0]:
        for x in range(mask.shape[1]):
            if mask[y - ly, x]:
                to = _U(lx) + _U(x)
                k[to] = own_second[y - ly, x] + start
                near[to] = own_inside[y - ly, x]


@numba.njit(cache=True, nogil=True)
def read_pixels(picture: Picture, y, left, right, line):  # pragma: no cover - compiled
    """line (3 w,) float32 : in columns left ... right - 1 row y of the picture."""
    image, patch, py, px = picture
    source = image[y].reshape(-1)
    for i in range(3 * left, 3 * right):
        line[_U(i)] = source[_U(i)]
    if py <= y < py + patch.shape[0]:
        part, to = patch[y - py].reshape(-1), line[3 * px : 3 * (px + patch.shape[1])]
        for i in range(part.shape[0]):
            to[i] = part[i]
