"""What the analysis learned about each frame: the only thing that crosses from one frame to another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from arfx.core.light import Light
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect

MEASURED, INTERPOLATED, ABSENT = "measured", "interpolated", "absent"

_AROUND_PX = 2


@dataclass(frozen=True)
class Hypothesis:
    """One planar pose solution of one marker. reprojection_px : rms over its four corners."""

    camera_from_marker: Pose
    reprojection_px: float

    def to_json(self) -> dict:
        return {"pose": self.camera_from_marker.to_json(), "px": self.reprojection_px}

    @staticmethod
    def from_json(d: dict) -> Hypothesis:
        return Hypothesis(Pose.from_json(d["pose"]), d["px"])


@dataclass(frozen=True)
class MarkerSighting:
    """One configured marker seen in one frame.

    key : "36h11:3";  corners_px : (4, 2) refined, order of MarkerSpec.corners_m
    sigma_px : standard deviation of a corner coordinate;  hypotheses : best first, one or two (IPPE)
    chosen : index of the hypothesis that the whole clip supports;  inverted : white on black print
    """

    key: str
    corners_px: np.ndarray
    sigma_px: float
    hypotheses: tuple[Hypothesis, ...] = ()
    chosen: int = 0
    inverted: bool = False

    @property
    def ambiguity(self) -> float:
        """Ratio of the second solution's error to the first's, >= 1; inf with one solution. Below 3-4: danger."""
        if len(self.hypotheses) < 2:
            return float("inf")
        a, b = (h.reprojection_px for h in self.hypotheses[:2])
        return b / a if a > 0 else float("inf")

    def to_json(self) -> dict:
        return {
            "key": self.key, "corners_px": np.asarray(self.corners_px).tolist(), "sigma_px": self.sigma_px,
            "hypotheses": [h.to_json() for h in self.hypotheses], "chosen": self.chosen, "inverted": self.inverted,
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> MarkerSighting:
        return MarkerSighting(
            d["key"], np.array(d["corners_px"], float), d["sigma_px"],
            tuple(Hypothesis.from_json(h) for h in d["hypotheses"]), d["chosen"], d["inverted"],
        )  # fmt: skip


@dataclass(frozen=True)
class FrameFacts:
    """One frame. JSON-able; everything a stage may know about the clip beside the pixels.

    index : number in decoding order of presentation, from 0 at the clip's first frame
    time_s : presentation time;  shot : number of the cut-free segment
    status : MEASURED (marker seen), INTERPOLATED (a bridged gap) or ABSENT
    camera_from_world : smoothed pose or None;  raw_camera_from_world : the same before smoothing
    pose_covariance : (6, 6) of the smoothed pose, left perturbation [rotation rad, translation m] in the camera frame
    opacity : 0..1, fades the object over a few frames at the ends of its presence
    light : of this frame, WORLD frame, None = the scene's;  bias_rgb : linear light that the camera adds where none falls
    model_box : pixels the object can touch, EMPTY when out of view;  depth_range_m : nearest, farthest point of it
    """

    index: int
    time_s: float
    shot: int = 0
    status: str = ABSENT
    camera_from_world: Pose | None = None
    raw_camera_from_world: Pose | None = None
    pose_covariance: np.ndarray | None = None
    reprojection_px: float | None = None
    opacity: float = 0.0
    markers: tuple[MarkerSighting, ...] = ()
    whole_frame_search: bool = False
    model_box: Rect = EMPTY
    depth_range_m: tuple[float, float] = (0.0, 0.0)
    light: Light | None = None
    bias_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    blur_px: float | None = None
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def drawn_box(self) -> Rect:
        """model_box and the pixels around it that a raster may write; not clipped to the frame."""
        return self.model_box.pad(_AROUND_PX)

    @property
    def pose(self) -> Pose:
        """camera_from_world of a frame that has one. Raises ValueError: where there is none, it is not to be asked for."""
        if self.camera_from_world is None:
            raise ValueError(f"frame {self.index} has no pose: look at `present` first")
        return self.camera_from_world

    @property
    def present(self) -> bool:
        """Whether the object is shown: there is a pose, and it has not faded out."""
        return self.camera_from_world is not None and self.opacity > 0

    @property
    def visible(self) -> bool:
        return self.present and not self.model_box.empty

    @property
    def poses(self) -> Iterator[Pose]:
        """Every pose in these facts."""
        yield from (p for p in (self.camera_from_world, self.raw_camera_from_world) if p is not None)
        yield from (h.camera_from_marker for m in self.markers for h in m.hypotheses)

    def to_json(self) -> dict:
        def pose(p: Pose | None) -> list[float] | None:
            return None if p is None else p.to_json()

        return {
            "index": self.index, "time_s": self.time_s, "shot": self.shot, "status": self.status,
            "camera_from_world": pose(self.camera_from_world), "raw_camera_from_world": pose(self.raw_camera_from_world),
            "pose_covariance": None if self.pose_covariance is None else np.asarray(self.pose_covariance).tolist(),
            "reprojection_px": self.reprojection_px, "opacity": self.opacity,
            "markers": [m.to_json() for m in self.markers], "whole_frame_search": self.whole_frame_search,
            "model_box": self.model_box.to_json(), "depth_range_m": list(self.depth_range_m),
            "light": None if self.light is None else self.light.to_json(),
            "bias_rgb": list(self.bias_rgb), "blur_px": self.blur_px, "extra": self.extra,
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> FrameFacts:
        def pose(v: list[float] | None) -> Pose | None:
            return None if v is None else Pose.from_json(v)

        cov = d["pose_covariance"]
        return FrameFacts(
            d["index"], d["time_s"], d["shot"], d["status"], pose(d["camera_from_world"]), pose(d["raw_camera_from_world"]),
            None if cov is None else np.array(cov), d["reprojection_px"], d["opacity"],
            tuple(MarkerSighting.from_json(m) for m in d["markers"]), d["whole_frame_search"],
            Rect.from_json(d["model_box"]), (d["depth_range_m"][0], d["depth_range_m"][1]),
            None if d["light"] is None else Light.from_json(d["light"]), tuple(d.get("bias_rgb", (0.0, 0.0, 0.0))),
            d["blur_px"], d["extra"],
        )  # fmt: skip

    def with_(self, **changes: Any) -> FrameFacts:
        return replace(self, **changes)
