"""The truth of a synthetic clip: one JSON line per frame after a header line, and pictures
per pixel.

Header: {"arfx_truth": 1, "world": key of the marker that arfx takes as world or null,
"markers": {key: size_m},
  "camera": the true camera, "stated_camera": what camera.yaml says, "depth_unit_m",
  "flow_unit_px", "objects": {number: name}}
Frame: see FrameTruth. Depth: 16-bit PNG times depth_unit_m, along the axis, 0 = nothing.
Mask: 8-bit PNG of object
numbers. Flow to the next frame: KITTI's 16-bit PNG, u = (R - 2^15) / 64 px, v from G, B = 1
where known."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document, Gaps
from arfx.core.opener import read_text
from arfx.core.pose import Pose
from arfx.errors import InputError
from arfx.media.images import write_png

DEPTH_UNIT_M = 2e-4  # 16 bits reach 13 m in steps of a fifth of a millimetre
FLOW_UNIT_PX = 1 / 64


@dataclass(frozen=True)
class MarkerTruth(Document):
    """One marker in one frame.
    corners_px : (4, 2) projected with the true camera, NaN behind it;  visible : fraction
    0..1 of its black square that is
    in the picture and not hidden;  side_px : mean length of its sides;  facing : cosine of
    the angle at which it is seen
    """

    camera_from_marker: Pose
    corners_px: Annotated[ndarray, Gaps]
    visible: float
    side_px: Annotated[float, Gaps]
    facing: float


@dataclass(frozen=True)
class FrameTruth(Document):
    """One frame. camera_from_room, room_from_marker and markers are exact; gain and bias
    act on linear light.
    lights : [{"room", "camera", "marker": unit vectors towards it, "rgb", "angular_size_deg"}]
    """

    index: int
    time_s: float
    shot: int
    camera_from_room: Pose
    room_from_marker: dict[str, Pose]
    markers: dict[str, MarkerTruth]
    gain: float
    bias: float
    ambient_rgb: list[float]
    lights: list[dict[str, Any]]


@dataclass(frozen=True)
class Truth:
    """The whole file: its header and its frames."""

    header: dict[str, Any]
    frames: tuple[FrameTruth, ...]

    @property
    def world(self) -> str | None:
        """Key of the first configured marker."""
        return self.header["world"]


def write_truth(path: Path, truth: Truth) -> None:
    lines = [
        json.dumps(truth.header),
        *(json.dumps(f.to_json()) for f in truth.frames),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_truth(path: Path) -> Truth:
    """Raises InputError if there is no such file or it is not a truth file."""
    text = read_text(path, "truth")
    try:
        header, *frames = [json.loads(line) for line in text.splitlines()]
        if header.get("arfx_truth") != 1:
            raise ValueError
        return Truth(header, tuple(FrameTruth.from_json(f) for f in frames))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path} is not a truth file of version 1", "`arfx synth` makes it"
        ) from None


def write_depth(path: Path, depth_m: ndarray) -> None:
    """Farther than 13.1 m counts as nothing."""
    steps = np.rint(depth_m / DEPTH_UNIT_M)
    write_png(path, np.where(steps <= 65535, steps, 0).astype(np.uint16))


def write_flow(path: Path, flow_px: ndarray) -> None:
    """(h, w, 2) px, NaN = unknown; beyond ±511 px counts as unknown."""
    steps = (
        np.rint(np.nan_to_num(flow_px, nan=1e9) / FLOW_UNIT_PX) + 2**15
    )  # 1e9 px is out of range below: unknown
    known = ((steps >= 0) & (steps <= 65535)).all(-1)
    rgb = np.zeros((*flow_px.shape[:2], 3), np.uint16)
    rgb[known, :2], rgb[..., 2] = steps[known], known
    write_png(path, rgb)
