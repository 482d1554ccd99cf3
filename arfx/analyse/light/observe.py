"""What the light takes from the frames: readings of the prints, how the background changes,
small pictures of the surroundings."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.even_frames import EvenFrames
from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob, Picture
from arfx.analyse.light import patches
from arfx.analyse.light.brightness import background_change, small_luma
from arfx.analyse.light.frames import Reading
from arfx.analyse.light.hypotheses import REFUSED
from arfx.analyse.light.seen import SNAPSHOT_PX, Snapshot
from arfx.analyse.light.surroundings import EnvironmentSample, environment_sample
from arfx.analyse.markers.corners import LIGHT
from arfx.analyse.markers.search import Sighting, refined_in
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.rect import Rect
from arfx.core.stage import Check

SURROUNDINGS_S = 0.5  # between two small pictures of the surroundings, at least
MOST_SNAPSHOTS = 240  # of a clip, about
DARK_ACROSS = 64  # pixels of a row, about, of which the darkest are taken
SHARP_PX = 0.7  # blur assumed where it could not be measured
_AROUND_PX = 2


class BackgroundChange(NamedTuple):
    """ratio : logarithm of the background's light over that of the frame before; NaN = not
    known"""

    frame: int
    ratio: float


class LightReader:
    """Reads the prints' cells, and how the background's light changes from frame to frame."""

    def __init__(self, job: AnalysisJob) -> None:
        ink, paper = job.light.ink, job.light.paper
        self._meters = {
            m.key: [patches.marker_meter(m)]
            for m in job.markers
            if isinstance(m, MarkerSpec)
        }
        for key, print_ in job.prints.items():
            self._meters[key] = [
                patches.pattern_meter(print_, ink, paper, soft)
                for soft in patches.SOFT
            ]
        self.rows: list[Any] = []
        self._small: ndarray | None = None

    def step(self, frame: AnalysisFrame, shown: Sequence[Sighting]) -> None:
        picture = frame.picture
        if picture is None:
            return
        if frame.following is not None:
            now = small_luma(frame.luma) if self._small is None else self._small
            self._small = small_luma(frame.following())
            change = background_change(now, self._small)
            self.rows.append(BackgroundChange(frame.index + 1, change))
        for s in (s.print for s in refined_in(LIGHT, shown)):
            box = Rect.around(s.corners_px, _AROUND_PX).clip(picture.rect)
            if box.empty:
                continue
            blur = s.blur_px if np.isfinite(s.blur_px) else SHARP_PX
            meter = patches.meter_for(self._meters[s.key], s.side_px, blur)
            quad_px, linear = s.corners_px - [box.x0, box.y0], picture.linear(box)
            cells = patches.read_print(linear, quad_px, meter, s.inverted, blur)
            self.rows.append(Reading(frame.index, s.key, cells))


def darkest(picture: Picture) -> ndarray:
    """(3,) linear light of a picture's darkest hundredth, channel by channel."""
    whole = picture.rect
    apart = max(1, whole.width // DARK_ACROSS)
    lines = [whole._replace(y0=y, y1=y + 1) for y in range(0, whole.height, apart)]
    pixels = np.concatenate([picture.linear(line)[:, ::apart] for line in lines])
    return np.percentile(pixels, 1, axis=(0, 1)).astype(float)


class SnapshotTaker:
    """Keeps small pictures, in linear light. frames : of the clip, about"""

    def __init__(self, frames: int) -> None:
        self.rows: list[Snapshot] = []
        self._even = EvenFrames(frames, MOST_SNAPSHOTS, SURROUNDINGS_S)

    def step(self, frame: AnalysisFrame, _: Sequence[Sighting] = ()) -> None:
        picture = frame.picture
        if picture is None or not self._even.due(frame.index, frame.time_s):
            return
        small = picture.reduced(SNAPSHOT_PX)
        if min(small.shape[:2]) >= 3:
            row = Snapshot(frame.index, small.astype(np.float16), darkest(picture))
            self.rows.append(row)


def environment_samples(
    snapshots: Sequence[Snapshot], clip: Analysis, camera: Camera
) -> list[EnvironmentSample]:
    """What small pictures show of the surroundings of the object's place."""
    out = []
    for k, small, dark in snapshots:
        pose = clip.facts[k].camera_from_world
        if pose is None:
            continue
        quad = camera.project(pose.apply(clip.anchor.corners_m))
        if np.isfinite(quad).all():
            picture = small.astype(np.float32)
            out.append(environment_sample(k, picture, quad, camera.width, dark))
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
        "light direction",
        light["verdict"],
        "measured or given",
        known,
        light["reason"],
    )
    yield Check(
        "clipped share of the markers",
        light["clipped_fraction"],
        0.5,
        light["clipped_fraction"] <= 0.5,
        "clipped samples left out: brightness rests on the others",
    )
