"""Decoded frames, and their real depth, for the chunks that a thread renders.

A chunk that follows the thread's last one is read on from where that ended: a new reader decodes from the key frame before, which
may lie hundreds of frames back."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.errors import InputError
from arfx.media.clip import ClipInfo
from arfx.media.depth_maps import DepthMaps, fill_holes
from arfx.media.frames import ClipReader, Frame


class Source:
    """Frames of a clip from `index` on, in order. pts : presentation times of all of the job's frames;  threads : to decode,
    0 = as many as it likes"""

    def __init__(self, info: ClipInfo, pts: list[int], index: int, threads: int = 0) -> None:
        self.info, self.pts, self.index = info, pts, index
        self._reader = ClipReader(info, threads)
        self._frames: Iterator[Frame] = self._reader.frames(pts[index], first_index=index)

    def next(self) -> Frame | None:
        """Frame number `index` of the job, which moves on; None where the file does not hold a frame of that time."""
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
        self._reader.close()
        self._frames = iter(())


_of_thread = threading.local()  # source : what the thread read from last


def source_at(info: ClipInfo, pts: list[int], index: int, threads: int = 0) -> Source:
    """The source that this thread read from last, if it is at `index` of the same job; else a new one."""
    last: Source | None = getattr(_of_thread, "source", None)
    if last is not None and last.info is info and last.pts is pts and last.index == index:
        return last
    release()
    _of_thread.source = source = Source(info, pts, index, threads)
    return source


def release() -> None:
    """Close this thread's source."""
    if (source := getattr(_of_thread, "source", None)) is not None:
        source.close()
        _of_thread.source = None


def real_depth_layer(maps: DepthMaps, facts: FrameFacts, frame: Frame, camera: Camera, rect: Rect) -> np.ndarray | None:
    """REAL_DEPTH over `rect`: metres, > 0 everywhere, holes filled along the picture's edges; None where there is none.

    The whole map is filled whatever the rectangle, so that a pixel gets the same from any.
    Raises InputError where the map is not the one that was analysed."""
    real = facts.real_depth
    if real is None:
        return None
    depth = maps.load(real.map, camera.width, camera.height)
    if not depth.any():
        raise InputError(f"depth map {maps.name(real.map)} has changed since the analysis", "start the job again")
    whole = fill_holes(depth, np.ascontiguousarray(frame.luma()))
    return np.ascontiguousarray(whole[rect.slices]) * np.float32(real.scale)
