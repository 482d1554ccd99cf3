"""A clip that is analysed in stretches: the same bytes whoever makes them, and in whatever
order.
"""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from arfx.analyse.job import AnalysisJob
from arfx.config.load import load
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.run import stretches
from arfx.run.analysis import Run, analyse_clip, in_order
from arfx.run.executors import Results, Task, run_serial, run_threads
from arfx.run.folder import JobFolder
from arfx.run.inputs import open_inputs
from arfx.run.job import Options, plan_job
from arfx.run.parameters import parameters
from arfx.run.stretches import Span, Stretch, analyse_stretch, cut, whole
from tests.clips import (
    MARKER,
    clip_camera,
    picture,
    pose_at,
    write_camera,
    write_model,
)
from tests.unit.run.test_analysis import Analysed, written

FRAMES, KEYS, LEAST = 48, 12, 10
Make = Callable[[Path], Path]
ClipOf = Callable[[Make], Path]


@pytest.fixture(autouse=True)
def short_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stretches, "LEAST_FRAMES", LEAST)


@cache
def shown(i: int, elsewhere: bool) -> np.ndarray:
    return picture(
        pose_at(i + elsewhere * FRAMES, FRAMES), clip_camera(), 9 * elsewhere
    )


def encoded(
    path: Path,
    codec: str,
    options: dict[str, str],
    times: list[int] | None = None,
    cut_at: int = FRAMES,
) -> Path:
    """FRAMES frames with a marker that moves; from `cut_at` on elsewhere, before another ground."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=30)
        stream.width, stream.height = 320, 240
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.gop_size, stream.options = KEYS, options
        for i in range(FRAMES):
            frame = av.VideoFrame.from_ndarray(
                shown(i, i >= cut_at), format="rgb24"
            ).reformat(format=stream.pix_fmt)
            frame.pts = i if times is None else times[i]
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    return path


def x264(params: str) -> dict[str, str]:
    return {
        "preset": "veryfast",
        "x264-params": (
            f"keyint={KEYS}:min-keyint={KEYS}:scenecut=0:bframes=3:b-adapt=0:{params}"
        ),
    }


def open_gop(folder: Path) -> Path:
    return encoded(folder / "open.mp4", "libx264", x264("open-gop=1"))


def closed_gop(folder: Path) -> Path:
    return encoded(
        folder / "closed.mkv",
        "libx264",
        x264("open-gop=0"),
        [2 * i + (i % 3 == 1) for i in range(FRAMES)],
    )  # VFR


def hevc(folder: Path) -> Path:
    params = f"keyint={KEYS}:min-keyint={KEYS}:scenecut=0:open-gop=1:bframes=3:log-level=none:pools=1:frame-threads=1"
    return encoded(
        folder / "hevc.mp4", "libx265", {"preset": "ultrafast", "x265-params": params}
    )


def mjpeg(folder: Path) -> Path:
    return encoded(folder / "jpeg.mov", "mjpeg", {})


def damaged(folder: Path) -> Path:
    """A frame in the middle cannot be decoded: the numbers of all behind it differ from
    those of the packets.
    """
    clip = mjpeg(folder)
    with av.open(str(clip)) as c:
        middle = [p for p in c.demux(video=0) if p.size][17]
    data = bytearray(clip.read_bytes())
    data[middle.pos : middle.pos + middle.size] = bytes(middle.size)
    (folder / "damaged.mov").write_bytes(data)
    return folder / "damaged.mov"


@pytest.fixture(scope="module")
def clip_of(tmp_path_factory: pytest.TempPathFactory) -> ClipOf:
    """Each clip is made once."""
    return cache(lambda make: make(tmp_path_factory.mktemp(make.__name__)))


def shuffled(
    tasks: Sequence[Task], frames: int, progress: Callable[[int], None]
) -> Results:
    every = [*tasks]
    random.Random(1).shuffle(every)
    return run_serial(every, progress, analyse_stretch)


def threads(workers: int) -> Run:
    return lambda tasks, frames, progress: run_threads(
        tasks, [analyse_stretch] * workers, progress
    )


def analysed(
    clip: Path,
    job: Path,
    run: Run = in_order,
    folds: tuple[str, ...] = (),
    **more: Any,
) -> Analysed:
    job.mkdir(exist_ok=True)
    asked = AnalysisJob((MARKER,), clip_camera(), **more)
    return analyse_clip(
        Span(probe(clip)),
        asked,
        {"light", *folds},
        JobFolder(job),
        "key",
        run=run,
    )


@pytest.mark.parametrize(
    "make", [open_gop, closed_gop, hevc, mjpeg], ids=lambda m: m.__name__
)
def test_decoding_from_a_border_gives_the_frames_of_the_clip(
    make: Make, clip_of: ClipOf
) -> None:
    info = probe(clip_of(make))
    with ClipReader(info) as reader:
        every = [(f.pts, f.luma().copy()) for f in reader.frames()]
        times = reader.times()
    assert (
        times is not None
        and times.pts == [pts for pts, _ in every]
        and len(every) == FRAMES
        and times.truncated is None
    )
    parts = cut(Span(info), times)
    assert parts.seeks and [p.first for p in parts.parts] == (
        [*range(0, FRAMES, LEAST)] if make is mjpeg else [0, 12, 24, 36]
    )
    for part in parts.parts[1:]:
        with ClipReader(info, threads=1) as reader:
            got = [(f.pts, f.luma().copy()) for f in reader.frames(part.begins)]
        assert len(got) == FRAMES - part.first
        assert all(
            a[0] == b[0] and (a[1] == b[1]).all()
            for a, b in zip(got, every[part.first :], strict=True)
        )


@pytest.mark.parametrize(
    "make", [open_gop, closed_gop, hevc, damaged], ids=lambda m: m.__name__
)
def test_any_order_and_any_workers_leave_the_same_bytes(
    make: Make, clip_of: ClipOf, tmp_path: Path
) -> None:
    clip, folds = clip_of(make), ("environment", "lens") if make is open_gop else ()
    first = written(
        analysed(clip, tmp_path / "first", folds=folds), tmp_path / "first.jsonl"
    )
    made = [path.name[:13] for path in (tmp_path / "first" / "stretches").iterdir()]
    assert len(first[2]) == FRAMES - (make is damaged)
    assert "000000-000047" in made if make is damaged else len(made) == 4
    for run in (
        (shuffled, threads(2), threads(3)) if make is open_gop else (shuffled,)
    ):
        again = written(
            analysed(clip, tmp_path / "again", run, folds), tmp_path / "again.jsonl"
        )
        assert again == first
        stretches_of(tmp_path / "again").clear("")


def stretches_of(job: Path) -> JobFolder:
    """Its stretches removed."""
    for path in (job / "stretches").iterdir():
        path.unlink()
    return JobFolder(job)


def last_first(
    tasks: Sequence[Task], frames: int, progress: Callable[[int], None]
) -> Results:
    return threads(1)(tasks[::-1], frames, progress)


def test_each_stretch_alone_leaves_the_same_bytes(
    clip_of: ClipOf, tmp_path: Path
) -> None:
    """Every one but the first begins in an open group, of which a strict decoder misses frames."""
    clip = clip_of(open_gop)
    first, last = (
        written(analysed(clip, tmp_path / name, run), tmp_path / f"{name}.jsonl")
        for name, run in (("first", in_order), ("last", last_first))
    )
    assert last == first


def test_processes_leave_the_same_bytes(clip_of: ClipOf, tmp_path: Path) -> None:
    document = {
        "input": {"clip": str(clip_of(open_gop)), "camera": str(write_camera(tmp_path / "camera.yaml"))},
        "marker": [{"spec": str(MARKER)}], "model": {"file": str(write_model(tmp_path / "model.glb")), "fit": "8cm"},
        "output": {"path": str(tmp_path / "out.mp4")},
    }  # fmt: skip
    inputs = open_inputs(load(None, document, parameters()))
    facts = []
    for workers in (1, 2):
        folder = JobFolder(tmp_path / f"{workers}")
        folder.path.mkdir()
        folder.open(resume=False)
        options = Options(workers=workers, notice=lambda _: None)
        with contextlib.closing(options.processes):
            rows = plan_job(inputs, folder, options).log.rows()
        facts.append(folder.facts.read_bytes())
        made_by = {row.worker for row in rows if row.work == "stretch"}
    assert facts[0] == facts[1] and len(made_by) == 2


def test_borders_do_not_show_in_the_facts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One track and one path across them; a cut that lies on one is a cut."""
    clip = encoded(tmp_path / "cut.mp4", "libx264", x264("open-gop=0"), cut_at=24)
    parts = analysed(clip, tmp_path / "parts")[0]
    monkeypatch.setattr(stretches, "LEAST_FRAMES", 1000)
    one = analysed(clip, tmp_path / "one")[0]
    assert len([*(tmp_path / "one" / "stretches").iterdir()]) == 1
    assert (
        [f.shot for f in parts.facts]
        == [f.shot for f in one.facts]
        == [0] * 24 + [1] * 24
    )
    for a, b in zip(one.facts, parts.facts, strict=True):
        assert (
            a.status == b.status == "measured"
            and a.camera_from_world is not None
            and b.camera_from_world is not None
        )
        assert np.array_equal(a.markers[0].corners_px, b.markers[0].corners_px)
        assert np.array_equal(a.camera_from_world.matrix, b.camera_from_world.matrix)


