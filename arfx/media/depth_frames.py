"""Depth maps that lie in one file: pages of a TIFF, frames of a video with 16-bit or float
grey (FFV1 gray16 in Matroska).

Any map can be asked for, from any thread; one after the other is quick."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np

from arfx.core.opener import regular
from arfx.errors import InputError
from arfx.media.codecs import check_size, open_video
from arfx.media.images import check_tiff

TIFF = (".tif", ".tiff")
VIDEO = (".mkv", ".nut", ".avi", ".mov", ".mp4")
_GREY = (
    "gray16le",
    "gray16be",
    "gray14le",
    "gray12le",
    "gray10le",
    "grayf32le",
    "grayf32be",
)
_FORWARD = 30  # maps that are rather decoded on the way than sought past


class _Reading(threading.local):
    """What a thread has open: the container, its frames to come, the number of the next one
    and the map before it.
    """

    container: av.container.InputContainer | None = None
    frames: Iterator[av.VideoFrame] = iter(())
    next = 0
    last: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class DepthVideo:
    """pts : of every frame, in order;  times_s : of them after the first;  reading : one
    for each thread
    """

    path: Path
    pts: tuple[int, ...]
    times_s: tuple[float, ...]
    reading: _Reading

    @property
    def count(self) -> int:
        return len(self.pts)

    def stored(self, number: int) -> np.ndarray:
        """(h, w) uint16 or float32. Raises InputError where the frame cannot be decoded."""
        at = self.reading
        if at.last is not None and at.next == number + 1:
            return at.last
        try:
            if at.container is None:
                at.container, at.next = open_video(self.path, "depth"), -_FORWARD
            if not at.next <= number < at.next + _FORWARD:
                stream = at.container.streams.video[0]
                at.container.seek(self.pts[number], stream=stream, backward=True)
                at.frames, at.last = at.container.decode(stream), None
            for frame in at.frames:
                if frame.pts is None or frame.pts < self.pts[number]:
                    continue
                if frame.pts > self.pts[number]:
                    break
                picture = frame.to_ndarray()
                at.next, at.last = (
                    number + 1,
                    np.asarray(
                        picture, np.float32 if picture.dtype.kind == "f" else np.uint16
                    ),
                )
                return at.last
        except av.FFmpegError as e:
            raise InputError(
                f"depth {self.path}: map {number} cannot be decoded: {e}"
            ) from None
        raise InputError(
            f"depth {self.path}: map {number} cannot be decoded where it was listed",
            "the file is damaged",
        )


@dataclass(frozen=True, eq=False)
class DepthPages:
    """Pages of a TIFF, which tell no times."""

    path: Path
    count: int
    times_s: None = None

    def stored(self, number: int) -> np.ndarray:
        """(h, w[, channels]) as stored. Raises InputError where the page cannot be read."""
        done, pages = cv2.imreadmulti(str(self.path), number, 1, flags=cv2.IMREAD_UNCHANGED)
        if not done or len(pages) != 1:
            raise InputError(
                f"depth {self.path}: page {number} cannot be read",
                "TIFF with 16-bit or float pages",
            )
        return np.asarray(pages[0])


def open_frames(path: Path) -> DepthVideo | DepthPages:
    """Raises InputError: not readable, or of a kind that holds no depth."""
    if path.suffix.lower() in TIFF:
        check_tiff(regular(path, "depth"), "depth map")
        count = cv2.imcount(str(path), cv2.IMREAD_UNCHANGED)
        if count < 1:
            raise InputError(
                f"depth {path} cannot be read as a TIFF", "16-bit or float pages"
            )
        return DepthPages(path, count)
    try:
        with open_video(path, "depth") as container:
            if not container.streams.video:
                raise InputError(
                    f"depth {path} holds no video", "one stream of 16-bit grey: FFV1 gray16"
                )
            stream = container.streams.video[0]
            kind = stream.codec_context.pix_fmt
            if kind not in _GREY:
                hint = "grey of 16 bits or float: FFV1 gray16 in .mkv"
                raise InputError(f"depth {path} holds {kind} pictures, not depth", hint)
            check_size(
                stream.codec_context.width, stream.codec_context.height, path, "depth"
            )
            base = stream.time_base
            listed = sorted({p.pts for p in container.demux(stream) if p.pts is not None})
    except av.FFmpegError as e:
        raise InputError(f"depth {path} cannot be read as a video: {e}") from None
    if not listed or base is None:
        raise InputError(f"depth {path} holds no frame with a time")
    times = tuple(float((pts - listed[0]) * base) for pts in listed)
    return DepthVideo(path, tuple(listed), times, _Reading())
