"""Decoded frames for the chunks that a thread renders: one that follows the last goes on reading where that one ended.

Starting anew means to decode from the key frame before, which may lie hundreds of frames back.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader


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


class _Held(threading.local):
    source: Source | None = None


_held = _Held()


def source_at(info: ClipInfo, pts: list[int], index: int, threads: int = 0) -> Source:
    """The source that this thread read from last, if it stands at `index` of the same job; else a new one."""
    held = _held.source
    if held is not None and held.info is info and held.pts is pts and held.index == index:
        return held
    release()
    _held.source = Source(info, pts, index, threads)
    return _held.source


def release() -> None:
    """Close what this thread holds."""
    if _held.source is not None:
        _held.source.close()
        _held.source = None
