"""Reading a clip's frames in order of presentation, from any time on, over what is damaged,
up to the last good one; and their times alone."""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import av
import numpy as np
from numpy import ndarray

from arfx.core.opener import why
from arfx.errors import InputError
from arfx.media.clip import ClipInfo
from arfx.media.codecs import open_video
from arfx.media.frame import Frame
from arfx.media.planes import layout_named, repacked

# a file that ends this much before its stated end was cut off; container durations are
# rounded, not this far
_SHORT_S = 0.5

# times that go back this far begin anew, as where two recordings were joined; the decoder's
# own order does not
JUMP_S = 0.5
_MOST_FAILURES = 10  # to read on, in a row
_STRANGERS = 10  # pictures of another size in a row are no damage
_CHUNK_HEAD = 8  # bytes before the data of an AVI file's chunk
# bytes of a transport stream's packet, and of one with its time of arrival
_TS_PACKETS = 188, 192
_HELD = 100  # packets of which something is lost, and that may be the last ones
# of the usual time between frames: a packet that is nearer to a frame is part of it, as a
# field is
_APART = 0.6
Timed = Iterator[tuple[av.VideoFrame, int]]  # pictures and their times


class FrameTimesError(InputError):
    """Times of frames go back, where only decoding from the start would tell how they are
    repaired.
    """


class FrameDamageError(FrameTimesError):
    """Frames are damaged: only careful readers agree on what is left of them."""


@dataclass(frozen=True)
class FrameTimes:
    """What the packets of a clip say, without decoding: a frame that cannot be decoded is
    among these.

    pts : of all frames, rising;  keys : of those that decoding can begin at, rising
    irregular : only a careful reader tells what there is;  truncated : as of ClipReader, as
    far as packets tell
    """

    pts: list[int]
    keys: list[int]
    truncated: str | None
    irregular: bool


