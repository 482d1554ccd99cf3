"""Follows the configured patterns from frame to frame, and searches for those that are not
where they were expected.

A print that was seen is aligned from where its motion leads, else from where it was. If it
is nowhere there, the frame is searched for its features: reduced, in the frames after a
loss and in every few later ones, and at full resolution at a stated interval. Of two prints
of one picture one is followed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from arfx.analyse.markers.detect import Detection
from arfx.analyse.markers.pattern import (
    Alignment,
    PatternPicture,
    frame_features,
    homography_of,
    unit_corners,
)
from arfx.analyse.markers.tracker import (
    REDUCED_PX,
    REDUCED_SEARCH_EVERY,
    SEARCH_INTERVAL_S,
    Tracks,
)
from arfx.core.camera import Camera

# of a frame that is searched at full resolution; larger ones are reduced to so many
WHOLE_PX = 2.1e6


class PatternTracker(Tracks):
    """State from frame to frame; its tracks are in normalised coordinates without lens
    distortion.
    """

    given = frozenset({"_pictures"})

    def __init__(self, pictures: Sequence[PatternPicture]) -> None:
        super().__init__()
        self._pictures = tuple(pictures)

    def anew(self) -> PatternTracker:
        """One that has seen nothing."""
        return PatternTracker(self._pictures)

    def step(
        self, time_s: float, luma: np.ndarray, camera: Camera
    ) -> tuple[tuple[Detection, ...], bool]:
        """(the patterns that the frame shows, whether it was searched whole at full resolution)"""
        found: dict[str, Alignment] = {}
        for picture in self._pictures:
            track = self.tracks.get(picture.name)
            for ideal in () if track is None else (track.predicted(time_s), track.quad):
                if picture.name not in found and (
                    seen := picture.align(luma, camera, homography_of(ideal))
                ):
                    found[picture.name] = seen
        missing = [p for p in self._pictures if p.name not in found]
        whole = bool(missing) and time_s - self.last_whole_s >= SEARCH_INTERVAL_S
        lost = self.lately_lost(p.name for p in missing)
        if missing and (whole or lost or self.frames % REDUCED_SEARCH_EVERY == 0):
            features = frame_features(luma, WHOLE_PX if whole else REDUCED_PX)
            self.last_whole_s = time_s if whole else self.last_whole_s
            for picture in missing:
                about = picture.find(features, camera)
                if about is not None and (seen := picture.align(luma, camera, about)):
                    found[picture.name] = seen
        self.frames += 1
        for picture in self._pictures:
            there = found.get(picture.name)
            corners = None if there is None else unit_corners(there.ideal_from_unit)
            self.follow(picture.name, time_s, corners)
        detections = tuple(
            Detection(key, a.corners_px, a.sigma_px, math.nan, False)
            for key, a in sorted(found.items())
        )
        return detections, whole
