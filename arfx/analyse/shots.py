"""Cuts: where one frame has nothing to do with the one before it.

Each frame leaves two numbers behind, from thumbnails normalised for brightness and contrast (so that a flash or a
change of exposure is no cut): its unlikeness to the frame before and to the one before that. A cut is unlike both,
alone among its neighbours (a whip pan is unlike for many frames), and no marker was followed across it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from arfx.analyse.fold import Fold
from arfx.core.numerics import divide

THUMBNAIL = (32, 18)
UNLIKE = 0.45  # 1 - correlation of thumbnails; hand-held clips stay below .1, unrelated pictures lie around 1
_STANDS_OUT = 3.0
_CALM = 0.6  # of a cut's unlikeness: on one side of it at least, frames follow each other with less


class CutSignal(Fold):
    """Unlikeness of successive frames, 0 (same up to brightness and contrast) to 2."""

    def __init__(self) -> None:
        self._last: list[np.ndarray] = []

    def step(self, luma: np.ndarray) -> tuple[float, float]:
        """To the frame before, and to the one before that; 0 where there is none. luma : (h, w) uint8."""
        step = max(1, min(luma.shape[0] // (4 * THUMBNAIL[1]), luma.shape[1] // (4 * THUMBNAIL[0])))
        thin = np.ascontiguousarray(luma[::step, ::step])
        thumb = cv2.resize(thin, THUMBNAIL, interpolation=cv2.INTER_AREA)
        values = [unlikeness(thumb, old) for old in reversed(self._last)]
        self._last = [*self._last, thumb][-2:]
        first, second = [*values, 0.0, 0.0][:2]
        return first, second


def unlikeness(a: np.ndarray, b: np.ndarray) -> float:
    """1 - correlation of two pictures of one size; flat pictures are compared by their level alone."""
    x, y = a.ravel().astype(float), b.ravel().astype(float)
    level_x, level_y = float(x.mean()), float(y.mean())
    x -= level_x
    y -= level_y
    sx, sy = math.sqrt(x @ x / x.size), math.sqrt(y @ y / y.size)
    if sx < 2.0 or sy < 2.0:  # less contrast than noise: no structure to compare
        return 0.0 if sx < 2.0 and sy < 2.0 and abs(level_x - level_y) < 20 else float(sx > 8.0 or sy > 8.0)
    return 1.0 - float(divide(x @ y / x.size, sx * sy))


def find_cuts(before: Sequence[float], before_last: Sequence[float], followed: Sequence[bool]) -> list[int]:
    """Frames that begin a new shot.

    before, before_last : CutSignal of every frame;  followed : a marker moved on smoothly from the frame before
    """
    cuts = []
    n = len(before)
    for k in range(1, n):
        if before[k] < UNLIKE or followed[k]:
            continue
        if k + 1 < n and before_last[k + 1] < UNLIKE / 2:
            continue  # the next frame is like the last one: a flash, or one broken frame
        if k >= 2 and before_last[k] < UNLIKE / 2:
            continue  # back from such a frame
        near = [before[i] for i in range(max(1, k - 4), min(n, k + 5)) if i != k]
        if near and before[k] < _STANDS_OUT * float(np.median(near)):
            continue
        beside = [before[i] for i in (k - 1, k + 1) if 1 <= i < n]
        if beside and min(beside) > _CALM * before[k]:
            continue  # the midst of a quick move
        cuts.append(k)
    return cuts
