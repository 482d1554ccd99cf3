"""Which markers are believed, how they are named, and their tilt."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.markers.detect import SCANNED_FAMILIES, MarkerDetector
from arfx.core.camera import Camera
from arfx.core.marker import FAMILIES, MarkerSpec, smallest_family
from arfx.core.marker_codes import cells_per_side, dictionary
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.measure.inspection import (
    MIN_SIDE_PX,
    Found,
    _record,
    confirmed,
    relative_size,
    size_names,
    suggestion,
    tilt_deg,
)

QUAD = np.array([[100.0, 100], [180, 100], [180, 180], [100, 180]])


def found(
    family: str, number: int, frames: int, quad: np.ndarray = QUAD, sure: bool = False
) -> dict[str, Found]:
    every = list(range(frames))
    quads = {k: [quad] for k in every}
    return {
        f"{family}:{number}": Found(
            family,
            number,
            [80.0] * frames,
            quads=quads,
            counted=set(every),
            sure=sure,
        )
    }


def sheet(
    *prints: tuple[str, int, tuple[int, int]], wrong: int = 0, paper: int = 230
) -> np.ndarray:
    """(480, 640) luma: prints of 12 px a cell, their corner at (x, y), each with so many
    wrong bits.
    """
    page = np.full((480, 640), paper, np.uint8)
    for family, number, (x, y) in prints:
        n = cells_per_side(family)
        cells = dictionary(family).generateImageMarker(number, n)
        cells[1, 1 : 1 + wrong] = 255 - cells[1, 1 : 1 + wrong]
        page[y : y + 12 * n, x : x + 12 * n] = np.kron(
            20 + cells // 255 * 200, np.ones((12, 12))
        )
    noise = np.random.default_rng(1).normal(0, 2, page.shape)
    return np.clip(cv2.GaussianBlur(page, (0, 0), 1.0) + noise, 0, 255).astype(
        np.uint8
    )


def looked_at(*frames: np.ndarray) -> tuple[list[str], list[str]]:
    """Markers found in these frames, and what is left out."""
    seen: dict[str, Found] = {}
    for k, luma in enumerate(frames):
        _record(
            seen,
            MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX).search(luma),
            k,
            luma,
            None,
        )
    kept, left_out = confirmed(seen)
    return names(kept), names(left_out)


def names(markers: list[Found]) -> list[str]:
    return [f"{m.family}:{m.id}" for m in markers]


@pytest.mark.parametrize(
    ("family", "highest", "name"),
    [("4X4_1000", 0, "4X4_50"), ("4X4_1000", 49, "4X4_50"), ("4X4_1000", 50, "4X4_100"), ("6X6_1000", 249, "6X6_250"),
     ("7X7_1000", 999, "7X7_1000"), ("36h11", 3, "36h11"), ("MIP_36h12", 7, "MIP_36h12"), ("ORIGINAL", 9, "ORIGINAL")],
)  # fmt: skip
def test_a_marker_is_named_by_the_smallest_dictionary(
    family: str, highest: int, name: str
) -> None:
    assert smallest_family(family, highest) == name and highest < FAMILIES[name]


def test_nested_dictionaries_share_their_codes() -> None:
    """What the naming rests on: a marker of a small dictionary is the same print in the
    large one.
    """
    for n in (4, 5, 6, 7):
        sheets = [
            cv2.aruco.generateImageMarker(
                cv2.aruco.getPredefinedDictionary(
                    getattr(cv2.aruco, f"DICT_{n}X{n}_{k}")
                ),
                37,
                60,
            )
            for k in (50, 100, 250, 1000)
        ]
        assert all((s == sheets[0]).all() for s in sheets)


def test_markers_of_one_sheet_are_named_by_one_dictionary() -> None:
    both = found("4X4_1000", 3, 5) | found("4X4_1000", 77, 4, QUAD + 300)
    assert names(confirmed(both)[0]) == ["4X4_100:3", "4X4_100:77"]


def test_what_is_in_few_frames_and_not_plain_is_left_out() -> None:
    seen = found("16h5", 4, 2) | found("36h11", 9, 1, QUAD + 400, sure=True)
    kept, left_out = confirmed(seen)
    assert (
        names(kept) == ["36h11:9"]
        and names(left_out) == ["16h5:4"]
        and "not plain" in left_out[0].why
    )
    assert names(confirmed(found("16h5", 4, 3))[0]) == ["16h5:4"]


def test_one_print_read_by_two_dictionaries_is_one_marker() -> None:
    twice = found("36h11", 3, 10) | found("5X5_1000", 812, 4, QUAD + 2)
    assert names(confirmed(twice)[0]) == ["36h11:3"]
    apart = found("36h11", 3, 10) | found("5X5_1000", 812, 4, QUAD + 150)
    assert len(confirmed(apart)[0]) == 2


@pytest.mark.parametrize(
    "other",
    [
        QUAD.mean(0) + 0.2 * (QUAD - QUAD.mean(0)) + 25,
        QUAD.mean(0) + 2 * (QUAD - QUAD.mean(0)),
    ],
)
def test_a_code_in_or_around_a_marker_is_left_out(other: np.ndarray) -> None:
    kept, left_out = confirmed(
        found("36h11", 3, 10, sure=True) | found("4X4_1000", 17, 9, other, sure=True)
    )
    assert names(kept) == ["36h11:3"] and [m.why for m in left_out] == [
        "read in the place of 36h11:3"
    ]


@pytest.mark.parametrize("family", ["36h11", "4X4_50", "16h5", "5X5_100"])
def test_a_plain_print_is_found_in_one_frame(family: str) -> None:
    assert looked_at(sheet((family, 7, (100, 100)))) == (
        [f"{smallest_family(family, 7)}:7"],
        [],
    )


def test_a_code_of_few_bits_with_a_wrong_one_is_no_marker() -> None:
    """OpenCV corrects it, in every frame of a clip that stands; a long code may have one."""
    page = sheet(("16h5", 4, (100, 100)), wrong=1)
    assert looked_at(page) == ([], ["16h5:4"]) == looked_at(page, page, page, page)
    assert looked_at(sheet(("36h11", 4, (100, 100)), wrong=1)) == (["36h11:4"], [])


def test_a_code_without_a_white_margin_counts_only_in_three_frames() -> None:
    page = sheet(("4X4_50", 4, (100, 100)))
    page[60:210, 60:80] = page[60:80, 60:210] = (
        20  # dark up to a few pixels from the print
    )
    page[60:210, 92:97] = 20
    assert looked_at(page) == ([], ["4X4_50:4"])
    assert looked_at(page, page, page) == (["4X4_50:4"], [])


@pytest.mark.parametrize("tilt", [20.0, 45.0, 70.0])
def test_tilt_is_the_angle_to_the_line_of_sight(tilt: float) -> None:
    camera = Camera(640, 480, np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]))
    pose = Pose(rotation_from_euler_deg(180 - tilt, 0, 0), np.array([0, 0, 0.6]))
    corners = camera.project(pose.apply(MarkerSpec("36h11", 0, 0.1).corners_m))
    assert tilt_deg(corners, camera) == pytest.approx(tilt, abs=0.01)
    assert tilt_deg(np.full((4, 2), np.nan), camera) is None


def test_prints_of_other_sizes_in_one_plane_have_a_size_of_their_own() -> None:
    """12 px a cell: 96 px of 8 cells, 72 of 6; seen at a slant, and one moved out of the plane."""
    page = sheet(
        ("36h11", 7, (60, 60)), ("4X4_50", 3, (300, 80)), ("36h11", 5, (420, 300))
    )
    corners = np.array([[0, 0], [640, 0], [640, 480], [0, 480]], np.float32)
    slanted = np.array([[30, 20], [600, 60], [620, 460], [10, 420]], np.float32)
    h = cv2.getPerspectiveTransform(corners, slanted)
    luma = cv2.warpPerspective(page, h, (640, 480), borderValue=230)
    seen: dict[str, Found] = {}
    _record(
        seen,
        MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX).search(luma),
        0,
        luma,
        None,
    )
    first, small, same = (seen[k] for k in ("36h11:7", "4X4_1000:3", "36h11:5"))
    assert relative_size(first, small) == pytest.approx(0.75, abs=0.02)
    assert relative_size(first, same) == pytest.approx(1.0, abs=0.02)
    small.quads[0][0][2] += [12, 9]
    assert relative_size(first, small) is None
    sizes = (1.0, 0.75, None, 0.74, 2.0, 1.02)
    names = size_names([{"size_of_first": size} for size in sizes])
    assert names == ["SIZE", "SIZE2", "SIZE", "SIZE2", "SIZE3", "SIZE"]


def test_the_suggestion_is_a_command_that_a_shell_takes(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    import shlex
    from pathlib import Path

    document = {
        "clip": {"container": "mov"},
        "markers": [
            {"marker": "36h11:3", "size_of_first": 1.0},
            {"marker": "4X4_50:0", "size_of_first": 0.5},
        ],
    }
    words = shlex.split(suggestion(document, Path("my clip.mp4"), Path("a b.yaml")))
    assert words[:5] == ["arfx", "process", "my clip.mp4", "--camera", "a b.yaml"]
    assert [words[i + 1] for i, w in enumerate(words) if w == "--marker"] == [
        "36h11:3:SIZE",
        "4X4_50:0:SIZE2",
    ]
    assert suggestion({"markers": []}, Path("c.mp4"), None) == ""
