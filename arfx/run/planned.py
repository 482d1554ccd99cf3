"""A job between its steps: what the analysis left, what was planned, and both together."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from arfx.analyse.tables import from_bytes
from arfx.config.sections import JobConfig
from arfx.core.camera import Camera
from arfx.core.codec import Document
from arfx.core.cost import Prices
from arfx.core.facts import FrameFacts
from arfx.core.model import Model
from arfx.core.plan import FramePlan
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane
from arfx.core.scene import Scene
from arfx.core.stage import Stage
from arfx.run.folder import JobFolder, write
from arfx.run.inputs import Inputs, make_scene
from arfx.run.schedule import FrameRange, chunks_of
from arfx.run.times import WorkLog

MAPS = "maps"  # the table of a clip's surroundings, in a file of their own
_PLACES_SAID = 5  # places, of those where frames are missing


@dataclass(frozen=True)
class DecodedFrames(Document):
    """The frames to render. pts : their presentation times, in time base units

    truncated : why the clip ends early, or None;  careful : they are read as `ClipReader`
    says
    missing : (seconds from the clip's first frame, number) of frames that the clip does not
    give, where they would be
    damaged : parts of the clip cannot be read; the decoder may have had to guess them"""

    pts: list[int]
    truncated: str | None
    careful: bool
    missing: Sequence[tuple[float, int]]
    damaged: bool


@dataclass(frozen=True)
class ClipAnalysis(Document):
    """The analysis of the whole clip, beside the `FrameFacts` of each frame.

    anchor : key of the marker, or of the plane, under the object;  static : what is at rest
    previews : frames of which the report shows a picture;  summary : for the report"""

    frames: DecodedFrames
    anchor: str
    world_from_marker: Mapping[str, Pose]
    static: str
    summary: Mapping[str, Any]
    previews: Sequence[int]
    notices: Sequence[str]
    real_planes: Sequence[RealPlane]

    def scene(
        self, config: JobConfig, camera: Camera, model: Model, folder: JobFolder
    ) -> Scene:
        scene = make_scene(
            config,
            camera,
            model,
            self.world_from_marker,
            self.anchor,
            self.static,
            self.real_planes,
        )
        maps = from_bytes(folder.environment.read_bytes()).get(MAPS, {})
        return replace(scene, environment_maps=maps)

    def write(self, folder: JobFolder) -> None:
        write(folder.frames, json.dumps(self.to_json(), default=float))

    @staticmethod
    def read(folder: JobFolder) -> ClipAnalysis:
        return ClipAnalysis.from_json(
            json.loads(folder.frames.read_text(encoding="utf-8"))
        )


@dataclass(frozen=True)
class JobPlan:
    """frames : in order;  levels : how they were chosen;  predicted : seconds of the whole
    job;  seconds : planning took
    """

    frames: Sequence[FramePlan]
    levels: dict[str, Any]
    predicted: dict[str, Any]
    seconds: float


@dataclass(frozen=True)
class Job:
    """A job up to the point where rendering would start.

    key, analysis_key : digests of all that its pixels, and its facts, depend on;  stages :
    by name, in running order
    """

    inputs: Inputs
    folder: JobFolder
    key: str
    analysis_key: str
    analysed: ClipAnalysis
    facts: Sequence[FrameFacts]
    scene: Scene
    stages: Mapping[str, Stage]
    prices: Prices
    plan: JobPlan
    log: WorkLog

    @property
    def chunks(self) -> list[FrameRange]:
        return chunks_of(len(self.facts))


def places_in_words(missing: Sequence[tuple[float, int]]) -> str:
    """Missing frames in words: how many, and when."""
    places = ", ".join(
        f"{count} at {time_s:.2f} s" for time_s, count in missing[:_PLACES_SAID]
    )
    return places + ", …" * (len(missing) > _PLACES_SAID)
