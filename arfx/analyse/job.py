"""What the analysis of a clip is given, and what it gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from numpy import ndarray

from arfx.analyse.params import AnalyseParams, LightParams
from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.marker import Marker, MarkerSpec
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane
from arfx.core.rect import Rect
from arfx.core.scene import Scene

MARKER, PLANE = "marker", "plane"  # what the object stands on
PLANE_MARKER = MarkerSpec(
    PLANE, 0, 0.1
)  # in place of a marker; its square is that beside which the plane's radiance is read


class Picture(Protocol):
    """One frame's pixels, as the light is read from them (media.frame.Frame is one)."""

    @property
    def rect(self) -> Rect: ...

    def linear(self, rect: Rect) -> ndarray: ...

    def reduced(self, width: int) -> ndarray: ...


@dataclass(frozen=True, eq=False)
class AnalysisFrame:
    """index : number of the frame, from 0;  luma : (h, w) uint8, upright;  picture : its
    colours, None = no light is read
    following : luma of the frame after it; None = there is none, or it is not known"""

    index: int
    time_s: float
    luma: ndarray
    picture: Picture | None = None
    following: Callable[[], ndarray] | None = None


@dataclass(frozen=True, eq=False)
class AnalysisJob:
    """What a clip is analysed with.

    markers : the configured ones, the first that is seen is the world;  camera : for the
    clip's size or the same aspect
    marker_map : world_from_marker of a known layout; None = mapped from the clip
    panorama : of LightParams.environment;  anchor : MARKER or PLANE
    depth : maps of the real scene (media.depth_maps.DepthMaps);  align : scale them to the
    markers' planes;  poses : of the camera, media.pose_files.CameraPath
    scene : of the job, once it is known what stands where;  progress : (phase, done, in all)
    light_method : (clip, readings, samples, settings, panorama) -> clip with light, in place of
    the corrected method
    prints : pictures of the markers that are patterns, by key, (h, w, 3) linear
    """

    markers: tuple[Marker, ...]
    camera: Camera
    params: AnalyseParams = field(default_factory=AnalyseParams)
    light: LightParams = field(default_factory=LightParams)
    marker_map: Mapping[str, Pose] | None = None
    panorama: ndarray | None = None
    anchor: str = MARKER
    depth: Any = None
    align: bool = True
    poses: Any = None
    scene: Callable[[Analysis], Scene] | None = None
    progress: Callable[[str, int, int | None], None] = lambda *_: None
    light_method: Callable[..., Analysis] | None = None
    prints: Mapping[str, ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Analysis:
    """What is known of a clip.

    facts : one per frame;  world_from_marker : by key, of markers that could be placed
    anchor : what the object stands on;  static : "camera", "marker" or "both" (both move),
    see pose/at_rest.py
    summary : figures for the report, JSON-able;  notices : sentences for the user;
    real_planes : measured
    environment_maps : of the facts' `seen_environment` (core.scene.Scene)
    frame_span : which of the clip's frames these are: seconds of each after the clip's
    first, how many lie before, whether they
        reach to its end"""

    facts: tuple[FrameFacts, ...] = ()
    world_from_marker: Mapping[str, Pose] = field(default_factory=dict)
    static: str = "marker"
    summary: Mapping[str, Any] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    anchor: Marker = PLANE_MARKER
    real_planes: tuple[RealPlane, ...] = ()
    environment_maps: Mapping[str, ndarray] = field(
        default_factory=dict, compare=False
    )  # the facts name their contents
    frame_span: tuple[list[float], int, bool] = ([], 0, True)

    @property
    def world_from_anchor(self) -> Pose:
        return self.world_from_marker.get(self.anchor.key, Pose.identity())

    def adding(
        self,
        facts: Iterable[FrameFacts] | None = None,
        notice: str | None = None,
        **summary: Any,
    ) -> Analysis:
        """With these facts in place of its own, a sentence and figures more."""
        return replace(
            self,
            facts=self.facts if facts is None else tuple(facts),
            summary={**self.summary, **summary},
            notices=self.notices if notice is None else (*self.notices, notice),
        )
