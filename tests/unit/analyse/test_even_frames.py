"""Frames are looked at evenly over a clip, whatever its times are and wherever it is cut."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.even_frames import EvenFrames


def looked_at(times_s: np.ndarray, first: int = 0, most: int = 240) -> list[int]:
    even = EvenFrames(len(times_s), most, 0.5)
    frames = range(first, len(times_s))
    return [k for k in frames if even.due(k, float(times_s[k]))]


def test_a_short_clip_is_looked_at_every_half_second() -> None:
    assert looked_at(np.arange(90) / 30) == [*range(0, 90, 15)]


@pytest.mark.parametrize("late_s", [0.0, 3600.0, 86400.0])
def test_a_frame_long_after_the_others_takes_none_of_their_looks(
    late_s: float,
) -> None:
    times = np.append(np.arange(1800) / 30, 60 + late_s)
    assert 100 < len(looked_at(times)) <= 121


@pytest.mark.parametrize("frames", [3_000, 100_000])
def test_a_long_clip_is_looked_at_about_so_often(frames: int) -> None:
    for rate in (1, 30):
        every = looked_at(np.arange(frames) / rate)
        assert 90 < len(every) <= 241 and np.ptp(np.diff(every)) <= 1


def test_a_part_of_a_long_clip_is_looked_at_where_the_whole_is() -> None:
    times = np.arange(100_000) / 30
    assert {*looked_at(times, 50_000)} == {k for k in looked_at(times) if k >= 50_000}
