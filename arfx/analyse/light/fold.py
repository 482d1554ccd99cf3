"""What the light takes from the frames: readings of the prints, how the background changes,
small pictures of the surroundings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from arfx.analyse.fold import (
    Analysis,
    AnalysisFrame,
    AnalysisJob,
    Fold,
    Picture,
)
from arfx.analyse.light import patches
from arfx.analyse.light.brightness import background_change, small_luma
from arfx.analyse.light.frames import Reading, with_light
from arfx.analyse.light.hypotheses import REFUSED
from arfx.analyse.light.seen import LOOK_PX, Look, given_everywhere, with_seen
from arfx.analyse.light.surroundings import (
    EnvironmentSample,
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


class BackgroundChange(NamedTuple):
    """ratio : logarithm of the background's light over that of the frame before; NaN = not
    known"""

    frame: int
    ratio: float


class LightOfMarkers(Fold):
    """samples : of the surroundings;  changes : of the background's light, frame by frame"""

    name = "light"
    needs: ClassVar[tuple[str, ...]] = ("markers", "pose")
    rows: ClassVar[Mapping[str, type]] = {
        "readings": Reading,
        "samples": EnvironmentSample,
        "changes": BackgroundChange,
    }

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
        self.samples: list[EnvironmentSample] = []
        self.changes: list[BackgroundChange] = []
        self._small: np.ndarray | None = None
        self._looks = Looks(job.length_s)

    def step(self, frame: AnalysisFrame) -> None:
        picture = frame.picture
        if picture is None or self._markers is None:
            return
        self._compare_with_following(frame)
        seen = self._markers.detections
        for s in seen:
            box = Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect)
            if box.empty:
                continue
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            meter = patches.meter_for(self._meters[s.key], s.side_px, blur)
            quad_px, linear = s.corners_px - [box.x0, box.y0], picture.linear(box)
            cells = patches.read_print(linear, quad_px, meter, s.inverted, blur)
            self.readings.append(Reading(frame.index, s.key, cells))
        if seen:
            quad, width = max(seen, key=lambda s: s.side_px).corners_px, picture.rect.width
            for small in self._looks.due(frame.time_s, picture, SURROUNDINGS_PX):
                dark = darkest(picture)
                self.samples.append(
                    environment_sample(frame.index, small, quad, width, dark)
                )

    def _compare_with_following(self, frame: AnalysisFrame) -> None:
        if frame.following is None:
            return
        now = small_luma(frame.luma) if self._small is None else self._small
        self._small = small_luma(frame.following())
        change = background_change(now, self._small)
        self.changes.append(BackgroundChange(frame.index + 1, change))

    def finish(self, clip: Analysis) -> Analysis:
        def place_m() -> np.ndarray:
            """(2,) middle of the object, anchor axes."""
            if self.job.scene is None:
                return np.zeros(2)
            scene = self.job.scene(clip)
            points = scene.world_from_anchor.inverse().apply(scene.model_points_m)
            return np.asarray(points.min(0) + points.max(0))[:2] / 2

        return with_light(
            clip,
            self.readings,
            self.samples,
            self.job.light,
            self.job.panorama,
            changes=dict(self.changes),
            place_m=place_m,
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
    rows: ClassVar[Mapping[str, type]] = {"pictures": Look}

    def __init__(self, job: AnalysisJob, pose: Fold) -> None:
        super().__init__(job, None, pose)
        self.pictures: list[Look] = []

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            for small in self._looks.due(frame.time_s, frame.picture, SURROUNDINGS_PX):
                self.pictures.append(Look(frame.index, small))

    def finish(self, clip: Analysis) -> Analysis:
        camera = self.job.camera
        for k, small in self.pictures:
            if (pose := clip.facts[k].camera_from_world) is not None:
                quad = camera.project(pose.apply(clip.anchor.corners_m))
                if np.isfinite(quad).all():
                    self.samples.append(environment_sample(k, small, quad, camera.width))
        return super().finish(clip)


class Looks:
    """At which frames a small picture is taken, evenly over the clip. length_s : of all frames"""

    def __init__(self, length_s: float = 0.0) -> None:
        self._next_s: float | None = None
        self._interval_s = max(SURROUNDINGS_S, length_s / MOST_ENVIRONMENT_SAMPLES)

    def due(self, time_s: float, picture: Picture, width: int) -> list[np.ndarray]:
        """The frame, made so wide at most, where it is time for one; else nothing."""
        if self._next_s is None:  # at once, unless not every stretch has one
            self._next_s = time_s
            if self._interval_s > SURROUNDINGS_S:
                self._next_s = self._interval_s * np.ceil(time_s / self._interval_s)
        if time_s < self._next_s:
            return []
        self._next_s = time_s + self._interval_s
        small = picture.reduced(width)
        return [small] if min(small.shape[:2]) >= 3 else []


class Environment(Fold):
    """The surroundings, for reflections: a guess of all of them, and what was seen of them."""

    name = "environment"
    needs = ("light",)
    rows: ClassVar[Mapping[str, type]] = {"looks": Look}

    def __init__(self, job: AnalysisJob, light: LightOfMarkers) -> None:
        super().__init__(job)
        self._light = light
        self._due = Looks(job.length_s)
        self.looks: list[Look] = []

    def step(self, frame: AnalysisFrame) -> None:
        if frame.picture is not None:
            for small in self._due.due(frame.time_s, frame.picture, LOOK_PX):
                self.looks.append(Look(frame.index, small.astype(np.float16)))

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
                self.looks,
                job.camera,
                still_camera,
                anchor.translation_m,
                anchor.rotation[:, 2],
            )
        return replace(clip.adding(facts), environment_maps=maps)
