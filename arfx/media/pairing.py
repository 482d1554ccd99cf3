"""Which of the things that were recorded beside a clip (depth maps, poses) belongs to which of its frames."""

from __future__ import annotations

import numpy as np

from arfx.errors import InputError

_NEAR_SHARE = 0.75  # a frame takes what is at most this share of the things' usual distance in time away


def by_time(taken_s: np.ndarray, times_s: list[float]) -> list[int | None]:
    """Number of what was taken nearest to each frame, None where nothing was taken near it. taken_s : rising"""
    if len(taken_s) == 1:
        return [0] * len(times_s)
    reach = _NEAR_SHARE * float(np.median(np.diff(taken_s)))
    times = np.asarray(times_s, float)
    after = np.clip(np.searchsorted(taken_s, times), 1, len(taken_s) - 1)
    nearest = after - (times - taken_s[after - 1] <= taken_s[after] - times)
    return [int(k) if abs(taken_s[k] - t) <= reach else None for k, t in zip(nearest, times, strict=True)]


def in_order(what: str, held: int, frames: int, before: int, whole: bool, hint: str) -> list[int | None]:
    """One thing for each frame of the clip. before : frames of the clip before these;  whole : these reach to its end

    Raises InputError where their number is not the clip's. what : for the message, "depth X holds 4 maps"
    """
    wanted = before + frames
    if held < wanted or (whole and held > wanted):
        raise InputError(f"{what}, the clip has {'' if whole else 'at least '}{wanted} frames", hint)
    return list(range(before, wanted))
