"""Every sample scene through the whole job: its truth figures within bounds, its chosen
frames as expected.

`make golden` renders the expected pictures anew. A failure leaves actual, expected and
difference in failed/NAME."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from arfx.measure.verification import read_tolerance
from tests.golden.pictures import (
    FAILED,
    SCENES,
    broken_bounds,
    differences,
    frames_side_by_side,
    read_rgb,
    verified,
    write_failure,
)

NAMES = sorted(p.name for p in SCENES.iterdir() if (p / "scene.toml").is_file())


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scene_matches_its_truth_and_its_golden_frames(
    name: str, tmp_path: Path
) -> None:
    scene = SCENES / name
    done = verified(scene, tmp_path)
    golden = read_tolerance(scene)["golden"]
    actual, expected = (
        frames_side_by_side(done.output, golden["frames"]),
        read_rgb(scene / "expected.png"),
    )
    broken = [*done.broken, *broken_bounds(differences(actual, expected), golden)]
    if broken:
        broken.append(f"see {write_failure(name, actual, expected)}")
    else:
        shutil.rmtree(FAILED / name, ignore_errors=True)
    assert not broken, "\n".join(broken)


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_states_bounds_and_reasons(name: str) -> None:
    tolerance = read_tolerance(SCENES / name)
    assert (
        len(tolerance["golden"]["reason"]) > 20
        and len(tolerance["truth"]["reason"]) > 20
    )
    assert tolerance["golden"]["frames"]
    assert tolerance["truth"]["max"]["arfx.flips"] == 0
    for key in (
        "arfx.rotation_deg.median",
        "arfx.position_mm.median",
        "arfx.corner_px",
    ):
        assert tolerance["truth"]["max"][key] > 0


@pytest.mark.parametrize(
    "fault",
    [
        "model gone",
        "shadow gone",
        "faint shadow gone",
        "moved two pixels",
        "other colour",
    ],
)
def test_the_comparison_rejects_what_an_eye_rejects(fault: str) -> None:
    scene = SCENES / "0001-orbit"
    expected, golden = (
        read_rgb(scene / "expected.png"),
        read_tolerance(scene)["golden"],
    )
    h, w = expected.shape[:2]
    box = (slice(h // 3, 2 * h // 3), slice(w // 5, 3 * w // 10))
    actual = expected.copy()
    if fault == "model gone":
        actual[box] = np.median(expected.reshape(-1, 3), axis=0)
    elif fault == "shadow gone":
        actual[box] = np.clip(actual[box] * 1.35, 0, 255)
    elif fault == "faint shadow gone":
        actual[box] = np.clip(actual[box] * 1.1, 0, 255)
        found = differences(actual, expected)
        assert found["delta_e_p999"] < golden["delta_e_p999"], "too faint for that"
    elif fault == "moved two pixels":
        actual[box] = np.roll(expected, 2, axis=1)[box]
    else:
        actual[box] = actual[box][..., ::-1]
    assert broken_bounds(differences(actual, expected), golden)


def test_the_comparison_accepts_the_same_picture_and_one_grey_level() -> None:
    scene = SCENES / "0001-orbit"
    expected, golden = (
        read_rgb(scene / "expected.png"),
        read_tolerance(scene)["golden"],
    )
    assert not broken_bounds(differences(expected, expected), golden)
    nearly = np.clip(
        expected.astype(int)
        + np.random.default_rng(0).integers(-1, 2, expected.shape),
        0,
        255,
    ).astype(np.uint8)
    assert not broken_bounds(differences(nearly, expected), golden)
