"""Which markers are believed, how they are named, and their tilt."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.marker import FAMILIES, MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.measure.inspection import Found, confirmed, smallest_family, suggestion, tilt_deg

QUAD = np.array([[100.0, 100], [180, 100], [180, 180], [100, 180]])


def found(family: str, number: int, frames: int, quad: np.ndarray = QUAD) -> dict[str, Found]:
    every = list(range(frames))
    return {f"{family}:{number}": Found(family, number, every, [80.0] * frames, quads=dict.fromkeys(every, quad))}


def names(markers: list[Found]) -> list[str]:
    return [f"{m.family}:{m.id}" for m in markers]


@pytest.mark.parametrize(
    ("family", "highest", "name"),
    [("4X4_1000", 0, "4X4_50"), ("4X4_1000", 49, "4X4_50"), ("4X4_1000", 50, "4X4_100"), ("6X6_1000", 249, "6X6_250"),
     ("7X7_1000", 999, "7X7_1000"), ("36h11", 3, "36h11"), ("MIP_36h12", 7, "MIP_36h12"), ("ORIGINAL", 9, "ORIGINAL")],
)  # fmt: skip
def test_a_marker_is_named_by_the_smallest_dictionary(family: str, highest: int, name: str) -> None:
    assert smallest_family(family, highest) == name and highest < FAMILIES[name]


def test_nested_dictionaries_share_their_codes() -> None:
    """What the naming rests on: a marker of a small dictionary is the same print in the large one."""
    for n in (4, 5, 6, 7):
        sheets = [
            cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{n}X{n}_{k}")), 37, 60)
            for k in (50, 100, 250, 1000)
        ]
        assert all((s == sheets[0]).all() for s in sheets)


def test_markers_of_one_sheet_are_named_by_one_dictionary() -> None:
    both = found("4X4_1000", 3, 5) | found("4X4_1000", 77, 4, QUAD + 300)
    assert names(confirmed(both, 10)) == ["4X4_100:3", "4X4_100:77"]


def test_weak_codes_in_few_frames_are_not_believed() -> None:
    seen = found("16h5", 4, 2) | found("36h11", 9, 1, QUAD + 400)
    assert names(confirmed(seen, 20)) == ["36h11:9"]
    assert names(confirmed(found("16h5", 4, 4), 20)) == ["16h5:4"]
    assert names(confirmed(found("16h5", 4, 1), 1)) == ["16h5:4"], "a clip of one frame cannot show it more often"


def test_one_print_read_by_two_dictionaries_is_one_marker() -> None:
    twice = found("36h11", 3, 10) | found("5X5_1000", 812, 4, QUAD + 2)
    assert names(confirmed(twice, 10)) == ["36h11:3"]
    apart = found("36h11", 3, 10) | found("5X5_1000", 812, 4, QUAD + 150)
    assert len(confirmed(apart, 10)) == 2


@pytest.mark.parametrize("tilt", [20.0, 45.0, 70.0])
def test_tilt_is_the_angle_to_the_line_of_sight(tilt: float) -> None:
    camera = Camera(640, 480, np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]))
    pose = Pose(rotation_from_euler_deg(180 - tilt, 0, 0), np.array([0, 0, 0.6]))
    corners = camera.project(pose.apply(MarkerSpec("36h11", 0, 0.1).corners_m))
    assert tilt_deg(corners, camera) == pytest.approx(tilt, abs=0.01)
    assert tilt_deg(np.full((4, 2), np.nan), camera) is None


def test_the_suggestion_is_a_command_that_a_shell_takes(tmp_path_factory: pytest.TempPathFactory) -> None:
    import shlex
    from pathlib import Path

    document = {"markers": [{"marker": "36h11:3"}, {"marker": "4X4_50:0"}]}
    words = shlex.split(suggestion(document, Path("my clip.mp4"), Path("a b.yaml")))
    assert words[:5] == ["arfx", "process", "my clip.mp4", "--camera", "a b.yaml"]
    assert [words[i + 1] for i, w in enumerate(words) if w == "--marker"] == ["36h11:3:SIZE", "4X4_50:0:SIZE"]
    assert suggestion({"markers": []}, Path("c.mp4"), None) == ""