@pytest.fixture(scope="module")
def of_open_gop(
    clip_of: ClipOf, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Any, ...]:
    """What the analysis of this clip in order leaves."""
    folder = tmp_path_factory.mktemp("of_open_gop")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stretches, "LEAST_FRAMES", LEAST)
        return written(
            analysed(clip_of(open_gop), folder / "first"), folder / "first.jsonl"
        )


def test_where_seeking_does_not_work_one_worker_reads_on(
    clip_of: ClipOf,
    of_open_gop: tuple[Any, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clip, first = clip_of(open_gop), of_open_gop
    opened = []

    def nowhere(self: ClipReader, first_pts: int) -> Iterator[Any]:
        opened.append(first_pts)
        return iter(())

    monkeypatch.setattr(ClipReader, "_from_key_frame", nowhere)

    def never(*_: Any) -> Results:
        raise AssertionError("workers that would all decode from the start")

    assert (
        written(analysed(clip, tmp_path / "again", never), tmp_path / "again.jsonl")
        == first
    )
    assert len(opened) == 1, "tried once, before"


def test_times_that_go_back_make_one_stretch(
    clip_of: ClipOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Packets whose times are fine, and pictures that come in another order."""
    clip = clip_of(mjpeg)
    pictures = ClipReader._decode

    def swapped(self: ClipReader, stream: Any) -> Iterator[av.VideoFrame]:
        before = None
        for frame in pictures(self, stream):
            if (
                frame.pts is not None
                and before is not None
                and frame.time is not None
                and round(frame.time * 30) == 31
            ):
                frame.pts = before - 1
            before = frame.pts
            yield frame

    monkeypatch.setattr(ClipReader, "_decode", swapped)
    done = [
        written(analysed(clip, tmp_path / str(k), run), tmp_path / f"{k}.jsonl")
        for k, run in enumerate((in_order, shuffled))
    ]
    assert done[0] == done[1] and len(done[0][2]) == FRAMES
    assert all(
        list((tmp_path / name / "stretches").glob("000000-000047.*")) for name in "01"
    )


def test_a_span_is_cut_within(clip_of: ClipOf) -> None:
    span = Span(probe(clip_of(closed_gop)), 0.6, 2.6)
    with ClipReader(span.info) as reader:
        pts = [f.pts for f in reader.frames() if 0.6 <= span.since_s(f.pts) <= 2.6]
        every = [f.pts for f in reader.frames()]
        parts = cut(span, reader.times())
    assert (
        parts.before == every.index(pts[0])
        and parts.parts[0].of == len(pts)
        and parts.parts[0].begins == pts[0]
    )
    assert [pts[p.first] for p in parts.parts] == [
        p.begins for p in parts.parts
    ] and len(parts.parts) > 1
    assert (
        whole(span).parts == (Stretch(0, FRAMES - 1, None, None, FRAMES, True),)
        or whole(span).parts[0].begins is None
    )
