"""Decides where to look in each frame, so that a tracked marker costs little and nothing is missed.

* A tracked marker is looked for in its predicted rectangle, among squares not much smaller
  than it was.
* If one is not there, this frame and the next few are searched whole, at full resolution;
  later ones on a reduced image (a hit
  there is looked up at full resolution), and whole at a stated interval.
* While nothing is in view, a frame between two that show nothing on the reduced image is
  not searched: a marker that shows in a
  single frame may be missed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.fold import Stateful
from arfx.analyse.markers.detect import Candidate, MarkerDetector
from arfx.analyse.params import AnalyseParams
from arfx.core.rect import Rect

# while a marker is missing, the whole frame is searched at full resolution at least this often
SEARCH_INTERVAL_S = 1.0
LOSS_SEARCH_FRAMES = 5  # after a loss, so many frames are searched whole at full resolution
# while some markers are tracked and others are missing, the reduced image is searched every
# n-th frame
REDUCED_SEARCH_EVERY = 3
REDUCED_PX = 240_000  # of the reduced image; smaller frames are always searched whole
SHRINK = (
    0.4  # a tracked marker is no smaller than this share of what it was in the last frame
)
# with smaller sides it is a matter of luck, and of what else is in the picture, which
# contour OpenCV takes
SURE_PX = 32.0
_TRUSTED_S = 0.1  # for so long a print moves on as it did
_PAIR_S = 0.3  # longest time between two sightings that tell a speed


@dataclass
class Track:
    """Where a print was last: quad (4, 2), its corners, px or normalised; their speed per
    second; when; and for how many frames it has been missing.
    """

    quad: np.ndarray
    speed: np.ndarray
    time_s: float
    missing: int = 0

    def predicted(self, time_s: float) -> np.ndarray:
        """Its corners at a time; speed is trusted for a tenth of a second only."""
        return self.quad + self.speed * min(max(time_s - self.time_s, 0.0), _TRUSTED_S)

    @property
    def sides(self) -> np.ndarray:
        return np.linalg.norm(self.quad - self.quad[[1, 2, 3, 0]], axis=1)

    def rect(self, time_s: float) -> Rect:
        shift = self.predicted(time_s).mean(0) - self.quad.mean(0)
        spread = max(0.4 * float(self.sides.max()), 20.0) * (
            1 + 0.25 * min(self.missing, 4)
        )
        return Rect.around(self.quad + shift, spread + 0.5 * float(np.abs(shift).max()))


class Tracks(Stateful):
    """State from frame to frame of a search for prints.

    tracks : by key;  frames : seen so far;  last_whole_s : of the last search at full
    resolution
    """

    def __init__(self) -> None:
        self.tracks: dict[str, Track] = {}
        self.frames = 0
        self.last_whole_s = -math.inf

    def led_on(self, other: Tracks, time_s: float) -> bool:
        """Whether `other`, which had seen nothing before, has just seen every print that is
        followed here, where it was expected.
        """
        for key, track in self.tracks.items():
            if track.missing:
                continue
            if (seen := other.tracks.get(key)) is None:
                return False
            away = seen.quad.mean(0) - track.predicted(time_s).mean(0)
            if np.linalg.norm(away) > 0.5 * track.sides.mean():
                return False
        return True

    def lately_lost(self, missing: Iterable[str]) -> bool:
        """Whether one of these was there a few frames ago."""
        return any(
            key in self.tracks and self.tracks[key].missing < LOSS_SEARCH_FRAMES
            for key in missing
        )

    def follow(self, key: str, time_s: float, quad: np.ndarray | None) -> None:
        """quad : where the print is now, None = not there"""
        track = self.tracks.get(key)
        if quad is None:
            if track is not None:
                track.missing += 1
                if time_s - track.time_s > SEARCH_INTERVAL_S:
                    del self.tracks[key]
            return
        speed = np.zeros((4, 2))
        if track is not None and 0 < time_s - track.time_s < _PAIR_S:
            speed = (quad - track.quad) / max(time_s - track.time_s, 1e-3)
        self.tracks[key] = Track(quad, speed, time_s)


@dataclass(frozen=True)
class Found:
    """What one frame gave.

    sightings : the chosen candidate per configured key;  duplicates : further candidates
    with the same key
    others : ids of the families that are not configured;  whole : the whole frame was
    searched at full resolution
    """

    sightings: tuple[Candidate, ...]
    duplicates: tuple[Candidate, ...]
    others: tuple[str, ...]
    whole: bool


class Tracker(Tracks):
    """State from frame to frame of the search for the configured keys ("36h11:3")."""

    given = frozenset({"keys", "params", "detector"})

    def __init__(self, keys: Sequence[str], params: AnalyseParams) -> None:
        super().__init__()
        self.keys = tuple(keys)
        self.params = params
        self.nothing_before, self.nothing_here = (
            False,
            False,
        )  # known of the last frame, and of the one to come
        families = [k.rsplit(":", 1)[0] for k in keys]
        self.detector = MarkerDetector(families, inverted=params.detect_inverted)

    def anew(self) -> Tracker:
        """One that has seen nothing."""
        return Tracker(self.keys, self.params)

    def step(
        self,
        time_s: float,
        luma: np.ndarray,
        following: Callable[[], np.ndarray] | None = None,
    ) -> Found:
        """following : luma of the frame that comes next; None = there is none, or it is not
        known yet
        """
        height, width = luma.shape
        frame = Rect.of(width, height)
        factor = max(1, math.ceil(math.sqrt(frame.area / REDUCED_PX)))
        every: list[Candidate] = []
        whole = False
        followed = list(self.tracks.values())
        sure = all(t.missing == 0 and t.sides.min() >= SURE_PX for t in followed)
        if factor == 1 and (len(followed) < len(self.keys) or not sure):
            # a small frame is searched whole while one is missing, and where that could
            # find other ones
            followed = []
        rects = [t.rect(time_s).clip(frame) for t in followed]
        for part in _merged(rects):
            sides = [
                t.sides.min()
                for t, r in zip(followed, rects, strict=True)
                if not r.clip(part).empty
            ]
            every += self.detector.search(
                luma, part, min_side_px=SHRINK * float(min(sides))
            )
        missing = [k for k in self.keys if k not in {c.key for c in every}]
        nothing_here, self.nothing_here = self.nothing_here, False
        due = time_s - self.last_whole_s >= SEARCH_INTERVAL_S
        if missing and (factor == 1 or due or self.lately_lost(missing)):
            every, whole = self.detector.search(luma), True
            self.last_whole_s = time_s
        elif missing and (
            len(missing) == len(self.keys) or self.frames % REDUCED_SEARCH_EVERY == 0
        ):
            ahead = (
                following
                if self.nothing_before and len(missing) == len(self.keys)
                else None
            )
            hits = (
                [] if nothing_here else self._search_reduced(luma, ahead, factor, missing)
            )
            for part in _merged(
                Rect.around(c.quad_px, max(24.0, 0.5 * c.side_px)).clip(frame) for c in hits
            ):
                every += self.detector.search(luma, part)
        self.frames += 1
        self.nothing_before = not any(c.key in self.keys for c in every)
        return self._choose(time_s, every, whole)

    def _search_reduced(
        self,
        luma: np.ndarray,
        ahead: Callable[[], np.ndarray] | None,
        factor: int,
        keys: Sequence[str],
    ) -> list[Candidate]:
        """Markers on the reduced image. ahead : the next frame, if it may speak for this"""

        def on_reduced(image: np.ndarray) -> list[Candidate]:
            return [c for c in self.detector.search(image, None, factor) if c.key in keys]

        if ahead is None:
            return on_reduced(luma)
        self.nothing_here = not on_reduced(ahead())
        return [] if self.nothing_here else on_reduced(luma)

    def _choose(self, time_s: float, every: list[Candidate], whole: bool) -> Found:
        chosen: list[Candidate] = []
        duplicates: list[Candidate] = []
        for key in self.keys:
            seen: list[Candidate] = []
            # one candidate per place: two within half a side of each other are one print
            for c in every:
                if c.key == key and all(
                    np.linalg.norm(c.quad_px.mean(0) - o.quad_px.mean(0)) > 0.5 * o.side_px
                    for o in seen
                ):
                    seen.append(c)
            if track := self.tracks.get(key):
                # two prints of one id: the one where this marker was expected
                expected = track.predicted(time_s).mean(0)
                seen.sort(key=lambda c: float(np.linalg.norm(c.quad_px.mean(0) - expected)))
            else:
                seen.sort(key=lambda c: -c.side_px)
            chosen += seen[:1]
            duplicates += seen[1:]
            self.follow(key, time_s, seen[0].quad_px if seen else None)
        others = tuple(sorted({c.key for c in every} - set(self.keys)))
        return Found(tuple(chosen), tuple(duplicates), others, whole)


def _merged(rects: Iterable[Rect]) -> list[Rect]:
    """Rectangles with overlapping ones united, so that no marker is reported twice."""
    out: list[Rect] = []
    for r in rects:
        if r.empty:
            continue
        while hit := next((o for o in out if not o.clip(r).empty), None):
            out.remove(hit)
            r = r.union(hit)
        out.append(r)
    return out
