"""How many samples a pixel of the reference gets: until the noise that is left does not show.

The noise is estimated for each pixel from the spread of batches of its own samples, so that it counts what even sampling gains,
and does not depend on what else is rendered. Where `gi.samples` run out first more is left: of 64, up to 1.7 grey levels.
Source: adaptive sampling, Pharr, Jakob, Humphreys; batch means."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

BATCH_SAMPLES, LEAST_BATCHES = 4, 4
NOISE = 0.5  # grey levels: standard deviation at which a pixel's samples end


def settled(
    draw: Callable[[np.ndarray, int], np.ndarray],
    noticed: Callable[[np.ndarray, np.ndarray], np.ndarray],
    most: np.ndarray,
    width: int = 3,
) -> np.ndarray:
    """(n, width) means of at most so many samples (n,), fewer where the noise that is left is below NOISE grey levels.

    draw : sample s of some rows, (m, width);  noticed : what of such values of some rows shows, (m, 3) in grey levels
    The noise is estimated from the spread of batches, so that it counts what even sampling gains."""
    count, rows = len(most), np.arange(len(most))
    out, taken, shown, squares = (
        np.zeros((count, width)),
        np.zeros((count, 1)),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
    )
    for first in range(0, int(most.max(initial=0)), BATCH_SAMPLES):
        before = out[rows]
        for s in range(first, first + BATCH_SAMPLES):
            more = rows[most[rows] > s]
            if len(more):
                out[more] += draw(more, s)
                taken[more] += 1
        here = noticed((out[rows] - before) / BATCH_SAMPLES, rows)
        shown[rows] += here
        squares[rows] += here**2
        batches = first // BATCH_SAMPLES + 1
        unsettled = most[rows] > first + BATCH_SAMPLES
        if batches >= LEAST_BATCHES:
            spread = (squares[rows] - shown[rows] ** 2 / batches).max(1) / (batches - 1)
            unsettled &= spread > batches * NOISE**2
        rows = rows[unsettled]
    return out / taken


def grey_slope(radiance: np.ndarray) -> np.ndarray:
    """Grey levels per unit of linear light at such light: of sRGB."""
    return np.asarray(255 * 1.055 / 2.4 * np.clip(radiance, 0.0031308, 1) ** (1 / 2.4 - 1))
