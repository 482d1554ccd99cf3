"""Reading on from chunk to chunk, and the threads that render them."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from arfx.errors import JobInterruptedError, RenderError
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.run import executors
from arfx.run import source as source_module
from arfx.run.folder import JobFolder
from arfx.run.job import _interruptible
from arfx.run.source import Source, release, source_at, stretch_at
from tests.clips import write_clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(
        tmp_path_factory.mktemp("source") / "clip.mp4",
        24,
        pts=[2 * i + i % 2 for i in range(24)],
    )


def test_a_source_gives_the_frames_of_the_job_and_skips_others(clip: Path) -> None:
    info = probe(clip)
    with ClipReader(info) as reader:
        pts = [f.pts for f in reader.frames()]
    wanted = pts[3::2]
    source = Source(info, wanted, 1, threads=0, careful=False)
    got = [source.next() for _ in wanted[1:]]
    assert [f.pts for f in got if f is not None] == wanted[1:]


def test_a_frame_that_is_not_there_is_told_and_nothing_after_it_is_given(
    clip: Path,
) -> None:
    info = probe(clip)
    with ClipReader(info) as reader:
        pts = [f.pts for f in reader.frames()]
    source = Source(info, [pts[0], pts[1] + 1, pts[3]], 0, threads=0, careful=False)
    assert source.next() is not None
    assert source.next() is None and source.next() is None


def test_the_next_chunk_reads_on_and_any_other_starts_anew(clip: Path) -> None:
    info = probe(clip)
    with ClipReader(info) as reader:
        pts = [f.pts for f in reader.frames()]
    first = source_at(info, pts, 0)
    first.next()
    assert source_at(info, pts, 1) is first
    other = source_at(info, pts, 10)
    assert (
        other is not first
        and (frame := other.next()) is not None
        and frame.pts == pts[10]
    )
    assert source_at(info, list(pts), 11) is not other, (
        "another job's source was taken"
    )
    release()


def test_a_stretch_that_was_left_in_its_middle_is_read_from_its_start(
    clip: Path,
) -> None:
    """A worker leaves one that nobody wants any more, and may be given it again."""
    info = probe(clip)
    pts = next(stretch_at(info, None, False)).pts
    release()
    source = stretch_at(info, pts, False)
    assert stretch_at(info, pts, False) is source
    next(source)
    assert next(stretch_at(info, pts, False)).pts == pts
    source = stretch_at(info, None, False)
    source.put_back(next(source), pts)
    assert stretch_at(info, pts, False) is source
    release()


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
    results = list(executors.run_threads(fake_tasks(12), 2, told.append, render))
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
        list(executors.run_threads(fake_tasks(8), 2, lambda n: None, render))
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
    clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the same samples as those that are decoded again; too many are not kept."""
    info = probe(clip)
    opened: list[bool] = []
    open_reader = ClipReader._open
    monkeypatch.setattr(
        ClipReader, "_open", lambda self: opened.append(True) or open_reader(self)
    )
    for most, readers in ((source_module.KEPT_BYTES, 0), (1_000_000, 1)):
        monkeypatch.setattr(source_module, "KEPT_BYTES", most)
        source_module._kept.begin(None)
        stretch = stretch_at(info, None, False)
        analysed = list(stretch)
        release()
        opened.clear()
        rendered = Source(
            info, [f.pts for f in analysed], 0, threads=1, careful=False
        )
        for k, frame in enumerate(analysed):
            again = rendered.next()
            assert again is not None and (again.index, again.pts) == (k, frame.pts)
            assert np.array_equal(again.luma(), frame.luma())
        rendered.close()
        assert len(opened) == readers


def test_a_frame_that_was_analysed_is_decoded_again_when_it_is_rendered_twice(
    clip: Path,
) -> None:
    info = probe(clip)
    source_module._kept.begin(None)
    pts = [f.pts for f in stretch_at(info, None, False)]
    release()
    for _ in range(2):
        source = Source(info, pts, 4, threads=1, careful=False)
        assert [f.pts for _ in range(3) if (f := source.next())] == pts[4:7]
        source.close()
