"""The level reference: the mean over a pixel of what is painted in it, at several places.

Labels are found by other means than the kernels' of labels.py, in float64: place by place, ring after ring of squares around it
until no farther one can hold a nearer site. They are the yardstick for the kernels too."""

from __future__ import annotations

import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.stages.watercolor.label_kernels import SOLID
from arfx.stages.watercolor.labels import Labels, Wobble, bucket_sites, unlabelled
from arfx.stages.watercolor.pigment import repeat_tile
from arfx.stages.watercolor.sites import STEPS, Sites

_AT_ONCE = 1 << 22  # distances in memory at a time


def nearest_labels(
    x_px: np.ndarray, y_px: np.ndarray, weight_px2: np.ndarray, px: np.ndarray, py: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(first, second) (n,) int32: of the sites (k,), the nearest to the positions (n,) and the next, by |p - s|^2 - weight.

    Of equal distances the lower number wins. Every pair is looked at."""
    first, second = np.zeros(len(px), np.int32), np.zeros(len(px), np.int32)
    step = max(1, _AT_ONCE // max(len(x_px), 1))
    for a in range(0, len(px), step):
        part = slice(a, a + step)
        d = (px[part, None] - x_px) ** 2 + (py[part, None] - y_px) ** 2 - weight_px2
        first[part] = d.argmin(1)
        if len(x_px) > 1:
            d[np.arange(len(d)), first[part]] = np.inf
            second[part] = d.argmin(1)
        else:
            second[part] = first[part]
    return first, second


def labels_within(
    sites: Sites, rect: Rect, wobble: Wobble, blend_px: float, places: int
) -> tuple[Labels, ...]:
    """At places x places within every pixel, evenly, the middle first; places : odd. Between pixels the wobble is linear."""
    tile = repeat_tile(
        wobble.tile, wobble.x + rect.x0 - 1, wobble.y + rect.y0 - 1, rect.width + 2, rect.height + 2
    )
    near, along = tile.astype(float), np.arange(places) / places + 0.5 / places - 0.5
    at = sorted(((y, x) for y in along for x in along), key=lambda place: np.hypot(*place))

    def moved(y: float, x: float) -> np.ndarray:
        rows = near[:, 1:-1] + abs(y) * (
            near[:, 2:] - near[:, 1:-1] if y > 0 else near[:, :-2] - near[:, 1:-1]
        )
        middle, beside = rows[..., 1:-1], rows[..., 2:] if x > 0 else rows[..., :-2]
        return middle + abs(x) * (beside - middle) + STEPS * np.array([x, y])[:, None, None]

    return tuple(reference_labels(sites, rect, moved(y, x), blend_px) for y, x in at)


def reference_labels(
    sites: Sites, rect: Rect, wobble: np.ndarray | None = None, blend_px: float = 0.0
) -> Labels:
    """The same as labels.label. wobble (2, h, w) : displacement of the pixels, 1/STEPS px"""
    h, w, borders = rect.height, rect.width, blend_px > 0
    if not len(sites):
        return unlabelled(h, w, 1, borders)
    moved = np.zeros((2, h, w)) if wobble is None or not wobble.size else np.asarray(wobble, float)
    x, y, weight = (np.asarray(a, float) for a in (sites.x, sites.y, sites.weight))
    left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
    longest = max(right - left, bottom - top)
    side = max(np.sqrt((right - left) * (bottom - top) / len(x)), longest / 8192, float(STEPS))
    gh, gw = int((bottom - top) // side) + 1, int((right - left) // side) + 1
    start, order = bucket_sites(sites.x, sites.y, left / STEPS, top / STEPS, side / STEPS, gh, gw)
    first, second = np.empty((h, w), np.int32), np.empty((h, w) if borders else (0, 0), np.int32)
    inside = np.empty((h, w) if borders else (0, 0), np.uint8)
    squares, where = (
        (x[order], y[order], weight[order], start, order, gh, gw),
        (left, top, side, rect.x0, rect.y0),
    )
    blend = float(blend_px) * STEPS
    parallel_rows(
        lambda a, b: _search(squares, where, moved, blend, a, b, (first, second, inside)), h
    )
    return Labels(first, second, inside, len(x))


@numba.njit(cache=True, nogil=True)
def _search(squares, where, moved, blend, ya, yb, out):  # pragma: no cover - compiled
    """Rows ya ... yb - 1. squares : sites (x, y, weight, in order of the squares; start, order as of bucket_sites), rows, columns
    where : corner of the first square, its side, 1/STEPS px; first pixel of the picture;  out : of `Labels`"""
    (sx, sy, weight, start, order, gh, gw), (left, top, side, x0, y0), (first, second, inside) = (
        squares,
        where,
        out,
    )
    for y in range(ya, yb):
        for x in range(first.shape[1]):
            px, py = (x0 + x) * STEPS + moved[0, y, x], (y0 + y) * STEPS + moved[1, y, x]
            row, column = (
                min(max(int((py - top) // side), 0), gh - 1),
                min(max(int((px - left) // side), 0), gw - 1),
            )
            d1, d2, n1, n2, ring = np.inf, np.inf, -1, -1, 0
            # what lies beyond a ring is at least as far as the ring is wide; a weight only adds to it
            while ring <= max(gh, gw) and (ring < 1 or ((ring - 1) * side) ** 2 <= d2):
                for i in range(max(row - ring, 0), min(row + ring, gh - 1) + 1):
                    edge = abs(i - row) == ring
                    for j in range(
                        column - ring, column + ring + 1, 1 if edge or ring == 0 else 2 * ring
                    ):
                        if not 0 <= j < gw:
                            continue
                        for m in range(start[i * gw + j], start[i * gw + j + 1]):
                            d, k = (px - sx[m]) ** 2 + (py - sy[m]) ** 2 - weight[m], order[m]
                            if d < d1 or (d == d1 and k < n1):
                                d1, n1, d2, n2 = d, k, d1, n1
                            elif d < d2 or (d == d2 and k < n2):
                                d2, n2 = d, k
                ring += 1
            first[y, x] = n1
            if blend > 0:
                inset = (
                    (np.sqrt(d2) - np.sqrt(d1)) * (SOLID / (2 * blend)) if n2 >= 0 else float(SOLID)
                )
                inside[y, x] = min(inset, float(SOLID))
                second[y, x] = n2 if inset < SOLID else n1
