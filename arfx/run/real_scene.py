"""The real scene of a job from its depth: its planes, and with `anchor = "plane"` where the object stands and from where it is
seen: no marker, but a camera at rest or with poses of its own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from arfx.analyse.depth.plane_pose import Stand, spread, stand_on
from arfx.analyse.depth.scene_planes import scene_planes
from arfx.analyse.fold import Fold
from arfx.analyse.light.fold import SURROUNDINGS_PX, SURROUNDINGS_S, LightMeter, Picture, lighted
from arfx.analyse.light.surroundings import look
from arfx.analyse.params import LightParams
from arfx.analyse.pose.at_rest import RestCheck
from arfx.analyse.records import Analysis
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose
from arfx.errors import NothingToDoError
from arfx.run.analysis import Pass, Progress, read_clip
from arfx.run.folder import JobFolder
from arfx.run.inputs import Inputs

ANCHOR = "plane"  # in place of a marker's key
LOOK_M = 0.1  # side of the square beside which the plane's radiance is looked at


class PlaneFold(Fold):
    """What is taken from the frames before the plane is known. watch : whether the camera rests;  look : at the surroundings

    times : seconds of the frames;  looks : (number of the frame, small picture of it)
    """

    given = frozenset({"_watch", "_look"})

    def __init__(self, watch: bool, look: bool) -> None:
        self._watch, self._look = watch, look
        self.times: list[float] = []
        self.rest = RestCheck()
        self.looks: list[tuple[int, np.ndarray]] = []
        self._next_look_s = -np.inf

    def step(self, index: int, time_s: float, luma: np.ndarray, picture: Picture, following: object = None) -> None:
        if self._watch:
            self.rest.step(time_s, luma)
        if self._look and time_s >= self._next_look_s:
            self._next_look_s = time_s + SURROUNDINGS_S
            self.looks.append((index, picture.reduced(SURROUNDINGS_PX)))
        self.times.append(time_s)


def analyse_plane(
    inputs: Inputs, span_s: tuple[float | None, float | None], progress: Progress, light: LightParams | None,
    folds: frozenset[str], folder: JobFolder | None = None, key: str = "",
) -> Pass:  # fmt: skip
    """Every frame's pose over the dominant plane, whose middle is the world's origin.

    folder, key : as of `analyse_clip`
    Raises NothingToDoError: no plane, or a camera that moves and no poses.
    """
    info, camera, maps = inputs.info, inputs.camera, inputs.depth
    assert maps is not None
    reader_path = inputs.poses
    seen = PlaneFold(reader_path is None, light is not None)
    span, truncated, decode_s, analyse_s = read_clip(info, span_s, seen, progress, folder, key)
    times, rest = seen.times, seen.rest
    start = time.perf_counter()
    from_start_s = span.from_start_s()
    poses: list[Pose | None]
    if reader_path is None:
        if not rest.rests:
            raise NothingToDoError(
                f"--anchor plane: the camera moves ({rest.moved_px:.1f} px), and no poses are given",
                "--poses FILE (tx ty tz qx qy qz qw a frame), a camera at rest, or a marker",
            )
        poses = [Pose.identity() for _ in times]
    else:
        poses = reader_path.of_frames(from_start_s, span.before, span.whole)
    numbers = maps.of_frames(from_start_s, span.before, span.whole)
    both = [(k, p) for k, p in zip(numbers, poses, strict=True) if k is not None and p is not None]
    if maps.still and reader_path is None:
        both = both[:1]
    planes = scene_planes([(maps.load(k, camera.width, camera.height), p) for k, p in spread(both)], camera)
    stand = stand_on(planes, [p for p in poses if p is not None])
    facts = tuple(
        FrameFacts(k, t) if p is None else FrameFacts(
            k, t, status=MEASURED, camera_from_world=p @ stand.given_from_plane, raw_camera_from_world=p @ stand.given_from_plane,
            opacity=1.0,
        )
        for k, (t, p) in enumerate(zip(times, poses, strict=True))
    )  # fmt: skip
    analysis = Analysis(facts, {}, "marker", _summary(facts, stand, reader_path is not None, rest.moved_px))
    if light is not None:
        meter = LightMeter()
        square = MarkerSpec(ANCHOR, 0, LOOK_M)
        for k, small in seen.looks:
            pose = facts[k].camera_from_world
            if pose is None or min(small.shape[:2]) < 3:
                continue
            quad = camera.project(pose.apply(square.corners_m))
            if np.isfinite(quad).all():
                meter.looks.append(look(k, small, (quad + 0.5) * (small.shape[1] / camera.width) - 0.5, light.formula))
        analysis = lighted(analysis, meter, (square,), light, inputs.panorama, "environment" in folds)
    analyse_s += time.perf_counter() - start
    progress("analyse", len(times), len(times))
    return Pass(analysis, span, truncated, decode_s, analyse_s)


def _summary(facts: Sequence[FrameFacts], stand: Stand, posed: bool, moved_px: float) -> dict[str, Any]:
    """As the analysis of markers tells it, empty where that measures nothing."""
    seen = sum(f.camera_from_world is not None for f in facts)
    nothing = {"median": None, "p95": None}
    return {
        "frames": len(facts), "frames_measured": seen, "frames_interpolated": 0, "frames_absent": len(facts) - seen,
        "shots": 1, "cuts": [], "flips_resolved": 0, "whole_frame_searches": 0, "ambiguous_sightings": 0,
        "reprojection_px": {"raw": nothing, "smoothed": nothing}, "pose_condition": {"median": None}, "markers_seen": {},
        "rivals": 0, "dropped": 0, "static_evidence": {} if posed else {"moved_px": moved_px},
        "map": {"given": True, "frames": 0, "rms_px": None, "condition": None, "unmapped": [], "sd_m": {}},
        "anchor": {"kind": ANCHOR, "poses": "given" if posed else "a camera at rest", **stand.plane.to_json()},
    }  # fmt: skip
