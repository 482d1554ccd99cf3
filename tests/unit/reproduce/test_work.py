"""Scenes, jobs and times for the papers' modules."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from arfx.errors import RenderError
from arfx.reproduce.work import AS_PRINTED, Clip, Work
from arfx.synth.description import parse_scene

SCENE = """
samples = 1
[clip]
width = 160
height = 96
[lens]
fov_deg = 50
[[shot]]
frames = 3
[[plane]]
size_m = [1.4, 1.2]
position_m = [0, 0, "-0.2mm"]
[[marker]]
spec = "36h11:3:150mm"
[model]
shape = "block"
fit = "12cm"
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Work, Clip]:
    work = Work(tmp_path_factory.mktemp("work"), short=True)
    return work, work.clip(parse_scene(SCENE, "scene"))


def test_a_clip_is_made_once_for_each_scene(made: tuple[Work, Clip]) -> None:
    work, clip = made
    assert (
        work.clip(parse_scene(SCENE, "scene")).folder
        == clip.folder
        != work.clip(parse_scene(SCENE.replace("150mm", "140mm"), "scene")).folder
    )
    assert len(clip.frames()) == 3 and clip.frames()[0].shape == (96, 160, 3)


def test_a_frame_is_rendered_under_either_formula(made: tuple[Work, Clip]) -> None:
    work, clip = made
    printed, corrected = work.shot(clip, AS_PRINTED, 1), work.shot(clip, index=1)
    assert printed.job.stages["lightmap"].params.formula == "paper"
    pictures = [shot.picture() for shot in (printed, corrected)]
    assert pictures[0].shape == (96, 160, 3)
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() > 8
    assert work.planned(clip, AS_PRINTED) is printed.job
    assert corrected.up_to("raster")[-1][0].name == "raster"


def test_what_runs_apart_has_a_process_of_its_own(made: tuple[Work, Clip]) -> None:
    work, _ = made
    assert work.apart(os.getpid) != os.getpid()
    with pytest.raises(RenderError, match="was killed"):
        work.apart(os._exit, 1)


def test_the_scale_of_work(tmp_path: Path) -> None:
    assert (Work(tmp_path).scaled(9, 1), Work(tmp_path, short=True).scaled(9, 1)) == (
        9,
        1,
    )
