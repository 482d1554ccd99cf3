"""The first frame of a clip under every preset, held against the expected picture.

`make golden` renders them anew.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from arfx.config.load import load
from arfx.measure.verification import read_tolerance
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene
from tests.golden.pictures import (
    PRESETS,
    SCENES,
    broken_bounds,
    differences,
    frames_side_by_side,
    read_rgb,
    write_failure,
)

SCENE = SCENES / "0041-indirect-light"


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return source_clip(tmp_path_factory.mktemp("clip"))


def source_clip(folder: Path) -> Path:
    whole = load_scene(SCENE / "scene.toml")
    short = whole.model_copy(
        update={"shot": (whole.shot[0].model_copy(update={"frames": 4}),)}
    )
    make_clip(short, folder, lambda *_: None, overwrite=True, truth_pictures=False)
    return folder


def first_frame(preset: Path, clip: Path, work: Path) -> np.ndarray:
    changed = tomllib.loads(preset.read_text())
    changed["output"] = {"path": str(work / "out.mkv"), "codec": "ffv1"}
    process(
        load(clip / "job.toml", changed, parameters()),
        Options(overwrite=True, notice=lambda _: None),
    )
    return frames_side_by_side(work / "out.mkv", [0])


def expected_file(preset: Path) -> Path:
    return Path(__file__).parent / "presets" / f"{preset.stem}.png"


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_preset_gives_the_expected_picture(
    preset: Path, clip: Path, tmp_path: Path
) -> None:
    actual, expected = (
        first_frame(preset, clip, tmp_path),
        read_rgb(expected_file(preset)),
    )
    broken = broken_bounds(
        differences(actual, expected), read_tolerance(SCENE)["golden"]
    )
    assert not broken, (
        f"{broken}: see {write_failure(f'preset-{preset.stem}', actual, expected)}"
    )
