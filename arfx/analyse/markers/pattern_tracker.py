"""Follows the configured patterns from frame to frame, and searches for those that are not
where they were expected.

A print that was seen is aligned from where its motion leads, else from where it was. If it
is nowhere there, the frame is searched for its features: reduced, in the frames after a
loss and in every few later ones, and at full resolution at a stated interval. Of two prints
of one picture one is followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.fold import Stateful
from arfx.analyse.markers.detect import Detection
from arfx.analyse.markers.pattern import (
    Alignment,
    PatternPicture,
    frame_features,
    homography_of,
    unit_corners,
)
from arfx.analyse.markers.tracker import (
    LOSS_SEARCH_FRAMES,
    REDUCED_PX,
    REDUCED_SEARCH_EVERY,
    SEARCH_INTERVAL_S,
)
from arfx.core.camera import Camera

# of a frame that is searched at full resolution; larger ones are reduced to so many
WHOLE_PX = 2.1e6
_TRUSTED_S = 0.1  # for so long a print moves on as it did
_PAIR_S = 0.3  # longest time between two sightings that tell a speed


@dataclass
class PatternTrack:
    """Where a print was last: ideal (4, 2) normalised coordinates of its corners, without
    lens distortion, their speed per second, when, and for how many frames it has been
    missing."""

    ideal: np.ndarray
    speed: np.ndarray
    time_s: float
    missing: int = 0

    def predicted(self, time_s: float) -> np.ndarray:
        return self.ideal + self.speed * min(max(time_s - self.time_s, 0.0), _TRUSTED_S)


class PatternTracker(Stateful):
    """State from frame to frame.

    tracks : by key;  frames : seen so far;  last_whole_s : of the last search at full
    resolution
    """

    given = frozenset({"_pictures"})

    def __init__(self, pictures: Sequence[PatternPicture]) -> None:
        self._pictures = tuple(pictures)
        self.tracks: dict[str, PatternTrack] = {}
        self.frames = 0
        self.last_whole_s = -math.inf

    def anew(self) -> PatternTracker:
        """One that has seen nothing."""
        return PatternTracker(self._pictures)

    def led_on(self, other: PatternTracker, time_s: float) -> bool:
        """Whether `other` has just seen every print that is followed here, where it was
        expected.
        """
        for key, track in self.tracks.items():
            if track.missing:
                continue
            if (seen := other.tracks.get(key)) is None:
                return False
            expected, side = (
                track.predicted(time_s).mean(0),
                float(np.linalg.norm(np.diff(track.ideal, axis=0), axis=1).mean()),
            )
            if np.linalg.norm(seen.ideal.mean(0) - expected) > 0.5 * side:
                return False
        return True

    def step(
        self, time_s: float, luma: np.ndarray, camera: Camera
    ) -> tuple[tuple[Detection, ...], bool]:
        """(the patterns that the frame shows, whether it was searched whole at full resolution)"""
        found: dict[str, Alignment] = {}
        for picture in self._pictures:
            track = self.tracks.get(picture.name)
            for ideal in () if track is None else (track.predicted(time_s), track.ideal):
                if picture.name not in found and (
                    seen := picture.align(luma, camera, homography_of(ideal))
                ):
                    found[picture.name] = seen
        missing = [p for p in self._pictures if p.name not in found]
        whole = bool(missing) and time_s - self.last_whole_s >= SEARCH_INTERVAL_S
        lost = any(
            p.name in self.tracks and self.tracks[p.name].missing < LOSS_SEARCH_FRAMES
            for p in missing
        )
        if missing and (whole or lost or self.frames % REDUCED_SEARCH_EVERY == 0):
            features = frame_features(luma, WHOLE_PX if whole else REDUCED_PX)
            self.last_whole_s = time_s if whole else self.last_whole_s
            for picture in missing:
                about = picture.find(features, camera)
                if about is not None and (seen := picture.align(luma, camera, about)):
                    found[picture.name] = seen
        self.frames += 1
        for picture in self._pictures:
            self._follow(picture.name, time_s, found.get(picture.name))
        detections = tuple(
            Detection(key, a.corners_px, a.sigma_px, math.nan, False)
            for key, a in sorted(found.items())
        )
        return detections, whole

    def _follow(self, key: str, time_s: float, seen: Alignment | None) -> None:
        track = self.tracks.get(key)
        if seen is None:
            if track is not None:
                track.missing += 1
                if time_s - track.time_s > SEARCH_INTERVAL_S:
                    del self.tracks[key]
            return
        ideal, speed = unit_corners(seen.ideal_from_unit), np.zeros((4, 2))
        if track is not None and 0 < time_s - track.time_s < _PAIR_S:
            speed = (ideal - track.ideal) / max(time_s - track.time_s, 1e-3)
        self.tracks[key] = PatternTrack(ideal, speed, time_s)
