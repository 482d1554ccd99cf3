"""Follows prints from frame to frame, and decides when to search for those that are missing.

A print that was seen is looked for where its motion leads. While one is missing, the whole
frame is searched at full resolution at a stated interval, and in between reduced: in every
few frames, and in those after a loss. Of two prints of one key the one nearest to where it
was expected is followed, at first the larger one."""

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


class Found(NamedTuple):
    """What one frame gave.

    sightings : the chosen one per configured key;  duplicates : further ones with the same key
    others : keys that are not configured;  whole : the whole frame was searched at full
    resolution
    """

    sightings: list[Any]
    duplicates: list[Any]
    others: list[str]
    whole: bool


class Tracker:
    """Fed the frames of a stretch in order. tracks : by key"""

    def __init__(self, prints: Prints) -> None:
        self.prints = prints
        self.tracks: dict[str, Track] = {}
        self._frames = 0
        self._last_whole_s = -math.inf

    def search(self, frame: AnalysisFrame) -> Found:
        """What the next frame shows."""
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
        return self._chosen(frame.time_s, seen, whole)

    def _chosen(self, time_s: float, seen: Sequence[Any], whole: bool) -> Found:
        chosen, duplicates = list[Any](), list[Any]()
        for key in self.prints.keys:
            prints = list[Any]()
            # one sighting per place: two within half a side of each other are one print
            for s in seen:
                if s.key == key and all(
                    _apart(s, o.quad_px) > 0.5 * o.side_px for o in prints
                ):
                    prints.append(s)
            track, speed = self.tracks.get(key), np.zeros((4, 2))
            if track:
                expected = track.predicted(time_s)
                prints.sort(key=lambda s: _apart(s, expected))
            else:
                prints.sort(key=lambda s: -s.side_px)
            chosen += prints[:1]
            duplicates += prints[1:]
            since_s = time_s - track.time_s if track else 0.0
            if prints:
                quad = prints[0].quad_px
                if track and 0 < since_s < _PAIR_S:
                    speed = (quad - track.quad) / max(since_s, 1e-3)
                self.tracks[key] = Track(quad, speed, time_s)
            elif since_s > SEARCH_INTERVAL_S:
                del self.tracks[key]
            elif track:
                self.tracks[key] = track._replace(missing=track.missing + 1)
        others = sorted({s.key for s in seen} - set(self.prints.keys))
        return Found(chosen, duplicates, others, whole)


def _apart(seen: Any, quad: ndarray) -> float:
    """From the middle of a print that was seen to that of a quad (4, 2), px."""
    return math.dist(seen.quad_px.mean(0), quad.mean(0))
