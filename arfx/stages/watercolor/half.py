"""The level draft paints at half the size: the picture and sites there, and lines back from there.

A pixel of it stands for 2 x 2 of the picture, whose last row and column count twice where they are odd. Cost: O(pixels)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.stages.watercolor.sites import STEPS, Sites

_U, _F = np.uint64, np.float32


def halved(image: np.ndarray) -> np.ndarray:
    """(h, w, 3) float32 to (ceil(h / 2), ceil(w / 2), 3), means of 2 x 2 pixels; read-only."""
    image = np.ascontiguousarray(image)
    h, w = ((n + 1) // 2 for n in image.shape[:2])
    out = np.empty((h, w, 3), np.float32)
    parallel_rows(lambda a, b: _halve_rows(image, a, b, out), h)
    out.setflags(write=False)
    return out


@numba.njit(cache=True, nogil=True)
def _halve_rows(image, ya, yb, out):  # pragma: no cover - compiled
    last, wide, quarter = image.shape[0] - 1, image.shape[1] // 2, _F(0.25)
    for y in range(ya, yb):
        top, bottom, to = (
            image[2 * y].reshape(-1),
            image[min(2 * y + 1, last)].reshape(-1),
            out[y].reshape(-1),
        )
        for x in range(wide):
            i, j = _U(6) * _U(x), _U(3) * _U(x)
            for c in range(3):
                k = _U(c)
                to[j + k] = quarter * (
                    (top[i + k] + top[i + k + _U(3)]) + (bottom[i + k] + bottom[i + k + _U(3)])
                )
        if image.shape[1] % 2:
            for c in range(3):
                to[3 * wide + c] = _F(0.5) * (top[6 * wide + c] + bottom[6 * wide + c])


def half_rect(rect: Rect) -> Rect:
    """Its pixels, counted from its own corner."""
    return Rect.of((rect.width + 1) // 2, (rect.height + 1) // 2)


def halve_sites(sites: Sites, rect: Rect) -> Sites:
    """In 1/STEPS of the pixels of `half_rect`."""
    x, y = (
        np.rint((a - STEPS * first - STEPS // 2) / 2).astype(
            np.float32
        )  # a pixel lies in the middle of 2 x 2
        for a, first in ((sites.x, rect.x0), (sites.y, rect.y0))
    )
    return replace(sites, x=x, y=y, weight=np.rint(sites.weight / 4).astype(np.float32))


def double_lines(line: np.ndarray, height: int, width: int) -> np.ndarray:
    """(height, width) of lines on a grid that is twice as coarse."""
    if not line.size:
        return line
    h, w = line.shape
    return np.ascontiguousarray(
        cv2.resize(line, (2 * w, 2 * h), interpolation=cv2.INTER_LINEAR)[:height, :width]
    )