class ClipReader:
    """Context manager over one clip.
    careful : all is decoded from the start, in one thread;  strict : no picture of which
    the decoder had to guess a part;  seeks : else all is decoded from the start
    truncated : after iterating to the end, a message when the file ends in damage, else None
    damaged : whether something could not be read, and more followed
    repaired : whether a frame had no time, or one that was not after the last one's, and
    was given another
    """

    def __init__(
        self,
        info: ClipInfo,
        threads: int = 0,
        careful: bool = False,
        strict: bool = False,
        seeks: bool = True,
    ) -> None:
        self.info = info
        self.careful, self._threads = careful, 1 if careful else threads
        self._seeks, self._strict = seeks and not careful, strict
        # AVI counts frames in that order, and has no other times
        self._by_decoding = info.container == "avi"
        self._container: Any = None
        self.truncated: str | None = None
        self.damaged = self.repaired = False

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
        if self._strict:
            stream.codec_context.options = {"err_detect": "explode"}
        self._stopped, self._packets = "", 0
        self._end = self._first = self.info.start_pts
        return stream

    def frames(self, first_pts: int | None = None) -> Iterator[Frame]:
        """Frames from first_pts on; `index` counts them.
        Seeks to the key frame at or before first_pts; where seeking is not exact, decodes
        from the start."""
        layout, index = self.info.layout, itertools.count()
        for picture, pts in self._pictures(first_pts):
            if first_pts is None or pts >= first_pts:
                as_it_is = layout_named(picture.format.name) == layout
                held = picture if as_it_is else repacked(picture, layout.name)
                yield Frame(held, self.info, next(index), pts)

    def times(self) -> FrameTimes | None:
        """None where packets do not tell: a time is missing, there twice, or they go back."""
        pts, keys, decoded = list[int](), list[int](), None
        for packet in self._demux(self._open()):
            time, dts = packet.pts, packet.dts
            if time is None or (self._by_decoding and time != dts):
                return None
            if decoded is not None and dts is not None and dts < decoded:
                return None
            decoded = dts
            if packet.is_discard or time < self.info.start_pts:
                continue
            pts.append(time)
            if packet.is_keyframe:
                keys.append(time)
        if len(set(pts)) < len(pts):
            return None
        irregular = self.damaged or bool(self._stopped)
        return FrameTimes(sorted(pts), sorted(keys), self._verdict(True), irregular)

    def shifts(self) -> list[int]:
        """What frames' times are given beside those of the file, after each place where
        these begin anew.
        """
        found = list[int]()
        decoded, end = None, self.info.start_pts
        for packet in self._demux(self._open()):
            pts, dts = packet.pts, packet.dts
            if dts is None or pts is None:
                continue
            if decoded is not None and (decoded - dts) * self.info.time_base > JUMP_S:
                found.append(end - pts)
            decoded = dts
            end = max(end, pts + (packet.duration or 0) + sum(found[-1:]))
        return found

    def seeks_to(self, pts: int) -> bool:
        """Whether decoding can begin at the key frame of that time, or one before it."""
        return next(self._from_key_frame(pts), None) is not None

    def _pictures(self, first_pts: int | None) -> Timed:
        """All from a key frame at or before first_pts on."""
        if first_pts is not None and first_pts > self.info.start_pts and self._seeks:
            found = self._from_key_frame(first_pts)
            if (first := next(found, None)) is not None:
                yield first
                yield from found
                return
        yield from self._timed(self._decode(self._open()))
        self.truncated = self._verdict(True)

    def _from_key_frame(self, first_pts: int) -> Timed:
        """Frames from first_pts on, or nothing at all when the key frame before it cannot
        be found for sure.
        """
        stream = self._open()
        self._first = (
            first_pts  # what is before it may lack what it was predicted from
        )
        try:
            self._container.seek(first_pts, stream=stream, backward=True)
        except (av.error.FFmpegError, OSError):
            return
        begun, last = False, None
        for picture in self._decode(stream):
            if picture.pts is None or (last is not None and picture.pts <= last):
                if not begun or last is None or last < first_pts:
                    return  # times need repair, which depends on every frame before
                raise FrameTimesError(
                    f"{self.info.path}: frame times go backwards at {picture.pts}",
                    "process the clip from its start",
                )
            last = picture.pts
            if not begun and not (picture.key_frame and last <= first_pts):
                if last >= first_pts:
                    return
                continue  # leading frames of an open group: what they refer to lies before
            begun = True
            if last >= first_pts:
                yield picture, last
        self.truncated = self._verdict(False)

    def _decode(self, stream: Any) -> Iterator[av.VideoFrame]:
        """Pictures until the end; concealed ones, and those of another size, only if a good
        one follows.
        """
        held, strange = list[av.VideoFrame](), list[av.VideoFrame]()
        size = self.info.coded_width, self.info.coded_height
        for picture in self._raw(stream):
            if (picture.width, picture.height) != size:
                strange.append(picture)
                if len(strange) == _STRANGERS:
                    break
            elif picture.is_corrupt:
                held.append(picture)
            else:
                self.damaged |= bool(strange)  # a damaged header: left out
                strange.clear()
                yield from held
                held.clear()
                yield picture
        if strange:
            raise InputError(
                f"{self.info.path}: the picture changes from {size[0]}x{size[1]} to"
                f" {strange[0].width}x{strange[0].height} in the middle of the clip",
                "split the clip there, or convert it to one size",
            )
        if held and not self._stopped:
            self._stopped = "the last frames are damaged"

    def _raw(self, stream: Any) -> Iterator[av.VideoFrame]:
        for packet in itertools.chain(self._demux(stream), [None]):
            try:
                yield from stream.codec_context.decode(packet)
            except av.error.EOFError:
                return
            except (av.error.FFmpegError, OSError) as e:
                time = None if packet is None else packet.pts
                self.damaged |= time is None or time >= self._first
                if packet is None and not self._stopped:
                    self._stopped = f"the last frame cannot be decoded: {why(e)}"

    def _demux(self, stream: Any) -> Iterator[Any]:
        """Packets until the end. Damage that nothing follows is the end."""
        held, stopped, late = list[Any](), "", 0
        entries = stream.index_entries if self._by_decoding else ()
        numbers = {e.pos + _CHUNK_HEAD: e.timestamp for e in entries}
        for packet in read_on(self._container, [stream]):
            if isinstance(packet, Exception):
                stopped = f"reading stopped: {why(packet)}"
                continue
            held.append(packet)
            if packet.is_corrupt and len(held) < _HELD:
                continue
            self.damaged |= bool(stopped) or len(held) > 1
            stopped = ""
            for good in held:
                self._packets += 1
                if good.pos in numbers:
                    late = numbers[good.pos] - good.dts
                if late:  # those before that are lost were not counted
                    self.damaged = True
                    good.dts += late
                    good.pts = None if good.pts is None else good.pts + late
                if good.pts is not None:
                    self._end = max(self._end, good.pts + (good.duration or 0))
                yield good
            held.clear()
        size = self.info.path.stat().st_size
        cut = self.info.container == "mpegts" and all(size % n for n in _TS_PACKETS)
        self._stopped = (
            "the file ends in the middle of a frame" if held or cut else stopped
        )

    def _timed(self, pictures: Iterator[av.VideoFrame]) -> Timed:
        """Gives each picture a time above the one before: a missing or repeated one follows
        by one frame (or one tick), and what begins anew goes on after it."""
        rate = self.info.fps or 25.0
        step = max(round(1 / (rate * float(self.info.time_base))), 1)
        last: int | None = None
        shift = 0
        for picture in pictures:
            stated = picture.dts if self._by_decoding else picture.pts
            if last is None:
                start = self.info.start_pts
                pts = start if self._by_decoding or stated is None else stated
                shift = 0 if stated is None else pts - stated
            elif stated is None:
                pts = last + step
            else:
                if (last - stated - shift) * self.info.time_base > JUMP_S:
                    shift = last + step - stated
                pts = max(stated + shift, last + 1)
            self.repaired |= pts != picture.pts
            last = pts
            yield picture, pts

    def _verdict(self, whole: bool) -> str | None:
        info, reason = self.info, self._stopped
        length_s = float((self._end - info.start_pts) * info.time_base)
        stated_s = (info.duration_s or 0) if info.duration_of_video else 0
        counted = whole and any(n in info.container for n in ("mp4", "mov"))
        stated = (info.frame_count_stated or 0) if counted else 0
        if not reason and length_s < stated_s - _SHORT_S:
            reason = f"the file ends after {length_s:.2f} s of {stated_s:.2f} s"
        if not reason and 0 < self._packets < stated:
            reason = f"{self._packets} of {stated} frames are in the file"
        done = f"{info.path}: {reason}; processed to the last good frame"
        return done if reason else None


