"""Follows prints from frame to frame, and decides when to search for those that are missing.

A print that was seen is looked for where its motion leads. While one is missing, the whole
frame is searched at full resolution at a stated interval, and in between reduced: in every
few frames, and in those after a loss. Of two prints of one key the one nearest to where it
was expected is followed, at first the larger one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame

# while a print is missing, the whole frame is searched at full resolution at least this often
SEARCH_INTERVAL_S = 1.0
LOSS_SEARCH_FRAMES = 5  # after a loss, so many frames are searched
REDUCED_SEARCH_EVERY = (
    3  # while some prints are missing, each such frame is searched reduced
)
REDUCED_PX = 240_000  # of the reduced image; smaller frames are searched as they are
_TRUSTED_S = 0.1  # for so long a print moves on as it did
_PAIR_S = 0.3  # longest time between two sightings that tell a speed


class Track(NamedTuple):
    """Where a print was last: quad (4, 2), its corners px; their speed per second; when;
    and for how many frames it has been missing."""

    quad: ndarray
    speed: ndarray
    time_s: float
    missing: int = 0

    def predicted(self, time_s: float) -> ndarray:
        """Its corners at a time; speed is trusted for a tenth of a second only."""
        return self.quad + self.speed * min(
            max(time_s - self.time_s, 0.0), _TRUSTED_S
        )


class Prints(Protocol):
    """The prints of one kind that are looked for.

    keys : the configured ones;  quick : a whole frame is searched in a few milliseconds, so
    that this may be done often
    """

    keys: Sequence[str]
    quick: bool

    def follow(self, frame: AnalysisFrame, last: Mapping[str, Track]) -> list[Any]:
        """Candidates or Detections of prints near where they were. last : by key"""

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Any]:
        """Sightings anywhere. missing : what is looked for;  whole : at full resolution"""


class Tracker:
    """Fed the frames of a stretch in order. tracks : by key"""

    def __init__(self, prints: Prints) -> None:
        self.prints = prints
        self.tracks: dict[str, Track] = {}
        self._frames = 0
        self._last_whole_s = -math.inf

    def search(self, frame: AnalysisFrame) -> tuple[list[Any], list[str]]:
        """What the next frame shows of the configured prints: the chosen one per key, and the
        keys of which there are further ones."""
        quick, keys = self.prints.quick, self.prints.keys
        seen = self.prints.follow(frame, self.tracks)
        followed = {s.key for s in seen}
        missing = [k for k in keys if k not in followed]
        due = frame.time_s - self._last_whole_s >= SEARCH_INTERVAL_S
        lost = any(
            k in self.tracks and self.tracks[k].missing < LOSS_SEARCH_FRAMES
            for k in missing
        )
        now_and_then = self._frames % REDUCED_SEARCH_EVERY == 0
        small = frame.luma.size <= REDUCED_PX
        whole = bool(missing) and (due or (quick and (lost or small)))
        none_in_view = quick and len(missing) == len(keys)
        if missing and (whole or lost or now_and_then or none_in_view):
            seen = seen + self.prints.find(frame, missing, whole)
        if whole:
            self._last_whole_s = frame.time_s
        self._frames += 1
        chosen, twice = list[Any](), list[str]()
        for key in keys:
            prints = [s for s in seen if s.key == key]
            track = self.tracks.get(key)
            if prints:
                best = _best(prints, track, frame.time_s)
                chosen.append(best)
                self.tracks[key] = _track(best.quad_px, track, frame.time_s)
                # two within half a side of each other are one print
                if any(_apart(s, best.quad_px) > 0.5 * best.side_px for s in prints):
                    twice.append(key)
            elif track and frame.time_s - track.time_s > SEARCH_INTERVAL_S:
                del self.tracks[key]
            elif track:
                self.tracks[key] = track._replace(missing=track.missing + 1)
        return chosen, twice


def _best(prints: Sequence[Any], track: Track | None, time_s: float) -> Any:
    if track is None:
        return max(prints, key=lambda s: s.side_px)
    expected = track.predicted(time_s)
    return min(prints, key=lambda s: _apart(s, expected))


def _track(quad: ndarray, before: Track | None, time_s: float) -> Track:
    speed = np.zeros((4, 2))
    if before and 0 < time_s - before.time_s < _PAIR_S:
        speed = (quad - before.quad) / max(time_s - before.time_s, 1e-3)
    return Track(quad, speed, time_s)


def _apart(seen: Any, quad: ndarray) -> float:
    """From the middle of a print that was seen to that of a quad (4, 2), px."""
    return math.dist(seen.quad_px.mean(0), quad.mean(0))
