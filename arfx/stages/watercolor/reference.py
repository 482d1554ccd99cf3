"""Cells by brute force: every site asks every pixel, float64, no code shared with the kernels. Slow; the yardstick for them."""

from __future__ import annotations

import numpy as np

_AT_ONCE = 1 << 22  # distances in memory at a time


def nearest_labels(
    x_px: np.ndarray, y_px: np.ndarray, weight_px2: np.ndarray, px: np.ndarray, py: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(first, second) (n,) int32: of the sites (k,), the nearest to the places (n,) and the next, by |p - s|^2 - weight.

    Of equal distances the lower number wins.
    """
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


def cell_means(image: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float64 mean colour of each label's pixels; zero where it has none. image : (h, w, 3)."""
    flat = labels.ravel()
    number = np.bincount(flat, minlength=count)
    sums = np.stack([np.bincount(flat, image[..., c].ravel().astype(np.float64), count) for c in range(3)], -1)
    means: np.ndarray = sums / np.maximum(number, 1)[:, None]
    return means
