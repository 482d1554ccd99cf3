"""Colour of the cells: exact means in linear light, washes that join alike neighbours, tone.

A wash is what a painter lays on in one go: neighbouring cells of nearly one colour. Their colours are drawn together over
the graph of neighbours, with a weight that falls with their difference, so that cells vanish in even areas and stay where
the picture changes. Cost: O(pixels) once for the means, O(cells) after. Source: SYSTEMS.md S3 step 3.
"""

from __future__ import annotations

import numba
import numpy as np

from arfx.stages.watercolor.bands import by_bands

NEIGHBOURS = 12  # of a cell that are kept; a Voronoi cell has 6 on average
_MANY = 8  # below this many pixels per cell, sums over bands would cost more than they save
_FAST = {"contract", "nsz", "arcp"}


def means(image: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32 mean linear RGB of each cell, black for cells without a pixel. Sums are float64.

    image : (h, w, 3) float32;  labels : (h, w) int32, 0 ... count - 1
    """
    h, w = labels.shape

    def one(y0: int, y1: int) -> np.ndarray:
        total = np.zeros((count, 4))
        _sum(image, labels, y0, y1, total)
        return total

    parts = [one(0, h)] if count * _MANY > h * w else by_bands(one, h)
    sums = parts[0]
    for part in parts[1:]:
        sums = sums + part
    out: np.ndarray = (sums[:, :3] / np.maximum(sums[:, 3:], 1)).astype(np.float32)
    return out


@numba.njit(cache=True, nogil=True)
def _sum(image, labels, y0, y1, total):  # pragma: no cover - compiled
    """total (count, 4) : sums of red, green, blue, pixels over rows y0 ... y1 - 1."""
    for y in range(y0, y1):
        r = g = b = n = 0.0
        at = labels[y, 0]
        for x in range(labels.shape[1]):
            k = labels[y, x]
            if k != at:  # a run of pixels of one cell is summed before it is stored
                total[at, 0] += r
                total[at, 1] += g
                total[at, 2] += b
                total[at, 3] += n
                r = g = b = n = 0.0
                at = k
            r += image[y, x, 0]
            g += image[y, x, 1]
            b += image[y, x, 2]
            n += 1.0
        total[at, 0] += r
        total[at, 1] += g
        total[at, 2] += b
        total[at, 3] += n


def neighbours(labels: np.ndarray, count: int) -> np.ndarray:
    """(count, NEIGHBOURS) int32 cells that touch each cell, -1 behind the last. Borders shorter than about a third of a
    cell may be missed."""
    step = int(np.clip(np.sqrt(labels.size / count) / 2.5, 1, 8))
    out: np.ndarray = _neighbours(labels, count, step)
    return out


@numba.njit(cache=True, nogil=True)
def _neighbours(labels, count, step):  # pragma: no cover - compiled
    """Looks at every `step`-th row."""
    out = np.full((count, NEIGHBOURS), -1, np.int32)
    h, w = labels.shape
    for y in range(0, h, step):
        for x in range(w):
            a = labels[y, x]
            if x + 1 < w and labels[y, x + 1] != a:
                _join(out, a, labels[y, x + 1])
            if y + 1 < h and labels[y + 1, x] != a:
                _join(out, a, labels[y + 1, x])
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
