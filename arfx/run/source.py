"""Decoded frames, for the stretches that a thread analyses, and, with their real depth, for
the chunks that it renders.

What follows the thread's last one is read on from where that ended: a new reader decodes
from the key frame before, which may lie hundreds of frames back."""

from __future__ import annotations

import contextlib
import multiprocessing
import threading
import time
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.errors import InputError
from arfx.media.clip import ClipInfo
from arfx.media.depth_maps import DepthMaps, fill_holes
from arfx.media.frames import ClipReader, Frame
from arfx.run.background_io import ahead

KEPT_BYTES = (
    256_000_000  # of decoded frames: some three seconds of 1080p, six of 720p
)


class KeptFrames:
    """Frames that this process decoded to analyse a clip, until each is rendered: those of
    a short clip are decoded once. None of a clip that is longer than KEPT_BYTES, nor where
    other processes would render them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._info: ClipInfo | None = None
        self._frames: dict[int, Frame] = {}
        self._left = 0

    def begin(self, info: ClipInfo | None) -> None:
        """Frames of this clip follow; what is kept of another one goes."""
        with self._lock:
            if self._info != info:
                self._info, self._frames, self._left = info, {}, KEPT_BYTES

    def add(self, info: ClipInfo, frame: Frame) -> None:
        size = sum(p.buffer_size for p in frame.picture.planes)
        with self._lock:
            if self._info != info or self._left < 0 or frame.pts in self._frames:
                return
            self._left -= size
            self._frames[frame.pts] = frame
            if self._left < 0:
                self._frames = {}

    def take(self, info: ClipInfo, pts: int) -> Frame | None:
        """The frame of that time, which is no longer kept."""
        with self._lock:
            return self._frames.pop(pts, None) if self._info == info else None


_kept = KeptFrames()


@contextlib.contextmanager
def frames_kept() -> Iterator[None]:
    """Within it, decoded frames may be kept; none is afterwards: a process that is forked
    from this one could not free them."""
    try:
        yield
    finally:
        _kept.begin(None)


class Source:
    """Frames of a clip from `index` on, in order. pts : presentation times of all of the
    job's frames;  threads : to decode,
    0 = as many as it likes;  careful : as of `ClipReader`, which is turned to where a frame
    is not found otherwise
    """

    def __init__(
        self,
        info: ClipInfo,
        pts: list[int],
        index: int,
        threads: int,
        careful: bool,
    ) -> None:
        self.info, self.pts, self.index = info, pts, index
        self.careful, self._threads = careful, threads
        self._reader: ClipReader | None = None
        self._frames: Iterator[Frame] = iter(())

    def _read(self, threads: int, careful: bool) -> None:
        self.careful = careful
        self._reader = ClipReader(self.info, threads, careful)
        self._frames = self._reader.frames(
            self.pts[self.index], first_index=self.index
        )

    def next(self) -> Frame | None:
        """Frame number `index` of the job, which moves on; None where the file does not
        hold a frame of that time.
        """
        if not self.careful and (kept := _kept.take(self.info, self.pts[self.index])):
            self.index += 1
            return replace(kept, index=self.index - 1)
        if self._reader is None:
            self._read(self._threads, self.careful)
        frame = self._next()
        if frame is None and not self.careful:
            self._read(1, True)
            frame = self._next()
        return frame

    def _next(self) -> Frame | None:
        for frame in self._frames:
            if frame.pts < self.pts[self.index]:
                continue
            if frame.pts > self.pts[self.index]:
                break
            self.index += 1
            return frame
        self.close()
        return None

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
        self._frames = iter(())


class StretchFrames:
    """Iterator over a clip's frames from a time on (None = from its start, whatever the
    times are), in order.

    alone : decoding gets threads of its own, and runs ahead;  seconds : of decoding so far
    frontier : where the last stretch ended: the next frame is the first at or after that time
    """

    def __init__(
        self,
        info: ClipInfo,
        first_pts: int | None,
        alone: bool,
        careful: bool,
        seeks: bool,
    ) -> None:
        self.info, self.alone, self.frontier, self.seconds = (
            info,
            alone,
            first_pts,
            0.0,
        )
        self.reader = ClipReader(
            info,
            0 if alone else 1,
            careful,
            strict=not careful and (first_pts is None or not alone),
            seeks=seeks,
        )
        self._keeps = not careful and multiprocessing.parent_process() is None
        _kept.begin(info if self._keeps else None)
        frames = self._timed(self.reader.frames(first_pts))
        self._frames = ahead(frames) if alone else frames
        self._back: Frame | None = None

    def _timed(self, frames: Iterator[Frame]) -> Generator[Frame]:
        start = time.perf_counter()
        for frame in frames:
            self.seconds += time.perf_counter() - start
            if self._keeps:
                _kept.add(self.info, frame)
            yield frame
            start = time.perf_counter()

    def __iter__(self) -> StretchFrames:
        return self

    def __next__(self) -> Frame:
        if self._back is not None:
            frame, self._back = self._back, None
            return frame
        self.frontier = (
            None  # a stretch that is left in its middle is not gone on with
        )
        return next(self._frames)

    def put_back(self, frame: Frame, frontier: int) -> None:
        """It belongs to the next stretch, which begins at that time."""
        self._back, self.frontier = frame, frontier

    def close(self) -> None:
        self._frames.close()
        self.reader.close()


_of_thread = threading.local()  # reading : what the thread read from last


def source_at(
    info: ClipInfo,
    pts: list[int],
    index: int,
    threads: int = 0,
    careful: bool = False,
) -> Source:
    """The source that this thread read from last, if it is at `index` of the same job, or,
    a careful one, before it; else a new one."""
    last = getattr(_of_thread, "reading", None)
    if (
        isinstance(last, Source)
        and last.info is info
        and last.pts is pts
        and 0 <= index - last.index <= index * careful
    ):
        last.index = index
        return last
    release()
    _of_thread.reading = source = Source(info, pts, index, threads, careful)
    return source


def stretch_at(
    info: ClipInfo,
    first_pts: int | None,
    alone: bool,
    careful: bool = False,
    seeks: bool = True,
) -> StretchFrames:
    """The frames that this thread read last, if they go on at that time of the same clip;
    else new ones.
    """
    last = getattr(_of_thread, "reading", None)
    if (
        seeks
        and isinstance(last, StretchFrames)
        and first_pts is not None
        and (last.info, last.alone, last.frontier) == (info, alone, first_pts)
    ):
        return last
    release()
    _of_thread.reading = source = StretchFrames(
        info, first_pts, alone, careful, seeks
    )
    return source


def release() -> None:
    """Close what this thread reads from."""
    if (last := getattr(_of_thread, "reading", None)) is not None:
        last.close()
        _of_thread.reading = None


def real_depth_layer(
    maps: DepthMaps, facts: FrameFacts, frame: Frame, camera: Camera, rect: Rect
) -> np.ndarray | None:
    """REAL_DEPTH over `rect`: metres, > 0 everywhere, holes filled along the picture's
    edges; None where there is none.

    The whole map is filled whatever the rectangle, so that a pixel gets the same from any.
    Raises InputError where the map is not the one that was analysed."""
    real = facts.real_depth
    if real is None:
        return None
    depth = maps.load(real.map, camera.width, camera.height)
    if not depth.any():
        raise InputError(
            f"depth map {maps.name(real.map)} has changed since the analysis",
            "start the job again",
        )
    whole = fill_holes(depth, np.ascontiguousarray(frame.luma()))
    return np.ascontiguousarray(whole[rect.slices]) * np.float32(real.scale)
