"""Follows prints from frame to frame, and decides when to search for those that are missing.

A print that was seen is looked for where its motion leads. While one is missing, the whole
frame is searched at full resolution at a stated interval, and in between reduced: in every
few frames, and in those after a loss. Of two prints of one key the one nearest to where it
was expected is followed, at first the larger one.

While no coded print is in view, a frame between two that show none on the reduced image is
not searched: a marker that shows in a single frame may be missed."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.detect import Candidate, Detection, MarkerDetector, sides
from arfx.analyse.markers.pattern import PatternPicture, frame_features, homography_of
from arfx.core.camera import Camera
from arfx.core.rect import Rect

# while a print is missing, the whole frame is searched at full resolution at least this often
SEARCH_INTERVAL_S = 1.0
LOSS_SEARCH_FRAMES = 5  # after a loss, so many frames are searched
REDUCED_SEARCH_EVERY = (
    3  # while some prints are missing, each such frame is searched reduced
)
REDUCED_PX = 240_000  # of the reduced image; smaller frames are searched as they are
# a tracked marker is no smaller than this share of what it was in the last frame
SHRINK = 0.4
# with smaller sides it is a matter of luck, and of what else is in the picture, which
# contour OpenCV takes
SURE_PX = 32.0
# of a frame that is searched for pictures at full resolution; larger ones are reduced to so
# many
WHOLE_PX = 2.1e6
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


class Tracker(ABC):
    """Of prints of one kind, fed the frames of a stretch in order.

    keys : the configured ones;  tracks : by key;  quick : a whole frame is searched in a few
    milliseconds, so that this may be done often
    """

    quick = True

    def __init__(self, keys: Iterable[str]) -> None:
        self.keys = tuple(keys)
        self.tracks: dict[str, Track] = {}
        self._frames = 0
        self._last_whole_s = -math.inf

    @abstractmethod
    def follow(self, frame: AnalysisFrame) -> list[Any]:
        """Candidates or Detections of prints near where they were."""

    @abstractmethod
    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Any]:
        """Prints anywhere. missing : what is looked for;  whole : at full resolution"""

    def search(self, frame: AnalysisFrame) -> tuple[list[Any], list[str]]:
        """What the next frame shows of the configured prints: the chosen one per key, and the
        keys of which there are further ones."""
        quick, keys = self.quick, self.keys
        seen = self.follow(frame)
        followed = {s.key for s in seen}
        missing = [k for k in keys if k not in followed]
        due = frame.time_s - self._last_whole_s >= SEARCH_INTERVAL_S
        lost = any(
            track.missing < LOSS_SEARCH_FRAMES
            for key, track in self.tracks.items()
            if key in missing
        )
        now_and_then = self._frames % REDUCED_SEARCH_EVERY == 0
        small = frame.luma.size <= REDUCED_PX
        whole = bool(missing) and (due or (quick and (lost or small)))
        none_in_view = quick and len(missing) == len(keys)
        if missing and (whole or lost or now_and_then or none_in_view):
            seen = seen + self.find(frame, missing, whole)
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


class CodedPrints(Tracker):
    """Searched where they may be: in the predicted rectangles of those that were seen, on a
    reduced image (a hit there is looked up at full resolution), or in the whole frame.
    keys : as "36h11:3"
    """

    def __init__(self, keys: Sequence[str], detect_inverted: bool = True) -> None:
        super().__init__(keys)
        families = [*dict.fromkeys(k.rpartition(":")[0] for k in keys)]
        self.detector = MarkerDetector(families, inverted=detect_inverted)
        self._empty = -1  # number of a frame whose reduced image shows none

    def follow(self, frame: AnalysisFrame) -> list[Candidate]:
        """Nothing of a small frame in which a whole search could find more."""
        tracks = list(self.tracks.values())
        sure = all(t.missing == 0 and sides(t.quad).min() >= SURE_PX for t in tracks)
        if frame.luma.size <= REDUCED_PX and not (
            sure and len(tracks) == len(self.keys)
        ):
            return []
        rects = [_rect(t, frame.time_s) for t in tracks]
        smallest = min((sides(t.quad).min() for t in tracks), default=0.0)
        return self._in_parts(frame.luma, rects, SHRINK * smallest)

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Candidate]:
        luma = frame.luma
        if whole:
            return self.detector.search(luma)
        if frame.index == self._empty:
            return []
        ahead = frame.following if len(missing) == len(self.keys) else None
        if ahead is not None and not self._on_reduced(ahead(), missing):
            self._empty = frame.index + 1
            return []
        hits = self._on_reduced(luma, missing)
        rects = [Rect.around(c.quad_px, max(24.0, 0.5 * c.side_px)) for c in hits]
        return self._in_parts(luma, rects)

    def _in_parts(
        self, luma: ndarray, rects: Iterable[Rect], least_px: float = 0.0
    ) -> list[Candidate]:
        return [
            c
            for part in _merged(rects)
            for c in self.detector.search(luma, part, min_side_px=least_px)
        ]

    def _on_reduced(self, luma: ndarray, keys: Sequence[str]) -> list[Candidate]:
        factor = max(1, math.ceil(math.sqrt(luma.size / REDUCED_PX)))
        return [c for c in self.detector.search(luma, None, factor) if c.key in keys]


def _rect(track: Track, time_s: float) -> Rect:
    """Where a marker may be."""
    shift = track.predicted(time_s).mean(0) - track.quad.mean(0)
    spread = max(0.4 * sides(track.quad).max(), 20.0) * (
        1 + 0.25 * min(track.missing, 4)
    )
    return Rect.around(track.quad + shift, spread + 0.5 * float(np.abs(shift).max()))


def _merged(rects: Iterable[Rect]) -> list[Rect]:
    """Overlapping ones united, so that no marker is reported twice."""
    out: list[Rect] = []
    for r in rects:
        while hit := next((o for o in out if not o.clip(r).empty), None):
            out.remove(hit)
            r = r.union(hit)
        out.append(r)
    return out


class PicturedPrints(Tracker):
    """Known by their pictures: aligned from where they were expected, else from where they
    were, or found by their features. camera : for the clip's size or the same aspect"""

    quick = False

    def __init__(self, pictures: Sequence[PatternPicture], camera: Camera) -> None:
        super().__init__(p.name for p in pictures)
        self._pictures = tuple(pictures)
        self._camera = camera

    def follow(self, frame: AnalysisFrame) -> list[Detection]:
        self._camera = camera = self._camera.scaled_to(*frame.luma.shape[::-1])
        seen = list[Detection]()
        for picture in self._pictures:
            if track := self.tracks.get(picture.name):
                quads = track.predicted(frame.time_s), track.quad
                abouts = (homography_of(camera.normalised(quad)) for quad in quads)
                seen += picture.align(frame.luma, camera, abouts)
        return seen

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Detection]:
        camera = self._camera
        features = frame_features(frame.luma, WHOLE_PX if whole else REDUCED_PX)
        seen = list[Detection]()
        for picture in self._pictures:
            if picture.name in missing:
                abouts = picture.find(features, camera)
                seen += picture.align(frame.luma, camera, abouts)
        return seen
