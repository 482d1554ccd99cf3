"""When the object is there: measured frames, bridged gaps, absence and the fades at its ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arfx.core.facts import ABSENT, INTERPOLATED, MEASURED

MIN_FRAMES = 3


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
