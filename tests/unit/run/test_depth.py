"""Real depth in a job: what the facts are told of it, and when it is an error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.analyse.depth.scale import with_depth
from arfx.analyse.job import Analysis, AnalysisJob
from arfx.errors import InputError
from arfx.media.depth_maps import open_depth
from tests.scenes import facts, scene


def quiet(phase: str, done: int, total: int | None) -> None:
    assert phase == "depth" and total is not None and done <= total


def test_facts_say_which_map_and_what_is_in_it(tmp_path: Path) -> None:
    s = scene()
    for k, metres in enumerate((1.0, 2.0, 0.0)):
        cv2.imwrite(
            str(tmp_path / f"{k}.png"), np.full((60, 80), metres * 1000, np.uint16)
        )
    maps = open_depth(tmp_path)
    frames = [facts(s, index=k) for k in range(4)]
    clip = Analysis(tuple(frames), s.world_from_marker)
    job = AnalysisJob((), s.camera, align=False, progress=quiet)
    found = with_depth(clip, job, maps, [0, 1, 2, None])
    out, told = found.facts, found.summary["depth"]
    assert (
        told["known"]
        and told["frames_with"] == 2
        and told["frames_without"] == 2
        and told["holes"] == pytest.approx(1 / 3)
    )
    second = out[1].real_depth
    assert second is not None and second.map == 1 and out[0].real_depth is not None
    assert len({f.real_depth.digest for f in out[:2] if f.real_depth}) == 2
    assert second.dioptre_range == pytest.approx((0.5, 0.5), rel=2e-3)
    assert out[2].real_depth is None and out[3].real_depth is None
    refused = with_depth(clip, replace(job, align=True), maps, [0, 1, 2, None])
    assert not refused.summary["depth"]["known"] and len(refused.notices) == 1
    assert all(f.real_depth is None for f in refused.facts)


def test_depth_that_holds_nothing_is_an_error(tmp_path: Path) -> None:
    s = scene()
    cv2.imwrite(str(tmp_path / "none.png"), np.zeros((60, 80), np.uint16))
    clip = Analysis((facts(s),), s.world_from_marker)
    job, maps = (
        AnalysisJob((), s.camera, progress=quiet),
        open_depth(tmp_path / "none.png"),
    )
    with pytest.raises(InputError, match="no valid pixel"):
        with_depth(clip, job, maps, [0])
    with pytest.raises(InputError, match="near the time of any frame"):
        with_depth(clip, job, maps, [None])
