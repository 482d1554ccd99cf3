"""Camera poses that come with the footage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx.errors import InputError
from arfx.media.pose_files import load_poses


def test_lines_in_order_and_their_inverse(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("# tx ty tz qx qy qz qw\n1 2 3 0 0 0 1\n\n0,0,0, 0.70710678,0,0,0.70710678\n")
    told = load_poses(path)
    assert told.times_s is None and len(told.camera_from_given) == 2
    np.testing.assert_allclose(told.camera_from_given[0].translation_m, [-1, -2, -3])
    # camera turned by 90 degrees about x: its z is the world's -y
    np.testing.assert_allclose(told.camera_from_given[1].inverse().apply(np.array([0, 0, 1.0])), [0, -1, 0], atol=1e-7)
    assert told.of_frames([0.1], 1, True) == [told.camera_from_given[1]]
    with pytest.raises(InputError, match="hold 2 lines"):
        told.of_frames([0.0, 0.1, 0.2], 0, True)


def test_lines_by_time(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("".join(f"{1305.0 + 0.1 * k} {k} 0 0 0 0 0 1\n" for k in range(5)))
    told = load_poses(path)
    got = told.of_frames([0.0, 0.13, 0.39, 0.6], 7, False)
    assert [None if p is None else -round(p.translation_m[0]) for p in got] == [0, 1, 4, None]


WRONG = (
    "", "1 2 3\n", "1 2 3 0 0 0 0\n", "a b c d e f g\n", "1 2 3 0 0 nan 1\n", "0 1 2 3 0 0 0 1\n1 2 3 0 0 0 1\n",
    "1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "0 0 0 0 0 -1e308 1\n",
)  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("text", WRONG)
def test_what_is_no_pose_is_said(text: str, tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text(text)
    with pytest.raises(InputError):
        load_poses(path)
    with pytest.raises(InputError):
        load_poses(tmp_path / "none.txt")
