"""Colour of the cells: exact means in linear light, washes that join alike neighbours, tone.

A wash is what a painter lays on in one go: neighbouring cells of nearly one colour. Their colours are drawn together over
the graph of neighbours, with a weight that falls with their difference, so that cells vanish in even areas and stay where
the picture changes. Cost: O(pixels) once for the means, O(cells) after. Source: SYSTEMS.md S3 step 3.
"""

from __future__ import annotations

import numba
import numpy as np

from arfx.stages.watercolor.bands import BANDS, by_bands
from arfx.stages.watercolor.labels import Labels
from arfx.stages.watercolor.rows import Cover, Picture, labels_of, row_of

ROWS = 4  # at a time in `means`
NEIGHBOURS = 12  # of a cell that are kept; a Voronoi cell has 6 on average
_MANY = 8  # below this many pixels per cell, sums over bands would cost more than they save
_FAST = {"contract", "nsz", "arcp"}


def means(image: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32 mean linear RGB of each cell, black for cells without a pixel. Sums are float64.

    image : (h, w, 3) float32;  labels : (h, w) int32, 0 ... count - 1
    """
    whole = Labels(labels, np.zeros((0, 0), np.int32), np.zeros((0, 0), np.uint8), count)
    return means_and_half(Picture(image), Cover(whole), False)[0]


def means_and_half(picture: Picture, cover: Cover, half: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """(means (count, 3) as above, (3, ceil(h / 2), ceil(w / 2)) float32 square roots (near to coded values) of the means of
    2 x 2 pixels, empty where `half` is false): one pass over the picture."""
    h, w = picture.image.shape[:2]
    small = np.empty((3, (h + 1) // 2, (w + 1) // 2) if half else (3, 0, 0), np.float32)
    count = cover.count

    def one(y0: int, y1: int) -> np.ndarray:
        total = np.zeros((count, 4))
        _sum(*picture.parts, *cover.parts, y0, y1, total, small)
        return total

    parts = [one(0, h)] if count * _MANY > h * w else by_bands(one, h, ROWS)
    out = np.empty((count, 3), np.float32)
    if len(parts) == BANDS:
        _mean_of_four(parts[0], parts[1], parts[2], parts[3], out)
    else:
        total = np.sum(parts, axis=0)
        out[:] = total[:, :3] / np.maximum(total[:, 3:], 1)
    return out, small


@numba.njit(cache=True, nogil=True)
def _mean_of_four(a, b, c, d, out):  # pragma: no cover - compiled
    for k in range(out.shape[0]):
        n = max(a[k, 3] + b[k, 3] + c[k, 3] + d[k, 3], 1.0)
        for i in range(3):
            out[k, i] = (a[k, i] + b[k, i] + c[k, i] + d[k, i]) / n


@numba.njit(cache=True, nogil=True)
def _sum(
    image, patch, py, px, first, second, inside, own_first, own_second, own_inside, mask, start, ly, lx, y0, y1, total, small
):  # pragma: no cover
    """total (count, 4) : sums of red, green, blue, pixels over rows y0 ... y1 - 1; ROWS rows in turns, so that the sums of
    one cell are not always waited for."""
    h, w = first.shape
    r, g, b = np.empty((ROWS, w), np.float32), np.empty((ROWS, w), np.float32), np.empty((ROWS, w), np.float32)
    pixel, a = np.empty((ROWS, w, 4)), np.empty((ROWS, w), np.int32)
    for y in range(y0, y1, ROWS):
        rows = min(ROWS, y1 - y)
        for j in range(rows):
            row_of(image, patch, py, px, y + j, r[j], g[j], b[j])
            labels_of(first, own_first, mask, start, ly, lx, y + j, a[j])
            for x in range(w):
                pixel[j, x, 0], pixel[j, x, 1], pixel[j, x, 2], pixel[j, x, 3] = r[j, x], g[j, x], b[j, x], 1.0
        if rows == ROWS:
            for x in range(w):
                for j in range(ROWS):
                    k = np.uint64(a[j, x])
                    for c in range(4):
                        total[k, c] += pixel[j, x, c]
        else:
            for j in range(rows):
                for x in range(w):
                    for c in range(4):
                        total[a[j, x], c] += pixel[j, x, c]
        if small.shape[1] > 0:
            for j in range(0, rows, 2):
                other = min(j + 1, rows - 1)
                for c, p in enumerate((r, g, b)):
                    _halve(p[j], p[other], small[c, (y + j) // 2])


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _halve(top, bottom, out):  # pragma: no cover - compiled
    w = top.shape[0]
    zero, one, quarter = np.float32(0), np.float32(1), np.float32(0.25)
    for i in range(w // 2):
        s = (top[2 * i] + top[2 * i + 1] + bottom[2 * i] + bottom[2 * i + 1]) * quarter
        out[i] = np.sqrt(min(max(s, zero), one))
    if w % 2:
        out[w // 2] = np.sqrt(min(max((top[w - 1] + bottom[w - 1]) * np.float32(0.5), zero), one))


def neighbours(labels: np.ndarray, count: int) -> np.ndarray:
    """(count, NEIGHBOURS) int32 cells that touch each cell, -1 behind the last. Borders shorter than about half a
    cell may be missed."""
    step = int(np.clip(np.round(np.sqrt(labels.size / count) / 2), 1, 8))
    out: np.ndarray = _neighbours(labels, count, step)
    return out


@numba.njit(cache=True, nogil=True)
def _neighbours(labels, count, step):  # pragma: no cover - compiled
    """Looks at every `step`-th row and column: what crosses them."""
    out = np.full((count, NEIGHBOURS), -1, np.int32)
    h, w = labels.shape
    for y in range(0, h, step):
        for x in range(w - 1):
            a, b = labels[y, x], labels[y, x + 1]
            if a != b:
                _join(out, a, b)
        if y + 1 < h:  # along the row, what lies below; a pair once only
            last_a = last_b = -1
            for x in range(0, w, 2):
                a, b = labels[y, x], labels[y + 1, x]
                if a != b and (a != last_a or b != last_b):
                    _join(out, a, b)
                    last_a, last_b = a, b
    return out


@numba.njit(cache=True, nogil=True)
def neighbours_within(labels, mask, count):  # pragma: no cover - compiled
    """The same where both pixels are in the mask (h, w)."""
    out = np.full((count, NEIGHBOURS), -1, np.int32)
    h, w = labels.shape
    for y in range(0, h - 1):
        for x in range(w - 1):
            a = labels[y, x]
            if mask[y, x]:
                if labels[y, x + 1] != a and mask[y, x + 1]:
                    _join(out, a, labels[y, x + 1])
                if labels[y + 1, x] != a and mask[y + 1, x]:
                    _join(out, a, labels[y + 1, x])
    return out


@numba.njit(cache=True, nogil=True, inline="always")
def _join(out, a, b):  # pragma: no cover - compiled
    for m in range(NEIGHBOURS):
        if out[a, m] == b:
            return
        if out[a, m] < 0:
            out[a, m] = b
            break
    for m in range(NEIGHBOURS):
        if out[b, m] == a:
            return
        if out[b, m] < 0:
            out[b, m] = a
            return


def washed(colours: np.ndarray, near: np.ndarray, contrast: float, rounds: int) -> np.ndarray:
    """(n, 3) float32 square roots of the colours (near to what is coded), alike neighbours drawn together.

    colours : (n, 3) linear;  near : of `neighbours`;  contrast : difference of square roots at which the pull has
    fallen to a quarter
    """
    root = np.sqrt(np.clip(colours, 0, 1)).astype(np.float32)
    for _ in range(rounds):
        root = _pull(root, near, np.float32(1 / max(contrast, 1e-3) ** 2))
    return root


@numba.njit(cache=True, nogil=True, fastmath=_FAST)
def _pull(root, near, sharp):  # pragma: no cover - compiled
    out = np.empty_like(root)
    one = np.float32(1)
    for k in range(root.shape[0]):
        r, g, b = root[k, 0], root[k, 1], root[k, 2]
        sr, sg, sb, total = r, g, b, one
        for m in range(NEIGHBOURS):
            j = near[k, m]
            if j < 0:
                break
            dr, dg, db = root[j, 0] - r, root[j, 1] - g, root[j, 2] - b
            w = one / (one + (dr * dr + dg * dg + db * db) * sharp)
            w *= w
            sr += w * root[j, 0]
            sg += w * root[j, 1]
            sb += w * root[j, 2]
            total += w
        out[k, 0], out[k, 1], out[k, 2] = sr / total, sg / total, sb / total
    return out


def toned(root: np.ndarray, lightness: float, saturation: float, deepest: float) -> np.ndarray:
    """(n, 3) float32 square roots of colours, thinner (paper shows through) and more or less saturated.

    lightness : v becomes 1 - (1 - v)^(1 + lightness);  saturation : factor on the distance from grey
    deepest : square root that black becomes: no wash is black
    """
    thin = deepest + (1 - deepest) * (1 - (1 - root) ** (1 + lightness))
    grey = thin @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    out: np.ndarray = np.clip(grey[:, None] + saturation * (thin - grey[:, None]), 0, 1).astype(np.float32)
    return out
