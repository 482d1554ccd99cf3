"""Prints without code in a frame, known by their pictures: aligned from where they were
expected, else from where they were, or found by their features."""

from collections.abc import Iterable, Mapping, Sequence

from numpy import ndarray

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

    def follow(
        self, frame: AnalysisFrame, last: Mapping[str, Track]
    ) -> list[Detection]:
        camera = self._camera.scaled_to(*frame.luma.shape[::-1])
        seen = list[Detection]()
        for picture in self._pictures:
            if track := last.get(picture.name):
                quads = track.predicted(frame.time_s), track.quad
                abouts = (homography_of(camera.normalised(quad)) for quad in quads)
                seen += _first(picture, frame, camera, abouts)
        return seen

    def find(
        self, frame: AnalysisFrame, missing: Sequence[str], whole: bool
    ) -> list[Detection]:
        camera = self._camera.scaled_to(*frame.luma.shape[::-1])
        features = frame_features(frame.luma, WHOLE_PX if whole else REDUCED_PX)
        seen = list[Detection]()
        for picture in self._pictures:
            about = (
                picture.find(features, camera) if picture.name in missing else None
            )
            if about is not None:
                seen += _first(picture, frame, camera, [about])
        return seen


def _first(
    picture: PatternPicture,
    frame: AnalysisFrame,
    camera: Camera,
    abouts: Iterable[ndarray],
) -> list[Detection]:
    """The print, if it is there. abouts : ideal_from_unit, the first that leads to it counts"""
    for about in abouts:
        if there := picture.align(frame.luma, camera, about):
            return [there[0]]
    return []
