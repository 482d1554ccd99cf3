"""Decoded frames, for the stretches that a thread analyses and the chunks that it renders;
encoding behind the rendering, in a thread of its own.

What follows a thread's last stretch or chunk is read on from where that ended: a new reader
decodes from the key frame before, which may lie hundreds of frames back."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

from arfx.core import interrupt
from arfx.errors import RenderError
from arfx.media.clip import ClipInfo
from arfx.media.frames import ClipReader, Frame
from arfx.run.planned import DecodedFrames

T = TypeVar("T")
KEPT_BYTES = (
    256_000_000  # of decoded frames: some three seconds of 1080p, six of 720p
)


@contextlib.contextmanager
def behind(
    write: Callable[[T], None], depth: int = 2
) -> Iterator[Callable[[T], None]]:
    """Yields what hands an item to `write`, in order, while `depth` others wait at most.

    Raises what `write` raises, at a later item or at the end; after an error, there or in
    the body, what waits is left."""
    pool = ThreadPoolExecutor(1, "behind")
    pending: deque[Future[None]] = deque()

    def put(item: T) -> None:
        while len(pending) > depth:
            pending.popleft().result()
        pending.append(pool.submit(write, item))

    try:
        yield put
        for future in pending:
            future.result()
    finally:
        with interrupt.deferred():
            pool.shutdown(cancel_futures=True)


# Frames that were decoded to analyse a clip, by time, until each is rendered: those of a
# short clip are decoded once. None of a clip that is longer than KEPT_BYTES.
_kept: dict[int, Frame] = {}
_bytes_left = -1


@contextlib.contextmanager
def frames_kept() -> Iterator[None]:
    """Within it, a job's decoded frames may be kept for this process to render."""
    global _bytes_left
    _bytes_left = KEPT_BYTES
    try:
        yield
    finally:
        _bytes_left = -1
        _kept.clear()


def keep_frame(frame: Frame) -> None:
    global _bytes_left
    _bytes_left -= sum(p.buffer_size for p in frame.picture.planes)
    if _bytes_left >= 0:
        _kept[frame.pts] = frame
    else:
        _kept.clear()


class ClipFrames:
    """Iterator over a clip's frames from a time on (None = from its start, whatever the
    times are), in order.

    seconds : of decoding so far
    frontier : the next frame is the first at or after that time; None = nobody said so
    """

    def __init__(self, reader: ClipReader, first_pts: int | None) -> None:
        self.reader, self.frontier, self.seconds = reader, first_pts, 0.0
        self._frames = reader.frames(first_pts)
        self._back: Frame | None = None

    def __iter__(self) -> ClipFrames:
        return self

    def __next__(self) -> Frame:
        self.frontier = None  # who is left in the middle is not gone on with
        if self._back is not None:
            frame, self._back = self._back, None
            return frame
        start = time.perf_counter()
        try:
            return next(self._frames)
        finally:
            self.seconds += time.perf_counter() - start

    def put_back(self, frame: Frame, frontier: int) -> None:
        """It belongs to what begins at that time."""
        self._back, self.frontier = frame, frontier

    def goes_on_at(self, info: ClipInfo, pts: int | None, careful: bool) -> bool:
        """Whether who wants the frames of that clip from a time on reads on here."""
        reader, frontier = self.reader, self.frontier
        if frontier is None or pts is None or reader.info != info:
            return False
        if careful > reader.careful:
            return False
        return frontier == pts or (reader.careful and frontier < pts)


class _OfThread(threading.local):
    """reading : what the thread read from last"""

    reading: ClipFrames | None = None


_of_thread = _OfThread()


def clip_frames(
    info: ClipInfo,
    first_pts: int | None,
    alone: bool,
    careful: bool = False,
    strict: bool = False,
    seeks: bool = True,
) -> ClipFrames:
    """The frames that this thread read last, if they go on at that time of the same clip;
    else new ones.

    alone : decoding gets threads of its own;  careful, strict, seeks : as of `ClipReader`
    """
    last = _of_thread.reading if seeks else None
    if last is not None and last.goes_on_at(info, first_pts, careful):
        return last
    release()
    reader = ClipReader(info, 0 if alone else 1, careful, strict, seeks)
    _of_thread.reading = new = ClipFrames(reader, first_pts)
    return new


def job_frame(
    info: ClipInfo, decoded: DecodedFrames, index: int, alone: bool
) -> Frame:
    """Frame number `index` of a job. Where it is not found, decoding turns to be careful.

    Raises RenderError where the file does not hold a frame of that time any more."""
    pts, careful = decoded.pts, decoded.careful
    if not careful and (kept := _kept.pop(pts[index], None)):
        return replace(kept, index=index)
    for trying in sorted({careful, True}):
        source = clip_frames(info, pts[index], alone, trying)
        frame = next((f for f in source if f.pts >= pts[index]), None)
        if frame is not None and frame.pts == pts[index]:
            source.frontier = next(iter(pts[index + 1 : index + 2]), None)
            return replace(frame, index=index)
    raise RenderError(
        f"{info.path}: frame {index} could not be decoded again where the analysis saw it",
        "the file has changed, or seeking in it is broken: copy it to another container"
        " and try again",
    )


def release() -> None:
    """Close what this thread reads from."""
    if _of_thread.reading is not None:
        _of_thread.reading.reader.close()
        _of_thread.reading = None
