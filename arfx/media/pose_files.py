"""Camera poses that come with the footage: text of `tx ty tz qx qy qz qw`, the camera in the world, as RGB-D sets write them.

One line a frame, in order; or with the time in seconds before it (TUM RGB-D), and lines are taken by time. `#` begins a comment.
Axes of the camera: x right, y down, z forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arfx.core.opener import read_text
from arfx.core.pose import Pose, rotation_from_quaternion
from arfx.errors import InputError
from arfx.media.clip import match_by_time, match_in_order

_MAX_VALUE = 1e12  # metres or seconds: times count from 1970, nothing is farther than that in metres
_UNIT_TOLERANCE = 1e-2  # from 1, of a quaternion's length


@dataclass(frozen=True, eq=False)
class CameraPath:
    """camera_from_given : in order;  times_s : after the first one, None = one for each frame of the clip"""

    path: Path
    camera_from_given: tuple[Pose, ...]
    times_s: tuple[float, ...] | None

    def of_frames(self, times_s: list[float], before: int, whole: bool) -> list[Pose | None]:
        """Each frame's pose, None where none was taken near its time.
        times_s : after the clip's first frame;  before, whole : as of `in_order`, which raises InputError"""
        if self.times_s is not None:
            found = match_by_time(np.array(self.times_s), times_s)
        else:
            held, hint = len(self.camera_from_given), "one line for each frame, or the time in seconds before each pose"
            found = match_in_order(f"poses {self.path} hold {held} lines", held, len(times_s), before, whole, hint)
        return [None if k is None else self.camera_from_given[k] for k in found]


def load_poses(path: Path) -> CameraPath:
    """Raises InputError: missing, a line that is no pose, times that do not rise."""
    text = read_text(path, "poses")
    rows, columns = [], 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            values = np.array([float(w) for w in words])
        except ValueError:
            values = np.zeros(0)
        length = math.hypot(*values[-4:]) if len(values) in (7, 8) else 0.0
        alike = len(values) in (7, 8) and columns in (0, len(values))
        if not (alike and (np.abs(values) <= _MAX_VALUE).all() and abs(length - 1) <= _UNIT_TOLERANCE):
            where, hint = f"poses {path}, line {number}", "tx ty tz qx qy qz qw, perhaps the time before them"
            raise InputError(f"{where}: {line.strip()!r} is not a pose", hint)
        columns = len(values)
        rows.append(values)
    if not rows:
        raise InputError(f"poses {path} hold no line", "text lines of tx ty tz qx qy qz qw")
    table = np.array(rows)
    rotations = [rotation_from_quaternion(*(q / np.linalg.norm(q))[[3, 0, 1, 2]]) for q in table[:, -4:]]
    poses = tuple(Pose(r, t).inverse() for r, t in zip(rotations, table[:, -7:-4], strict=True))
    if columns == 7:
        return CameraPath(path, poses, None)
    times = table[:, 0] - table[0, 0]
    if (np.diff(times) <= 0).any():
        raise InputError(f"poses {path}: the times do not rise")
    return CameraPath(path, poses, tuple(times.tolist()))
