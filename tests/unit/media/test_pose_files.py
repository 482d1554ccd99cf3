"""Camera poses that come with the footage."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from arfx.errors import InputError
from arfx.media.pose_files import load_poses


def test_lines_in_order_and_their_inverse(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text(
        "# tx ty tz qx qy qz qw\n1 2 3 0 0 0 1\n\n0,0,0, 0.70710678,0,0,0.70710678\n"
    )
    told = load_poses(path)
    assert told.times_s is None and len(told.given_from_camera) == 2
    np.testing.assert_allclose(told.given_from_camera[0].translation_m, [1, 2, 3])
    # camera turned by 90 degrees about x: its z is the world's -y
    np.testing.assert_allclose(
        told.given_from_camera[1].apply(np.array([0, 0, 1.0])),
        [0, -1, 0],
        atol=1e-7,
    )
    assert told.of_frames([0.1], 1, True, 0.5) == [
        (told.given_from_camera[1].inverse(), True)
    ]
    with pytest.raises(InputError, match="hold 2 lines"):
        told.of_frames([0.0, 0.1, 0.2], 0, True, 0.5)


def lines(times: list[float]) -> str:
    """The camera moves by 1 m and turns by 0.4 rad about z in a second."""
    return "".join(
        f"{1305 + t} {t} 0 0 0 0 {math.sin(0.2 * t)} {math.cos(0.2 * t)}\n"
        for t in times
    )


def test_frames_between_lines_are_interpolated_and_told_from_measured_ones(
    tmp_path: Path,
) -> None:
    path = tmp_path / "p.txt"
    path.write_text(lines([0.0, 0.4, 0.8, 1.2, 2.4]))
    times = [k / 10 for k in range(26)]
    got = load_poses(path).of_frames(times, 7, False, 0.5)
    assert [t for t, g in zip(times, got, strict=True) if g and g[1]] == [
        0.0,
        0.4,
        0.8,
        1.2,
        2.4,
    ]
    assert [t for t, g in zip(times, got, strict=True) if g is None] == [
        *times[13:24],
        2.5,
    ]  # a gap too long, and the end
    for t, g in zip(times, got, strict=True):
        if g is not None:
            seen = g[0].inverse()
            np.testing.assert_allclose(seen.translation_m, [t, 0, 0], atol=1e-9)
            np.testing.assert_allclose(seen.rotvec, [0, 0, 0.4 * t], atol=1e-9)


def test_lines_as_dense_as_frames_are_measured_and_sparse_ones_are_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / "p.txt"
    path.write_text(lines([0.01, 0.11, 0.21, 0.31]))
    assert [
        g and g[1]
        for g in load_poses(path).of_frames([0.0, 0.1, 0.2, 0.3, 0.4], 0, True, 0.5)
    ] == [True] * 4 + [None]
    path.write_text(lines([0, 1, 2, 3]))
    with pytest.raises(InputError, match="are 1 s apart"):
        load_poses(path).of_frames([0.0, 0.1, 0.2], 0, True, 0.5)


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


def test_a_message_does_not_hold_a_file(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("0 " * 100_000)
    with pytest.raises(InputError, match="line 1") as e:
        load_poses(path)
    assert len(str(e.value)) < 1000
    assert len(str(InputError("x" * 10**6, "y" * 10**6))) < 6000
