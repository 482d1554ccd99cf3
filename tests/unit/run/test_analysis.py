"""A clip's analysis that is interrupted leaves the same bytes as one that is not, whatever
the clip and what is left of it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from arfx.analyse.job import Analysis, AnalysisJob
from arfx.analyse.tables import from_bytes, to_bytes
from arfx.core.facts import write_facts
from arfx.media.clip import probe
from arfx.run import stretches
from arfx.run.analysis import analyse_clip
from arfx.run.folder import JobFolder
from arfx.run.planned import DecodedFrames
from arfx.run.stretches import Span
from tests.clips import MARKER, clip_camera, write_clip

FRAMES = 40
Analysed = tuple[Analysis, DecodedFrames]


@pytest.fixture(autouse=True)
def short_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stretches, "LEAST_FRAMES", 8)


def gap(path: Path) -> Path:
    return write_clip(
        path / "gap.mov",
        FRAMES,
        absent=range(20, 24),
        codec="mjpeg",
        pixel_format="yuvj420p",
    )  # of key frames


def cut_short(path: Path) -> Path:
    """Between two frames: what is missing shows only when all frames from the first on are
    counted.
    """
    whole = write_clip(
        path / "whole.mov",
        FRAMES,
        codec="mjpeg",
        pixel_format="yuvj420p",
        container={"movflags": "faststart"},
    )
    with av.open(str(whole)) as c:
        ends = [p.pos for p in c.demux(video=0) if p.size]
    (path / "short.mov").write_bytes(whole.read_bytes()[: ends[-2]])
    return path / "short.mov"


def begins_again(path: Path) -> Path:
    """Times go back to the first one in the middle: they are repaired, each after the one
    before.
    """
    one = write_clip(path / "one.ts", FRAMES // 2).read_bytes()
    two = write_clip(
        path / "two.ts",
        FRAMES // 2,
        container={"mpegts_flags": "initial_discontinuity"},
    ).read_bytes()
    (path / "twice.ts").write_bytes(one + two)
    return path / "twice.ts"


def analysed(
    clip: Path,
    job: Path,
    stop: int | None = None,
    folds: frozenset[str] = frozenset(),
) -> Analysed:
    """Raises KeyboardInterrupt at frame `stop`."""

    def progress(phase: str, done: int, total: int | None) -> None:
        if done == stop:
            raise KeyboardInterrupt

    job.mkdir(exist_ok=True)
    return analyse_clip(
        Span(probe(clip)),
        AnalysisJob((MARKER,), clip_camera(), progress=progress),
        {"light", *folds},
        JobFolder(job),
        "key",
    )


def written(done: Analysed, path: Path) -> tuple[Any, ...]:
    analysis, frames = done
    write_facts(path, analysis.facts)
    about = replace(analysis, facts=())
    return path.read_bytes(), about, frames.pts, frames.truncated


ASKED: frozenset[str] = frozenset({"environment", "lens"})


@pytest.mark.parametrize(
    ("make", "folds", "stops"),
    [
        (gap, ASKED, (2, 3, 13, 23, 39)),
        (cut_short, frozenset(), (5, 21)),
        (begins_again, frozenset(), (2, 6)),
    ],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_an_interrupted_analysis_leaves_the_same_bytes(
    make: Callable[[Path], Path],
    folds: frozenset[str],
    stops: tuple[int, ...],
    tmp_path: Path,
) -> None:
    clip = make(tmp_path)
    whole = written(
        analysed(clip, tmp_path / "whole", None, folds), tmp_path / "whole.jsonl"
    )
    assert len(whole[2]) > 0.9 * FRAMES and (make is cut_short) == (
        whole[3] is not None
    )
    for stop in stops:  # one job, interrupted again and again
        with pytest.raises(KeyboardInterrupt):
            analysed(clip, tmp_path / "often", stop, folds)
    resumed = analysed(clip, tmp_path / "often", None, folds)
    assert written(resumed, tmp_path / "often.jsonl") == whole


def test_a_stretch_of_anything_else_is_made_anew(tmp_path: Path) -> None:
    clip, job = gap(tmp_path), JobFolder(tmp_path / "job")
    whole = written(analysed(clip, tmp_path / "whole"), tmp_path / "whole.jsonl")
    with pytest.raises(KeyboardInterrupt):
        analysed(clip, job.path, 30)
    first = min(job.stretches.iterdir())
    good = first.read_bytes()
    pts = from_bytes(good)["frames"]["pts"].tolist()
    assert pts == whole[2][: len(pts)]
    for data in (
        b"",
        good[:-1],
        good[:1000] + b"\xff" + good[1001:],
        to_bytes({"frames": {"pts": np.arange(3)}}),
    ):
        first.write_bytes(data)
        assert written(analysed(clip, job.path), tmp_path / "again.jsonl") == whole
        assert first.read_bytes() == good
    shutil.rmtree(job.path)


def test_stretches_that_are_there_are_not_made_again(tmp_path: Path) -> None:
    clip, job = gap(tmp_path), tmp_path / "job"
    with pytest.raises(KeyboardInterrupt):
        analysed(clip, job, 30)
    kept = {p.name: p.stat().st_mtime_ns for p in (job / "stretches").iterdir()}
    analysed(clip, job)
    now = {p.name: p.stat().st_mtime_ns for p in (job / "stretches").iterdir()}
    assert len(kept) == 3 and len(now) == 5 and kept.items() <= now.items()
