"""Camera poses that come with the footage: text of `tx ty tz qx qy qz qw`, the camera in
the world, as RGB-D sets write them.

One line a frame, in order; or with the time in seconds before it (TUM RGB-D), and poses are
interpolated between lines. `#` begins a comment.
Axes of the camera: x right, y down, z forward."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arfx.core.opener import read_text
from arfx.core.pose import Pose, rotation_from_quaternion
from arfx.errors import InputError
from arfx.media.clip import Match, match_by_time, match_in_order, spacing_s

# metres or seconds: times count from 1970, nothing is farther than that in metres
_MAX_VALUE = 1e12
_ROUNDING_S = 1e-3  # of times in text
_UNIT_TOLERANCE = 1e-2  # from 1, of a quaternion's length


@dataclass(frozen=True, eq=False)
class CameraPath:
    """camera_from_given : in order;  times_s : after the first one, None = one for each
    frame of the clip
    """

    path: Path
    camera_from_given: tuple[Pose, ...]
    times_s: tuple[float, ...] | None

    def of_frames(
        self, times_s: list[float], before: int, whole: bool, gap_s: float
    ) -> list[tuple[Pose, bool] | None]:
        """Each frame's pose and whether one was taken at its time, else it lies between
        two; None where none is near.
        times_s : after the clip's first frame;  before, whole : as of `in_order`, which
        raises InputError
        gap_s : longest time between two poses that is bridged. Raises InputError where they
        usually are farther apart.
        """
        given = self.camera_from_given
        if self.times_s is None:
            what, held = f"poses {self.path} hold {len(given)} lines", len(given)
            hint = "one line for each frame, or the time in seconds before each pose"
            found = match_in_order(what, held, len(times_s), before, whole, hint)
            return [None if k is None else (given[k], True) for k in found]
        spacing, usual = spacing_s(times_s), spacing_s(self.times_s)
        if usual > gap_s + spacing:
            raise InputError(
                f"poses {self.path} are {usual:g} s apart: over more than {gap_s:g} s it is"
                " not known how the camera moved",
                "a pose for each frame, or at least several a second",
            )
        near_s, taken_s = 0.5 * spacing + _ROUNDING_S, np.array(self.times_s)
        return [
            None if m is None else (self._between(m), m.near)
            for m in match_by_time(taken_s, times_s, near_s, gap_s + spacing)
        ]

    def _between(self, m: Match) -> Pose:
        first, second = (
            self.camera_from_given[m.before],
            self.camera_from_given[m.after],
        )
        if m.share in (0.0, 1.0):
            return second if m.share else first
        # the camera moves straight, not the world
        return first.inverse().towards(second.inverse(), m.share).inverse()


def load_poses(path: Path) -> CameraPath:
    """Raises InputError: missing, a line that is no pose, times that do not rise."""
    text = read_text(path, "poses")
    given = [
        (n, words)
        for n, line in enumerate(text.splitlines(), 1)
        if (words := line.split("#")[0].replace(",", " ").split())
    ]
    if not given:
        raise InputError(
            f"poses {path} hold no line", "text lines of tx ty tz qx qy qz qw"
        )
    columns = len(given[0][1])
    for number, words in given:
        if len(words) != columns or columns not in (7, 8) or not _is_pose(words):
            what = f"{' '.join(words[:9])[:200]!r} is not a pose"
            hint = "tx ty tz qx qy qz qw, perhaps the time before them"
            raise InputError(f"poses {path}, line {number}: {what}", hint)
    table = np.array([words for _, words in given], float)
    q = table[:, -4:] / np.linalg.norm(table[:, -4:], axis=1, keepdims=True)
    turned = np.swapaxes(rotation_from_quaternion(np.roll(q, 1, 1)), 1, 2)
    moved = -np.einsum("nij,nj->ni", turned, table[:, -7:-4])
    poses = tuple(map(Pose, turned, moved))
    if columns == 7:
        return CameraPath(path, poses, None)
    times = table[:, 0] - table[0, 0]
    if (np.diff(times) <= 0).any():
        raise InputError(f"poses {path}: the times do not rise")
    return CameraPath(path, poses, tuple(times.tolist()))


def _is_pose(words: list[str]) -> bool:
    try:
        values = [float(w) for w in words]
    except ValueError:
        return False
    return (
        all(abs(v) <= _MAX_VALUE for v in values)
        and abs(math.hypot(*values[-4:]) - 1) <= _UNIT_TOLERANCE
    )
