"""What the light takes from the frames: readings of the prints, how the background changes,
small pictures of the surroundings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob, Picture
from arfx.analyse.light import patches
from arfx.analyse.light.brightness import background_change, small_luma
from arfx.analyse.light.frames import Reading
from arfx.analyse.light.hypotheses import REFUSED
from arfx.analyse.light.seen import SNAPSHOT_PX, Snapshot
from arfx.analyse.light.surroundings import EnvironmentSample, environment_sample
from arfx.analyse.markers.search import Sighting, detections
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.rect import Rect
from arfx.core.stage import Check

DARK_ACROSS = 64  # pixels of a row, about, of which the darkest are taken
SURROUNDINGS_S = 0.5  # between two looks at the surroundings
SURROUNDINGS_PX = 96  # width of the picture that is looked at
MOST_SNAPSHOTS = 240  # about: in a clip that would give more the interval is longer
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2


class BackgroundChange(NamedTuple):
    """ratio : logarithm of the background's light over that of the frame before; NaN = not
    known"""

    frame: int
    ratio: float


class LightReader:
    """Reads the prints' cells and the picture's surroundings, and how the background's light
    changes from frame to frame."""

    tables: ClassVar[Mapping[str, type]] = {
        "readings": Reading,
        "samples": EnvironmentSample,
        "changes": BackgroundChange,
    }

    def __init__(self, job: AnalysisJob) -> None:
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
        self._clock = SnapshotClock(job.length_s)

    def step(self, frame: AnalysisFrame, shown: Sequence[Sighting]) -> None:
        picture = frame.picture
        if picture is None:
            return
        self._compare_with_following(frame)
        seen = detections(shown)
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
            for small in self._clock.due(frame.time_s, picture, SURROUNDINGS_PX):
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


def darkest(picture: Picture) -> np.ndarray:
    """(3,) linear light of a picture's darkest hundredth, channel by channel."""
    rect = picture.rect
    apart = max(1, rect.width // DARK_ACROSS)
    x, y = np.meshgrid(
        np.arange(rect.x0, rect.x1, apart), np.arange(rect.y0, rect.y1, apart)
    )
    pixels = np.stack([x.ravel(), y.ravel()], -1).astype(np.int32)
    return np.percentile(picture.linear_at(pixels), 1, axis=0).astype(float)


class SnapshotClock:
    """At which frames a small picture is taken, evenly over the clip. length_s : of all frames"""

    def __init__(self, length_s: float = 0.0) -> None:
        self._next_s: float | None = None
        self._interval_s = max(SURROUNDINGS_S, length_s / MOST_SNAPSHOTS)

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


class SnapshotTaker:
    """Keeps small pictures, in linear light."""

    tables: ClassVar[Mapping[str, type]] = {"snapshots": Snapshot}

    def __init__(self, length_s: float) -> None:
        self.snapshots: list[Snapshot] = []
        self._clock = SnapshotClock(length_s)

    def step(self, frame: AnalysisFrame, _: Sequence[Sighting] = ()) -> None:
        if frame.picture is not None:
            for small in self._clock.due(frame.time_s, frame.picture, SNAPSHOT_PX):
                self.snapshots.append(Snapshot(frame.index, small.astype(np.float16)))


def plane_samples(
    snapshots: Sequence[Snapshot], clip: Analysis, camera: Camera
) -> list[EnvironmentSample]:
    """The surroundings of an object that stands on a plane without a print."""
    out = []
    for k, small in snapshots:
        pose = clip.facts[k].camera_from_world
        if pose is None:
            continue
        quad = camera.project(pose.apply(clip.anchor.corners_m))
        if np.isfinite(quad).all():
            picture = small.astype(np.float32)
            out.append(environment_sample(k, picture, quad, camera.width))
    return out


def light_checks(summary: Mapping[str, Any]) -> Iterator[Check]:
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
    # what the markers' normals say of a direction beside ambient light; a given light does
    # not need it
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
