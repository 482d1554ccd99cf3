"""What the light takes from the frames: readings of the prints, how the background changes,
small pictures of the surroundings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np

from arfx.analyse.fold import (
    Analysis,
    AnalysisFrame,
    AnalysisJob,
    Fold,
    Picture,
    Stateful,
    shifted,
)
from arfx.analyse.light import patches
from arfx.analyse.light.brightness import background_change, small_luma
from arfx.analyse.light.frames import Reading, with_light
from arfx.analyse.light.hypotheses import REFUSED
from arfx.analyse.light.samples import place_samples
from arfx.analyse.light.seen import LOOK_PX, Look, given_everywhere, with_seen
from arfx.analyse.light.surroundings import (
    environment_sample,
    with_environment,
)
from arfx.analyse.markers.fold import Markers
from arfx.core.facts import FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.rect import Rect
from arfx.core.stage import Check

DARK_ACROSS = 64  # pixels of a row, about, of which the darkest are taken
SURROUNDINGS_S = 0.5  # between two looks at the surroundings
SURROUNDINGS_PX = 96  # width of the picture that is looked at
MOST_ENVIRONMENT_SAMPLES = (
    240  # about: in a clip that would give more the interval is longer
)
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2


class LightOfMarkers(Fold):
    """readings : (frame, marker key, Patches) in order;  changes : (frame, of the background
    from the frame before)
    """

    name = "light"
    needs: ClassVar[tuple[str, ...]] = ("markers", "pose")
    given = frozenset({"job", "_meters"})
    carried = frozenset({"_small"})

    def __init__(self, job: AnalysisJob, markers: Markers | None, pose: Fold) -> None:
        super().__init__(job)
        self._markers = markers
        ink, paper = job.light.ink, job.light.paper
        self._meters = {
            m.key: [patches.marker_meter(m)]
            for m in job.markers
            if isinstance(m, MarkerSpec)
        }
        for key, print_ in job.prints.items():
            self._meters[key] = [
                patches.pattern_meter(print_, ink, paper, soft) for soft in patches.SOFT
            ]
        self.readings: list[Reading] = []
        self.changes: list[tuple[int, float]] = []
        self._small: np.ndarray | None = None
        self._surroundings = EnvironmentSamples(job.length_s)

    @property
    def samples(self) -> list[Any]:
        return self._surroundings.samples

    def step(self, frame: AnalysisFrame) -> None:
        picture = frame.picture
        if picture is None or self._markers is None:
            return
        before, self._small = self._small, small_luma(frame.luma)
        if before is not None:
            self.changes.append((frame.index, background_change(before, self._small)))
        seen = self._markers.detections
        for s in seen:
            if Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect).empty:
                continue
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            cells, albedo, scale = patches.meter_for(self._meters[s.key], s.side_px, blur)
            shape = (picture.rect.height, picture.rect.width)
            points = place_samples(s.corners_px, cells, s.inverted, blur, shape, scale)
            self.readings.append(
                (
                    frame.index,
                    s.key,
                    patches.reduced(picture.linear_at(points.pixels()), points, albedo),
                )
            )
        if seen:
            quad, width = max(seen, key=lambda s: s.side_px).corners_px, picture.rect.width
            self._surroundings.step(
                frame.time_s,
                picture,
                lambda small: environment_sample(
                    frame.index, small, quad, width, darkest(picture)
                ),
            )

    def join(self, later: Self, shift: int) -> None:
        self.readings += shifted(later.readings, shift)
        self.changes += shifted(later.changes, shift)
        self._surroundings.join(later._surroundings, shift)

    def finish(self, clip: Analysis) -> Analysis:
        return with_light(
            clip,
            self.readings,
            self.samples,
            self.job.light,
            self.job.panorama,
            changes=dict(self.changes),
        )

    @staticmethod
    def health(facts: Sequence[FrameFacts], summary: Mapping[str, Any]) -> Iterator[Check]:
        light = summary["light"]
        photometry = light["photometry"]
        yield Check(
            "photometry condition number",
            max((c for c in photometry["condition"] if c is not None), default=None),
            1e6,
            photometry["verdict"] == "measured",
            f"bias taken for 0: {photometry['reason']}",
        )
        if "verdict" not in light:  # no frame with a pose that lasts
            return
        # what the markers' normals say of a direction beside ambient light; a given light
        # does not need it
        known = light["verdict"] != REFUSED
        yield Check(
            "light direction", light["verdict"], "measured or given", known, light["reason"]
        )
        if light["normals_seen"]:
            yield Check(
                "light fit condition number",
                light["condition"],
                1e3,
                known,
                "no direction claimed",
            )
        yield Check(
            "clipped share of the markers",
            light["clipped_fraction"],
            0.5,
            light["clipped_fraction"] <= 0.5,
            "clipped samples left out: brightness rests on the others",
        )


def darkest(picture: Picture) -> np.ndarray:
    """(3,) linear light of a picture's darkest hundredth, channel by channel."""
    rect = picture.rect
    apart = max(1, rect.width // DARK_ACROSS)
    x, y = np.meshgrid(
        np.arange(rect.x0, rect.x1, apart), np.arange(rect.y0, rect.y1, apart)
    )
    pixels = np.stack([x.ravel(), y.ravel()], -1).astype(np.int32)
    return np.percentile(picture.linear_at(pixels), 1, axis=0).astype(float)


class LightOnPlane(LightOfMarkers):
    """Where there is no marker: small pictures are kept until it is known where in them the
    plane is."""

    needs = ("pose",)
    given = LightOfMarkers.given | {"_markers", "readings", "changes", "_small"}
    carried = frozenset()

    def __init__(self, job: AnalysisJob, pose: Fold) -> None:
        super().__init__(job, None, pose)

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            self._surroundings.step(
                frame.time_s, frame.picture, lambda small: (frame.index, small)
            )

    def finish(self, clip: Analysis) -> Analysis:
        camera, pictures = self.job.camera, self.samples
        self._surroundings.samples = []
        for k, small in pictures:
            if (pose := clip.facts[k].camera_from_world) is not None:
                quad = camera.project(pose.apply(clip.anchor.corners_m))
                if np.isfinite(quad).all():
                    self.samples.append(environment_sample(k, small, quad, camera.width))
        return super().finish(clip)


class EnvironmentSamples(Stateful):
    """What is made of the frames' small pictures at some times, evenly over the clip.

    length_s : of all frames
    """

    given = frozenset({"_interval_s"})
    carried = frozenset({"_next_s"})

    def __init__(self, length_s: float = 0.0) -> None:
        self.samples: list[Any] = []
        self._next_s: float | None = None
        self._interval_s = max(SURROUNDINGS_S, length_s / MOST_ENVIRONMENT_SAMPLES)

    def step(
        self,
        time_s: float,
        picture: Picture,
        sample: Callable[[np.ndarray], Any],
        width: int = SURROUNDINGS_PX,
    ) -> None:
        """width : of the small picture, at most"""
        if self._next_s is None:  # at once, unless not every stretch has one
            self._next_s = time_s
            if self._interval_s > SURROUNDINGS_S:
                self._next_s = self._interval_s * np.ceil(time_s / self._interval_s)
        if time_s < self._next_s:
            return
        self._next_s = time_s + self._interval_s
        small = picture.reduced(width)
        if min(small.shape[:2]) >= 3:
            self.samples.append(sample(small))

    def join(self, later: EnvironmentSamples, shift: int) -> None:
        self.samples += shifted(later.samples, shift)


class Environment(Fold):
    """The surroundings, for reflections: a guess of all of them, and what was seen of them."""

    name = "environment"
    needs = ("light",)

    def __init__(self, job: AnalysisJob, light: LightOfMarkers) -> None:
        super().__init__(job)
        self._light = light
        self._looks = EnvironmentSamples(job.length_s)

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            self._looks.step(
                frame.time_s,
                frame.picture,
                lambda small: Look(frame.index, small.astype(np.float16)),
                LOOK_PX,
            )

    def join(self, later: Self, shift: int) -> None:
        self._looks.join(later._looks, shift)

    def finish(self, clip: Analysis) -> Analysis:
        job, anchor, still_camera = (
            self.job,
            clip.world_from_anchor,
            clip.static == "camera",
        )
        clip = clip.adding(
            with_environment(
                clip.facts, self._light.samples, still_camera, job.panorama, anchor.rotation
            )
        )
        if job.panorama is not None:
            facts, maps = given_everywhere(clip.facts, job.panorama, anchor.rotation)
        else:
            facts, maps = with_seen(
                clip.facts,
                self._looks.samples,
                job.camera,
                still_camera,
                anchor.translation_m,
                anchor.rotation[:, 2],
            )
        return replace(clip.adding(facts), environment_maps=maps)
