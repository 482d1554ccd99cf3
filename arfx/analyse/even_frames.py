"""Some of a clip's frames, evenly over all of them."""

import math


class EvenFrames:
    """Which frames are looked at, the same whatever part of the clip is seen, but for the first
    ones of a part. frames : of the clip, about;  most : to look at, about;  apart_s : at
    least, between two. Frames count, not time: a clip may stand still for days."""

    def __init__(self, frames: int, most: int, apart_s: float) -> None:
        self._every, self._apart_s = max(math.ceil(frames / most), 1), apart_s
        self._next, self._next_s = -1, -math.inf

    def due(self, index: int, time_s: float) -> bool:
        """Frames are asked for in order."""
        if self._next < 0:
            self._next = math.ceil(index / self._every) * self._every
        if index < self._next or time_s < self._next_s:
            return False
        self._next, self._next_s = index + self._every, time_s + self._apart_s
        return True
