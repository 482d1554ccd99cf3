"""When the object is there: measured frames, bridged gaps, absence and the fades at its ends; and where a new shot begins.

Source: docs/methods/pose.md#presence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from arfx.analyse.fold import Stateful
from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED
from arfx.core.numerics import divide

MIN_FRAMES = 3
THUMBNAIL = (32, 18)
UNLIKE = 0.45  # 1 - correlation of thumbnails; hand-held clips stay below .1, unrelated pictures lie around 1
_STANDS_OUT = 3.0
_CALM = 0.6  # of a cut's unlikeness: on one side of it at least, frames follow each other with less


def stretches(measured: np.ndarray, shot: np.ndarray, times_s: np.ndarray, max_gap_s: float) -> list[tuple[int, int]]:
    """Half-open ranges of frames in which the object is present: from one measured frame to another of the same shot,
    with no gap between two measured frames longer than max_gap_s beyond the clip's own frame distance."""
    out: list[tuple[int, int]] = []
    last: int | None = None
    for k in np.flatnonzero(measured):
        bridged = last is not None and shot[last] == shot[k] and (k == last + 1 or times_s[k] - times_s[last] <= max_gap_s)
        if bridged:
            out[-1] = (out[-1][0], int(k) + 1)
        else:
            out.append((int(k), int(k) + 1))
        last = int(k)
    return out


def lasting(present: Sequence[tuple[int, int]], measured: np.ndarray, shot: np.ndarray) -> list[tuple[int, int]]:
    """The stretches without flickers: fewer than MIN_FRAMES measured frames with absence of the same shot on both sides.

    A square of texture that is misread as a marker lasts for a frame or two; an object that appears for as long would
    only flash.
    """
    n = len(measured)

    def flicker(first: int, end: int) -> bool:
        alone = first > 0 and end < n and shot[first - 1] == shot[first] and shot[end] == shot[end - 1]
        return alone and int(measured[first:end].sum()) < MIN_FRAMES

    return [p for p in present if not flicker(*p)]


def statuses(measured: np.ndarray, present: Sequence[tuple[int, int]]) -> list[str]:
    """Status of every frame."""
    out = [ABSENT] * len(measured)
    for first, end in present:
        out[first:end] = [MEASURED if measured[k] else INTERPOLATED for k in range(first, end)]
    return out


def opacities(present: Sequence[tuple[int, int]], shot: np.ndarray, fade_frames: int) -> np.ndarray:
    """(n,) 0..1: 1 inside a stretch, ramping over its first and last frames where an absence follows in the same shot.

    At the ends of the clip and at cuts the object is there at once: nothing was absent before.
    """
    n = len(shot)
    out = np.zeros(n)
    for first, end in present:
        k = np.arange(first, end)
        level = np.ones(end - first)
        if first > 0 and shot[first - 1] == shot[first]:
            level = np.minimum(level, (k - first + 1) / (fade_frames + 1))
        if end < n and shot[end] == shot[end - 1]:
            level = np.minimum(level, (end - k) / (fade_frames + 1))
        out[first:end] = level
    return out


class CutSignal(Stateful):
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
