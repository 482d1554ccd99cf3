"""Prints without code in a frame, known by their pictures: aligned from where they were
expected, else from where they were, or found by their features."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.detect import Detection
from arfx.analyse.markers.pattern import PatternPicture, frame_features, homography_of
from arfx.analyse.markers.tracker import REDUCED_PX, Track
from arfx.core.camera import Camera

# of a frame that is searched at full resolution; larger ones are reduced to so many
WHOLE_PX = 2.1e6


class PicturedPrints:
    """The search for the configured pictures. camera : for the clip's size or the same aspect"""

    quick = False

    def __init__(self, pictures: Sequence[PatternPicture], camera: Camera) -> None:
        self.keys: Sequence[str] = tuple(p.name for p in pictures)
        self._pictures = tuple(pictures)
        self._camera = camera

    def follow(self, frame: AnalysisFrame, last: Mapping[str, Track]) -> list[Detection]:
        camera = self._scaled(frame)
        seen = list[Detection]()
        for picture in self._pictures:
            track = last.get(picture.name)
            for quad in (
                () if track is None else (track.predicted(frame.time_s), track.quad)
            ):
                about = homography_of(camera.normalised(quad))
                if there := _aligned(picture, frame, camera, about):
                    seen.append(there)
                    break
        return seen

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Detection]:
        camera = self._scaled(frame)
        features = frame_features(frame.luma, WHOLE_PX if whole else REDUCED_PX)
        seen = list[Detection]()
        for picture in self._pictures:
            about = picture.find(features, camera) if picture.name in missing else None
            if about is not None and (there := _aligned(picture, frame, camera, about)):
                seen.append(there)
        return seen

    def _scaled(self, frame: AnalysisFrame) -> Camera:
        h, w = frame.luma.shape
        return self._camera.scaled_to(w, h)


def _aligned(
    picture: PatternPicture, frame: AnalysisFrame, camera: Camera, about: np.ndarray
) -> Detection | None:
    """about : ideal_from_unit, right to some pixels"""
    there = picture.align(frame.luma, camera, about)
    if there is None:
        return None
    return Detection(
        picture.name,
        there.corners_px,
        there.sigma_px,
        math.nan,
        False,
        misfit_px=there.misfit_px,
    )
