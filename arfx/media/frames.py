"""Reading a clip's frames in order of presentation, from any time on, up to the last good one; and their times alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import av

from arfx.errors import InputError
from arfx.media.clip import ClipInfo
from arfx.media.codecs import open_video
from arfx.media.frame import Frame
from arfx.media.planes import repacked

_SHORT_S = 0.5  # a file that ends this much before its stated end was cut off; container durations are rounded, not this far


class FrameTimesError(InputError):
    """Times of frames go back, where only decoding from the start would tell how they are repaired."""


@dataclass(frozen=True)
class FrameTimes:
    """What the packets of a clip say, without decoding: a frame that cannot be decoded is among these.

    pts : of all frames, rising;  keys : of those that decoding can begin at, rising
    truncated : as of ClipReader, as far as packets tell"""

    pts: list[int]
    keys: list[int]
    truncated: str | None


class ClipReader:
    """Context manager over one clip.
    truncated : after iterating to the end, a message when the file ends in damage, else None
    repaired : whether a frame had no time, or one that was not after the last one's, and was given another"""

    def __init__(self, info: ClipInfo, threads: int = 0) -> None:
        self.info = info
        self._format = info.frame_format()
        self._threads = threads
        self._container: Any = None
        self.truncated: str | None = None
        self.repaired = False
        self._stopped = ""
        self._packets = 0
        self._end = info.start_pts

    def __enter__(self) -> ClipReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None

    def _open(self) -> Any:
        self.close()
        self._container = open_video(self.info.path)
        stream = self._container.streams[self.info.stream_index]
        stream.thread_type = "AUTO"
        if self._threads:
            stream.codec_context.thread_count = self._threads
        self._stopped, self._packets, self._end = "", 0, self.info.start_pts
        return stream

    def frames(self, first_pts: int | None = None, last_pts: int | None = None, first_index: int = 0) -> Iterator[Frame]:
        """Frames with first_pts <= pts <= last_pts; `index` counts from first_index.
        Seeks to the key frame at or before first_pts; where seeking is not exact, decodes from the start."""
        index = first_index
        for picture, pts in self._pictures(first_pts, last_pts):
            yield Frame(repacked(picture, self._format.layout), self._format, index, pts, bool(picture.key_frame))
            index += 1

    def times(self) -> FrameTimes | None:
        """None where packets do not tell: a time is missing or there twice."""
        pts, keys, missing = list[int](), list[int](), False
        for packet in self._demux(self._open()):
            if packet.pts is None:
                missing = True
            elif not packet.is_discard and packet.pts >= self.info.start_pts:
                pts.append(packet.pts)
                if packet.is_keyframe:
                    keys.append(packet.pts)
        if missing or len(set(pts)) < len(pts):
            return None
        return FrameTimes(sorted(pts), sorted(keys), self._verdict(whole=True))

    def seeks_to(self, pts: int) -> bool:
        """Whether decoding can begin at the key frame of that time, or one before it."""
        return next(self._from_key_frame(pts), None) is not None

    def _pictures(self, first_pts: int | None, last_pts: int | None) -> Iterator[tuple[av.VideoFrame, int]]:
        if first_pts is not None and first_pts > self.info.start_pts:
            started = False
            for item in self._from_key_frame(first_pts):
                started = True
                if last_pts is not None and item[1] > last_pts:
                    return
                yield item
            if started:
                return
        for picture, pts in self._timed(self._decode(self._open())):
            if last_pts is not None and pts > last_pts:
                return
            if first_pts is None or pts >= first_pts:
                yield picture, pts
        self.truncated = self._verdict(whole=True)

    def _from_key_frame(self, first_pts: int) -> Iterator[tuple[av.VideoFrame, int]]:
        """Frames from first_pts on, or nothing at all when the key frame before it cannot be found for sure."""
        stream = self._open()
        try:
            self._container.seek(first_pts, stream=stream, backward=True)
        except (av.error.FFmpegError, OSError):
            return
        key_pts: int | None = None
        last: int | None = None
        for picture in self._decode(stream):
            if picture.pts is None or (last is not None and picture.pts <= last):
                if key_pts is None or last is None or last < first_pts:
                    return  # times need repair, which depends on every frame before
                raise FrameTimesError(
                    f"{self.info.path}: frame times go backwards at {picture.pts}", "process the clip from its start"
                )
            last = picture.pts
            if key_pts is None:
                if not picture.key_frame or picture.pts > first_pts:
                    if picture.pts >= first_pts:
                        return
                    continue  # leading frames of an open group: their references lie before the key frame
                key_pts = picture.pts
            if picture.pts >= first_pts:
                yield picture, picture.pts
        self.truncated = self._verdict(whole=False)

    def _decode(self, stream: Any) -> Iterator[av.VideoFrame]:
        """Pictures until the end or the first damage that ends the file; concealed ones only if a good one follows."""
        held: list[av.VideoFrame] = []
        for picture in self._raw(stream):
            if picture.width != self.info.coded_width or picture.height != self.info.coded_height:
                raise InputError(
                    f"{self.info.path}: the picture changes from {self.info.coded_width}x{self.info.coded_height} "
                    f"to {picture.width}x{picture.height} in the middle of the clip",
                    "split the clip there, or convert it to one size",
                )
            if picture.is_corrupt:
                held.append(picture)
                continue
            yield from held
            held.clear()
            yield picture
        if held and not self._stopped:
            self._stopped = f"the last {len(held)} frames are damaged"

    def _raw(self, stream: Any) -> Iterator[av.VideoFrame]:
        for packet in itertools.chain(self._demux(stream), [None]):
            try:
                yield from stream.codec_context.decode(packet)
            except av.error.EOFError:
                return
            except (av.error.FFmpegError, OSError) as e:
                if packet is None:
                    self._stopped = self._stopped or f"the last frame cannot be decoded: {getattr(e, 'strerror', None) or e}"

    def _demux(self, stream: Any) -> Iterator[Any]:
        """Packets until the end, or the first damage in the file."""
        packets = self._container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
            except (av.error.FFmpegError, OSError) as e:
                self._stopped = f"reading stopped: {getattr(e, 'strerror', None) or e}"
                return
            if packet is None or packet.size == 0:
                return
            if packet.is_corrupt:
                self._stopped = "the file ends in the middle of a frame"
                return
            self._packets += 1
            if packet.pts is not None:
                self._end = max(self._end, packet.pts + (packet.duration or 0))
            yield packet

    def _timed(self, pictures: Iterator[av.VideoFrame]) -> Iterator[tuple[av.VideoFrame, int]]:
        """Gives each picture a time above the one before: a missing or repeated one follows by one frame (or one tick)."""
        rate = self.info.fps or 25.0
        step = max(round(1 / (rate * float(self.info.time_base))), 1)
        last: int | None = None
        for picture in pictures:
            if picture.pts is None:
                pts = self.info.start_pts if last is None else last + step
            else:
                pts = picture.pts if last is None or picture.pts > last else last + 1
            self.repaired |= pts != picture.pts
            last = pts
            yield picture, pts

    def _verdict(self, whole: bool) -> str | None:
        stated = self.info.frame_count_stated
        if self._stopped:
            return f"{self.info.path}: {self._stopped}; processed to the last good frame"
        length_s = float((self._end - self.info.start_pts) * self.info.time_base)
        if self.info.duration_of_video and self.info.duration_s and length_s < self.info.duration_s - _SHORT_S:
            ends = f"the file ends after {length_s:.2f} s of {self.info.duration_s:.2f} s"
            return f"{self.info.path}: {ends}; processed to the last good frame"
        counted = any(n in self.info.container for n in ("mp4", "mov"))
        if whole and counted and stated and self._packets and self._packets < stated:
            return f"{self.info.path}: {self._packets} of {stated} frames are in the file; processed to the last good frame"
        return None
