"""A clip's analysis that is interrupted leaves the same bytes as one that is not, whatever the clip and its checkpoint."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from arfx.analyse.fold import AnalysisJob
from arfx.core import codec
from arfx.core.facts import write_facts
from arfx.media.clip import probe
from arfx.run import analysis
from arfx.run.analysis import AnalysisPass, Checkpoint, analyse_clip
from arfx.run.folder import JobFolder
from tests.clips import MARKER, clip_camera, write_clip

FRAMES = 40
OF = ["key", "marker", "markers", "pose", "light"]


@pytest.fixture(autouse=True)
def at_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "CHECKPOINT_S", -1.0)


def gap(path: Path) -> Path:
    return write_clip(path / "gap.mp4", FRAMES, absent=range(20, 24))


def cut_short(path: Path) -> Path:
    """Between two frames: what is missing shows only when all frames from the first on are counted."""
    whole = write_clip(path / "whole.mov", FRAMES, codec="mjpeg", pixel_format="yuvj420p", container={"movflags": "faststart"})
    with av.open(str(whole)) as c:
        ends = [p.pos for p in c.demux(video=0) if p.size]
    (path / "short.mov").write_bytes(whole.read_bytes()[: ends[-2]])
    return path / "short.mov"


def begins_again(path: Path) -> Path:
    """Times go back to the first one in the middle: they are repaired, each after the one before."""
    one = write_clip(path / "one.ts", FRAMES // 2).read_bytes()
    two = write_clip(path / "two.ts", FRAMES // 2, container={"mpegts_flags": "initial_discontinuity"}).read_bytes()
    (path / "twice.ts").write_bytes(one + two)
    return path / "twice.ts"


def analysed(clip: Path, job: Path, stop: int | None = None, folds: frozenset[str] = frozenset()) -> AnalysisPass:
    """Raises KeyboardInterrupt at frame `stop`."""

    def progress(phase: str, done: int, total: int | None) -> None:
        if done == stop:
            raise KeyboardInterrupt

    job.mkdir(exist_ok=True)
    return analyse_clip(
        probe(clip), AnalysisJob((MARKER,), clip_camera()), {"light", *folds}, (None, None), progress, JobFolder(job), "key"
    )


def written(done: AnalysisPass, path: Path) -> tuple[Any, ...]:
    write_facts(path, done.analysis.facts)
    about = replace(done.analysis, facts=())
    return path.read_bytes(), about, done.span.pts, done.span.keys, done.span.whole, done.truncated


ASKED: frozenset[str] = frozenset({"environment", "lens"})


@pytest.mark.parametrize(
    ("make", "folds", "stops"),
    [(gap, ASKED, (2, 3, 13, 23, 39)), (cut_short, frozenset(), (5, 21)), (begins_again, frozenset(), (2, 6))],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_an_interrupted_analysis_leaves_the_same_bytes(
    make: Callable[[Path], Path], folds: frozenset[str], stops: tuple[int, ...], tmp_path: Path
) -> None:
    clip = make(tmp_path)
    whole = written(analysed(clip, tmp_path / "whole", None, folds), tmp_path / "whole.jsonl")
    assert len(whole[2]) > 0.9 * FRAMES and (make is cut_short) == (whole[5] is not None)
    for stop in stops:  # one job, interrupted again and again
        with pytest.raises(KeyboardInterrupt):
            analysed(clip, tmp_path / "often", stop, folds)
    resumed = analysed(clip, tmp_path / "often", None, folds)
    assert written(resumed, tmp_path / "often.jsonl") == whole


def test_a_checkpoint_of_anything_else_is_passed_over(tmp_path: Path) -> None:
    clip, job = gap(tmp_path), JobFolder(tmp_path / "job")
    whole = written(analysed(clip, tmp_path / "whole"), tmp_path / "whole.jsonl")
    with pytest.raises(KeyboardInterrupt):
        analysed(clip, job.path, 30)
    good = job.checkpoint.read_bytes()
    assert Checkpoint(job.checkpoint, OF).read() is not None
    bad = [
        b"", b'{"key": "key", "pts": [0], "state": {}}', good[:-1], good[:1000] + b"\xff" + good[1001:],
        good.replace(b"state 1", b"state 0"), codec.dumps({"of": ["other", *OF[1:]], "state": {}}), codec.dumps([1]),
        codec.dumps({"of": ["key", "plane", *OF[2:]], "state": {}}), codec.dumps({"of": OF, "state": np.zeros(1)}),
    ]  # fmt: skip
    for data in bad:
        job.checkpoint.write_bytes(data)
        assert Checkpoint(job.checkpoint, OF).read() is None
    assert written(analysed(clip, job.path), tmp_path / "again.jsonl") == whole
    job.checkpoint.unlink()
    job.checkpoint.mkdir()
    assert Checkpoint(job.checkpoint, OF).read() is None
    shutil.rmtree(job.path)


def test_what_is_slow_to_write_down_is_written_less_often(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(analysis, "CHECKPOINT_S", 20.0)
    monkeypatch.setattr(analysis.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(analysis, "write", lambda path, data: now.__setitem__(0, now[0] + 3.0))
    kept = Checkpoint(tmp_path / "c", OF)
    now[0] = 20.5
    assert kept.due()
    kept.write({})
    now[0] = 23.5 + 59.0
    assert not kept.due()
    now[0] += 2.0
    assert kept.due()