def read_on(container: Any, streams: list[Any]) -> Iterator[Any]:
    """Packets, and, where one cannot be read, the error in its place, until nothing more
    can be read.
    """
    failures = 0
    while failures < _MOST_FAILURES:
        try:
            for packet in container.demux(streams):
                failures = 0
                if packet.size:
                    yield packet
            return
        except (av.error.FFmpegError, OSError) as e:
            failures += 1
            yield e


def missing_frames(
    shown: Sequence[int], stated: Sequence[int], gaps: bool = True
) -> list[tuple[int, int]]:
    """(time, number) of the frames that are missing between those shown, in time base
    units. stated : times of packets, rising

    A packet apart from every frame shown gave none. gaps : packets may be lost too, which a
    gap tells, if the rate is constant"""
    if len(shown) < 3:
        return []
    steps, usual = _steps(shown)
    steady = int(gaps and np.mean(np.abs(steps - usual) <= usual / 4) >= 0.9)
    found = []
    for k in np.flatnonzero(steps > 2 * _APART * usual).tolist():
        lost = stated[
            bisect_right(stated, shown[k] + _APART * usual) : bisect_left(
                stated, shown[k + 1] - _APART * usual
            )
        ]
        if count := max(len(lost), steady * (round(steps[k] / usual) - 1)):
            found.append((lost[0] if lost else round(shown[k] + usual), count))
    return found


def late_frames(shown: Sequence[int], stated: Sequence[int]) -> int:
    """How many packets after the last frame shown gave none."""
    return len(stated) - bisect_right(stated, shown[-1] + _APART * _steps(shown)[1])


def _steps(shown: Sequence[int]) -> tuple[ndarray, float]:
    steps = np.diff(np.array(shown, dtype=object)).astype(float)
    return steps, float(np.median(steps)) if len(steps) else 0.0
