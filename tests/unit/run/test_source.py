"""Reading on from chunk to chunk, and the threads that render them."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from arfx.errors import JobInterruptedError, RenderError
from arfx.media.clip import ClipInfo, probe
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.run import executors
from arfx.run import source as source_module
from arfx.run.folder import JobFolder
from arfx.run.job import _interruptible
from arfx.run.planned import DecodedFrames
from arfx.run.source import (
    clip_frames,
    frames_kept,
    job_frame,
    keep_frame,
    release,
)
from tests.clips import write_clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(
        tmp_path_factory.mktemp("source") / "clip.mp4",
        24,
        pts=[2 * i + i % 2 for i in range(24)],
    )


@pytest.fixture(autouse=True)
def released() -> Iterator[None]:
    yield
    release()


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """One for each time that a clip was opened."""
    found: list[bool] = []
    open_reader = ClipReader._open
    monkeypatch.setattr(
        ClipReader, "_open", lambda self: found.append(True) or open_reader(self)
    )
    return found


def times_of(info: ClipInfo) -> list[int]:
    with ClipReader(info) as reader:
        return [f.pts for f in reader.frames()]


def frame_of(info: ClipInfo, pts: list[int], index: int) -> Frame:
    return job_frame(info, DecodedFrames(pts, None, False, [], False), index, True)


def test_a_source_gives_the_frames_of_the_job_and_skips_others(clip: Path) -> None:
    info = probe(clip)
    wanted = times_of(info)[3::2]
    got = [frame_of(info, wanted, index) for index in range(1, len(wanted))]
    assert [(f.index, f.pts) for f in got] == [*enumerate(wanted[1:], 1)]


def test_a_frame_that_is_not_there_is_told(clip: Path) -> None:
    info = probe(clip)
    pts = times_of(info)
    wanted = [pts[0], pts[1] + 1, pts[3]]
    assert frame_of(info, wanted, 0) is not None
    for _ in range(2):
        with pytest.raises(RenderError, match="frame 1 could not be decoded again"):
            frame_of(info, wanted, 1)


def test_the_next_chunk_reads_on_and_any_other_starts_anew(
    clip: Path, opened: list[bool]
) -> None:
    info = probe(clip)
    pts = times_of(info)
    for index, readers in ((0, 1), (1, 1), (2, 1), (10, 2), (11, 2), (5, 3)):
        frame = frame_of(info, pts, index)
        assert frame.pts == pts[index]
        assert len(opened) == 1 + readers


def test_a_stretch_that_was_left_in_its_middle_is_read_from_its_start(
    clip: Path,
) -> None:
    """A worker that failed in one may be given it again."""
    info = probe(clip)
    pts = next(clip_frames(info, None, False)).pts
    release()
    source = clip_frames(info, pts, False)
    assert clip_frames(info, pts, False) is source
    next(source)
    assert next(clip_frames(info, pts, False)).pts == pts
    source = clip_frames(info, None, False)
    source.put_back(next(source), pts)
    assert clip_frames(info, pts, False) is source


def fake_tasks(n: int) -> list[executors.Task]:
    return [("folder", "key", i, i, "target") for i in range(n)]


def test_threads_render_every_chunk_once_in_stretches() -> None:
    order: dict[int, list[int]] = {}
    helped = threading.Event()

    def render(
        folder: str,
        key: str,
        first: int,
        last: int,
        target: str,
        tick: executors.Callable[[], None],
    ) -> dict:
        order.setdefault(threading.get_ident(), []).append(first)
        if first == 0:
            assert helped.wait(100), "a thread that is through does not help"
        elif first < 6:
            helped.set()
        tick()
        return {"first": first}

    told: list[int] = []
    results = list(executors.run_threads(fake_tasks(12), [render] * 2, told.append))
    assert sorted(r["first"] for r in results) == list(range(12))
    quick = next(o for o in order.values() if o[0] == 6)
    assert quick[:6] == [6, 7, 8, 9, 10, 11], "a thread leaves its stretch"
    assert told[-1] <= 12


def test_a_failing_chunk_stops_all_threads() -> None:
    ended: list[int] = []

    def render(
        folder: str,
        key: str,
        first: int,
        last: int,
        target: str,
        tick: executors.Callable[[], None],
    ) -> dict:
        if first == 4:
            raise RenderError("no")
        until = time.monotonic() + 100
        while time.monotonic() < until:
            time.sleep(0.01)
            tick()
        ended.append(first)
        return {"first": first}

    with pytest.raises(RenderError):
        list(executors.run_threads(fake_tasks(8), [render] * 2, lambda n: None))
    assert not ended


@pytest.mark.usefixtures("ctrl_c")
def test_an_interrupt_that_a_library_swallows_still_ends_the_job(
    tmp_path: Path,
) -> None:
    with (
        pytest.raises(JobInterruptedError),
        _interruptible(JobFolder(tmp_path)) as check,
    ):
        with contextlib.suppress(
            KeyboardInterrupt
        ):  # as compiled code does that clears errors
            signal.raise_signal(signal.SIGINT)
        check()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_frames_of_a_short_clip_are_decoded_once(
    clip: Path, monkeypatch: pytest.MonkeyPatch, opened: list[bool]
) -> None:
    """With the same samples as those that are decoded again; too many are not kept."""
    info = probe(clip)
    for most, readers in ((source_module.KEPT_BYTES, 0), (1_000_000, 1)):
        monkeypatch.setattr(source_module, "KEPT_BYTES", most)
        with frames_kept():
            analysed = list(clip_frames(info, None, False))
            for frame in analysed:
                keep_frame(frame)
            release()
            opened.clear()
            for k, frame in enumerate(analysed):
                again = frame_of(info, [f.pts for f in analysed], k)
                assert (again.index, again.pts) == (
                    k,
                    frame.pts,
                )
                assert np.array_equal(again.luma(), frame.luma())
        release()
        assert len(opened) == readers


def test_a_frame_that_was_analysed_is_decoded_again_when_it_is_rendered_twice(
    clip: Path,
) -> None:
    info = probe(clip)
    with frames_kept():
        pts = []
        for frame in clip_frames(info, None, False):
            keep_frame(frame)
            pts.append(frame.pts)
        for _ in range(2):
            got = [frame_of(info, pts, index) for index in range(4, 7)]
            assert [f.pts for f in got] == pts[4:7]
