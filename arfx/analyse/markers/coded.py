"""Coded markers in a frame, searched where they may be: in the predicted rectangles of those
that were seen, on a reduced image (a hit there is looked up at full resolution), or in the
whole frame.

While nothing is in view, a frame between two that show nothing on the reduced image is not
searched: a marker that shows in a single frame may be missed."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.detect import Candidate, MarkerDetector, sides
from arfx.analyse.markers.tracker import REDUCED_PX, Track
from arfx.core.rect import Rect

# a tracked marker is no smaller than this share of what it was in the last frame
SHRINK = 0.4
# with smaller sides it is a matter of luck, and of what else is in the picture, which
# contour OpenCV takes
SURE_PX = 32.0


class CodedPrints:
    """The search for the configured keys ("36h11:3")."""

    quick = True

    def __init__(self, keys: Sequence[str], detect_inverted: bool = True) -> None:
        self.keys: Sequence[str] = tuple(keys)
        families = [k.rpartition(":")[0] for k in keys]
        self.detector = MarkerDetector(families, inverted=detect_inverted)
        self._in_view = False  # in the frame before
        self._empty = -1  # number of a frame whose reduced image shows none

    def follow(
        self, frame: AnalysisFrame, last: Mapping[str, Track]
    ) -> list[Candidate]:
        """Nothing of a small frame in which a whole search could find more."""
        tracks = list(last.values())
        self._in_view = any(t.missing == 0 for t in tracks)
        sure = all(t.missing == 0 and sides(t.quad).min() >= SURE_PX for t in tracks)
        if frame.luma.size <= REDUCED_PX and not (
            sure and len(tracks) == len(self.keys)
        ):
            return []
        luma = frame.luma
        rects = [_rect(t, frame.time_s) for t in tracks]
        seen = list[Candidate]()
        for part in _merged(rects, luma):
            near = [
                t
                for t, r in zip(tracks, rects, strict=True)
                if not r.clip(part).empty
            ]
            least_px = SHRINK * min(sides(t.quad).min() for t in near)
            seen += self.detector.search(luma, part, min_side_px=least_px)
        return seen

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Candidate]:
        luma = frame.luma
        if whole:
            return self.detector.search(luma)
        if frame.index == self._empty:
            return []
        none_in_view = not self._in_view and len(missing) == len(self.keys)
        ahead = frame.following if none_in_view else None
        if ahead is not None and not self._on_reduced(ahead(), missing):
            self._empty = frame.index + 1
            return []
        hits = self._on_reduced(luma, missing)
        rects = [Rect.around(c.quad_px, max(24.0, 0.5 * c.side_px)) for c in hits]
        return [
            c
            for part in _merged(rects, luma)
            for c in self.detector.search(luma, part)
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


def _merged(rects: Iterable[Rect], luma: ndarray) -> list[Rect]:
    """The parts of rectangles within the picture, overlapping ones united, so that no marker
    is reported twice."""
    whole = Rect.of(luma.shape[1], luma.shape[0])
    out: list[Rect] = []
    for r in (r.clip(whole) for r in rects):
        if r.empty:
            continue
        while hit := next((o for o in out if not o.clip(r).empty), None):
            out.remove(hit)
            r = r.union(hit)
        out.append(r)
    return out
