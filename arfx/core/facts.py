"""What the analysis learned about each frame: the only thing that crosses from one frame to
another.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from arfx.core.advection import AdvectionField
from arfx.core.codec import Array, Document, Unbounded
from arfx.core.cube import CubeMap, SeenEnvironment
from arfx.core.guard import atomic_write
from arfx.core.lens import LensFit
from arfx.core.light import Light
from arfx.core.pose import Pose
from arfx.core.real_depth import RealDepth
from arfx.core.rect import EMPTY, Rect
from arfx.errors import InputError

MEASURED, INTERPOLATED, ABSENT = "measured", "interpolated", "absent"
_FORMAT, _VERSION = (
    "arfx-facts",
    5,
)  # of a facts file: JSON lines, a header and then one line per frame


@dataclass(frozen=True, slots=True)
class MarkerSighting(Document):
    """One configured marker seen in one frame.
    key : "36h11:3";  corners_px : (4, 2) refined, order of MarkerSpec.corners_m
    sigma_px : standard deviation of a corner coordinate;  ambiguity : error of the other
    planar pose over that of the better one, inf with one alone, below 3 to 4: danger
    inverted : white on black print"""

    key: str
    corners_px: Array
    sigma_px: float
    ambiguity: Unbounded = float("inf")
    inverted: bool = False


@dataclass(frozen=True, slots=True)
class PlaneShadow(Document):
    """Where a real shadow lies on the anchor's plane already, as seen where the surface is
    known (the white of the marker).
    box_m : (x0, y0, x1, y1), anchor axes;  ratio : rows from y0 up, columns from x0: plate
    over what the frame's light gives
    the same surface without anything in the way, both without the camera's bias. 1 = lit;
    the ambient fraction of the light = all directional light blocked. Outside the box
    nothing is known: lit."""

    box_m: tuple[float, float, float, float]
    ratio: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class FrameFacts(Document):
    """One frame: everything a stage may know about the clip beside the pixels. What was not
    measured is None.

    index : number in decoding order of presentation, from 0 at the clip's first frame
    time_s : presentation time;  shot : number of the cut-free segment
    status : MEASURED (marker seen), INTERPOLATED (a bridged gap) or ABSENT
    camera_from_world : smoothed pose or None;  raw_camera_from_world : the same before smoothing
    pose_covariance : (6, 6) of the smoothed pose, left perturbation [rotation rad,
    translation m] in the camera frame
    opacity : 0..1, fades the object over a few frames at the ends of its presence
    light : of this frame, WORLD frame, None = the scene's;  bias_rgb : linear light that
    the camera adds where none falls
    model_box : pixels the object can touch, EMPTY when out of view;  depth_range_m :
    nearest, farthest point of it
    real_depth : measured;  lens : of the footage;  environment : a guess of all
    surroundings, WORLD axes
    seen_environment : what the clip saw of them, to be laid over the guess
    light_map : M of the printed method;  plane_shadow : real, on the anchor's plane
    advection : how the background moved since the clip's first frame"""

    index: int
    time_s: float
    shot: int = 0
    status: str = ABSENT
    camera_from_world: Pose | None = None
    raw_camera_from_world: Pose | None = None
    pose_covariance: Array | None = None
    reprojection_px: float | None = None
    opacity: float = 0.0
    markers: tuple[MarkerSighting, ...] = ()
    model_box: Rect = EMPTY
    depth_range_m: tuple[float, float] = (0.0, 0.0)
    light: Light | None = None
    bias_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    blur_px: float | None = None
    real_depth: RealDepth | None = None
    lens: LensFit | None = None
    environment: CubeMap | None = None
    seen_environment: SeenEnvironment | None = None
    light_map: CubeMap | None = None
    plane_shadow: PlaneShadow | None = None
    advection: AdvectionField | None = None

    @property
    def raster_box(self) -> Rect:
        """model_box and the pixels around it that a raster may write; not clipped to the frame."""
        return self.model_box.pad(2)

    @property
    def pose(self) -> Pose:
        """camera_from_world of a frame that has one.

        Raises ValueError: where there is none, it is not to be asked for.
        """
        if self.camera_from_world is None:
            raise ValueError(
                f"frame {self.index} has no pose: look at `present` first"
            )
        return self.camera_from_world

    @property
    def present(self) -> bool:
        """Whether the object is shown: there is a pose, and it has not faded out."""
        return self.camera_from_world is not None and self.opacity > 0

    @property
    def visible(self) -> bool:
        return self.present and not self.model_box.empty

    def with_(self, **changes: Any) -> FrameFacts:
        return replace(self, **changes)


def write_facts(path: Path | str, facts: Sequence[FrameFacts]) -> None:
    """Write atomically."""
    path = Path(path)
    header = {"format": _FORMAT, "version": _VERSION, "frames": len(facts)}
    with atomic_write(path) as part, part.open("w", encoding="utf-8") as f:
        for line in chain([header], (frame.to_json() for frame in facts)):
            f.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")


def read_facts(path: Path | str) -> tuple[FrameFacts, ...]:
    """All frames of a facts file.

    Raises InputError for a file of another kind or one that is cut short.
    """
    path = Path(path)
    line = 0
    try:
        with path.open(encoding="utf-8") as f:
            header = json.loads(f.readline() or "{}")
            if (
                not isinstance(header, dict)
                or header.get("format") != _FORMAT
                or header.get("version") != _VERSION
            ):
                raise InputError(
                    f"{path} is no facts file of version {_VERSION}",
                    "analyse the clip again",
                )
            facts = []
            for line, row in enumerate(f, 2):  # noqa: B007 - named in the message below
                facts.append(FrameFacts.from_line(row))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as e:
        raise InputError(
            f"{path}:{line}: not a frame's facts ({e})", "analyse the clip again"
        ) from e
    if len(facts) != header["frames"]:
        raise InputError(
            f"{path} holds {len(facts)} frames of {header['frames']}",
            "it was cut short: analyse the clip again",
        )
    return tuple(facts)
