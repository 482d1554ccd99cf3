"""What a clip is, before its frames are read: size, times, colour, streams. `probe` decodes
one frame to be sure.
"""

import math
import re
import shlex
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from numpy import ndarray

from arfx.core.codec import Document
from arfx.core.colour import SRGB, Transfer
from arfx.core.opener import why
from arfx.errors import InputError
from arfx.media import hdr
from arfx.media.codecs import TABLES, check_size, open_video
from arfx.media.photos import is_photo
from arfx.media.planes import (
    FrameFormat,
    Orientation,
    PixelLayout,
    orientation_of,
    working_layout,
)

UNSPECIFIED = 2
PHOTO = "photo"  # container of one picture
MAX_PIXEL_ASPECT = 10.0  # anamorphic video reaches 2
# from this field order on a clip is interlaced; the odd ones show the bottom field first
_FIELDS = 2
_COVER = av.stream.Disposition.attached_pic
_MIDDLE_SITED = ("mjpeg", "mpeg1video", "jpeg2000")


@dataclass(frozen=True)
class StreamInfo(Document):
    """One stream of the file. used : the video stream that is processed;  picture : a
    cover, not a video
    broken : its header does not say how it is to be played"""

    index: int
    kind: str
    codec: str
    language: str = ""
    used: bool = False
    picture: bool = False
    broken: bool = False

    def __str__(self) -> str:
        return f"#{self.index} {self.kind} {self.codec}" + (
            f" ({self.language})" if self.language else ""
        )


@dataclass(frozen=True)
class ClipInfo(Document):
    """A clip's properties. width, height : upright px;  coded_* : as stored;  rotation_deg
    : counter-clockwise turn to upright.

    full_range, matrix : as used; where the stream names none, bt709 from 720 lines up, else
    bt601
    *_tag : the stream's own values (ITU-T H.273), written back;  pixel_format : as decoded;
    start_pts : of the first frame
    frame_count_stated : what the file says, often nothing;  duration_of_video : duration_s
    is this stream's, not the file's;
    notices : what a user should know;  field_order : FFmpeg's number (libavcodec/defs.h)
    mastering_display : x, y of red, green, blue and white, least and most cd/m2 (SMPTE ST 2086)
    content_light : most and average cd/m2 (CTA-861.3)"""

    path: Path
    width: int
    height: int
    coded_width: int
    coded_height: int
    rotation_deg: int
    fps: float | None
    codec: str
    container: str
    pixel_format: str
    bit_depth: int
    matrix: str
    full_range: bool
    time_base: Fraction
    matrix_tag: int = UNSPECIFIED
    range_tag: int = 0
    transfer_tag: int = UNSPECIFIED
    primaries_tag: int = UNSPECIFIED
    chroma_location: str = "left"
    transfer: Transfer = SRGB
    display_matrix: tuple[int, ...] | None = None
    sample_aspect: Fraction | None = None
    start_pts: int = 0
    frame_count_stated: int | None = None
    duration_s: float | None = None
    duration_of_video: bool = False
    stream_index: int = 0
    streams: tuple[StreamInfo, ...] = field(default_factory=tuple)
    notices: tuple[str, ...] = ()
    field_order: int = 0
    mastering_display: tuple[float, ...] | None = None
    content_light: tuple[int, int] | None = None

    @property
    def hdr(self) -> bool:
        return self.transfer_tag in hdr.TRANSFERS

    @property
    def fields(self) -> str:
        """Of an interlaced clip the field that is shown first: tff (the top one) or bff;
        else empty.
        """
        if self.field_order < _FIELDS:
            return ""
        return "bff" if self.field_order % 2 else "tff"

    @property
    def orientation(self) -> Orientation:
        return orientation_of(self.display_matrix)[0]

    @property
    def pixel_aspect(self) -> float:
        """Width of an upright pixel over its height.

        1 also where the file states what no lens or screen has.
        """
        stated = self.sample_aspect or Fraction(1)
        plausible = 1 / MAX_PIXEL_ASPECT <= stated <= MAX_PIXEL_ASPECT
        aspect = float(stated) if plausible else 1.0
        return 1 / aspect if self.orientation.transpose else aspect

    @property
    def layout(self) -> PixelLayout:
        """The working format of its frames."""
        return working_layout(self.pixel_format)[0]

    @property
    def audio(self) -> tuple[StreamInfo, ...]:
        return tuple(s for s in self.streams if s.kind == "audio")

    def frame_format(self) -> FrameFormat:
        return FrameFormat(
            self.layout,
            self.coded_width,
            self.coded_height,
            self.time_base,
            self.matrix,
            self.full_range,
            self.transfer,
            self.chroma_location,
            self.orientation,
        )


def ffmpeg_command(path: Path, filters: str, ending: str) -> str:
    """What makes another clip of one, as it is typed into a shell."""
    out = path.with_name(f"{path.stem}-{ending}.mkv")
    return (
        f"ffmpeg -i {shlex.quote(str(path))} -vf {filters} -crf 14 -c:a copy"
        f" {shlex.quote(str(out))}"
    )


def _describe(stream: Any, used: bool) -> StreamInfo:
    context = stream.codec_context
    named = stream.metadata.get("handler_name", "?")
    return StreamInfo(
        stream.index,
        stream.type,
        str(named) if context is None else context.name,
        stream.metadata.get("language", ""),
        used,
        stream.type == "video" and bool(stream.disposition & _COVER),
        stream.type == "audio" and not (context and context.sample_rate > 0),
    )


def probe(path: Path | str, transfer: Transfer = SRGB) -> ClipInfo:
    """Reads a clip's properties and decodes its first frame.
    transfer : how coded values become light; the stream's own tag is used for HLG and PQ
    alone (see ARCHITECTURE.md, Numbers)
    Raises InputError: missing, not a video, no video stream, nothing decodable.
    """
    path = Path(path)
    with open_video(path) as container:
        stream = next(
            (s for s in container.streams.video if not s.disposition & _COVER), None
        )
        if stream is None:
            held = ", ".join(sorted({s.type for s in container.streams})) or "nothing"
            raise InputError(
                f"{path} has no video stream (it holds: {held})",
                "give a clip with pictures",
            )
        if stream.codec_context is None:
            raise InputError(
                f"{path}: no decoder for its video", "convert it to H.264 first"
            )
        check_size(stream.codec_context.width, stream.codec_context.height, path)
        info = _info(
            container, stream, _first_picture(container, stream, path), path, transfer
        )
    return (
        replace(info, container=PHOTO, codec=PHOTO, fps=None, duration_s=None)
        if is_photo(path)
        else info
    )


def _first_picture(container: Any, stream: Any, path: Path) -> av.VideoFrame:
    stream.thread_type = "SLICE"  # frame threads would read many frames ahead for one
    reason = "no frame in it"
    packets = container.demux(stream)
    while True:
        try:
            for packet in packets:
                for picture in packet.decode():
                    return picture
            break
        except (av.error.FFmpegError, OSError) as e:
            reason = why(e)
    raise InputError(
        f"{path}: its video ({stream.codec_context.name}) cannot be decoded: {reason}",
        "is the file complete?",
    )


def _info(
    container: Any, stream: Any, first: av.VideoFrame, path: Path, transfer: Transfer
) -> ClipInfo:
    ctx = stream.codec_context
    space, trc, primaries = (
        next((t for t in tags if t not in (0, UNSPECIFIED)), tags[1])
        for name in ("colorspace", "color_trc", "color_primaries")
        if (tags := [int(getattr(of, name)) for of in (first, ctx)])
    )
    layout, notice = working_layout(first.format.name)
    notices = [notice] if notice else []
    beside = hdr.side_data(first)
    notices += hdr.left_out(beside)
    transfer = hdr.TRANSFERS.get(trc, transfer)
    matrix = TABLES["matrices"].get(str(space))
    if matrix is None:
        matrix = "bt709" if first.height >= 720 else "bt601"
        if layout.kind == "yuv":
            says = f"has the unsupported colour matrix {space}"
            if space in (0, UNSPECIFIED):
                says = "names no colour matrix"
            notices.append(
                f"the stream {says}: {matrix} is used ({first.height} lines)"
            )
    range_tag = int(first.color_range) or int(ctx.color_range)
    whole = {"yuv": "2", "gray": "02", "rgb": "012"}[layout.kind]
    full = str(range_tag) in whole or first.format.name.startswith("yuvj")
    turn = _display_matrix(first, beside)
    orientation, exact = orientation_of(turn)
    if not exact:
        notices.append(
            "the display matrix is no multiple of 90 degrees; the nearest is used"
        )
    order = max(int(ctx.field_order), _FIELDS * first.interlaced_frame)
    if order >= _FIELDS:
        notices.append(
            "the clip is interlaced; its fields are processed as one picture"
        )
    size = first.width, first.height
    w, h = size[::-1] if orientation.transpose else size
    sample = Fraction(stream.sample_aspect_ratio or 1)
    if sample != 1:
        used = "which is not plausible and not used"
        if 1 / MAX_PIXEL_ASPECT <= sample <= MAX_PIXEL_ASPECT:
            used = f"displayed as {round(first.width * sample)}x{first.height}"
        stored = f"stored as {first.width}x{first.height}"
        notices.append(
            f"the pixels are not square: {stored}, pixel aspect"
            f" {sample.numerator}:{sample.denominator}, {used}"
        )
    # Matroska's own of the stream
    duration, tag = None, stream.metadata.get("DURATION", "")
    if m := re.fullmatch(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", tag):
        duration = int(m[1]) * 3600 + int(m[2]) * 60 + Fraction(m[3])
    if stream.duration:
        duration = stream.duration * stream.time_base
    of_video = duration is not None or len(container.streams) == 1
    if duration is None and container.duration:
        duration = Fraction(container.duration, av.time_base)
    start_pts = first.pts if first.pts is not None else (first.dts or 0)
    start = start_pts * Fraction(stream.time_base)
    if "matroska" in container.format.name and duration and duration > start > 0:
        duration -= start  # there it is counted from 0, not from the first frame
    rate = stream.average_rate or stream.guessed_rate
    return ClipInfo(
        path,
        w,
        h,
        *size,
        orientation.rotation_deg,
        float(rate) if rate else None,
        ctx.name,
        container.format.name,
        first.format.name,
        layout.depth,
        matrix,
        full,
        Fraction(stream.time_base),
        space,
        range_tag,
        trc,
        primaries,
        "center" if ctx.name in _MIDDLE_SITED else "left",
        transfer,
        turn,
        sample if sample != 1 else None,
        start_pts,
        stream.frames or None,
        None if duration is None else float(duration),
        of_video,
        stream.index,
        tuple(_describe(s, s.index == stream.index) for s in container.streams),
        tuple(notices),
        order,
        hdr.mastering_display(beside),
        hdr.content_light(beside),
    )


def _display_matrix(
    picture: av.VideoFrame, beside: Mapping[str, bytes]
) -> tuple[int, ...] | None:
    """FFmpeg's nine numbers (libavutil/display.h), None where the picture has none."""
    if "DISPLAYMATRIX" in beside:
        return struct.unpack("=9i", beside["DISPLAYMATRIX"][:36])
    if not picture.rotation:
        return None
    angle = math.radians(picture.rotation)
    c, s = (round(f(angle) * (1 << 16)) for f in (math.cos, math.sin))
    return c, -s, 0, s, c, 0, 0, 0, 1 << 30


class Match(NamedTuple):
    """What was recorded about a frame's time. before, after : numbers of the two around it,
    or twice the only one
    share : of the way from one to the other, 0..1;  near : whether one of them was taken at
    the frame's time
    """

    before: int
    after: int
    share: float
    near: bool

    @property
    def nearest(self) -> int:
        return self.after if self.share > 0.5 else self.before


def match_by_time(
    taken_s: ndarray, times_s: list[float], near_s: float, gap_s: float = 0.0
) -> list[Match | None]:
    """What was recorded (depth maps, poses) around each frame, None where nothing is near.
    taken_s : rising
    near_s : so far from a frame it is still of the frame's time;  gap_s : longest time
    between two that tell what lies between
    """
    after = np.searchsorted(taken_s, times_s, "right").tolist()
    found: list[Match | None] = []
    for t, k in zip(times_s, after, strict=True):
        i, j = max(k - 1, 0), min(k, len(taken_s) - 1)
        since, until = float(abs(t - taken_s[i])), float(abs(taken_s[j] - t))
        near = min(since, until) <= near_s
        between = i < j and bool(taken_s[j] - taken_s[i] <= gap_s)
        share = since / (since + until) if i < j else 0.0
        share = share if between else float(share > 0.5)
        found.append(Match(i, j, share, near) if near or between else None)
    return found


def spacing_s(times_s: Sequence[float]) -> float:
    """Usual time from one to the next; 0 for a single one."""
    return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


def match_in_order(
    what: str, held: int, frames: int, before: int, whole: bool, hint: str
) -> list[int | None]:
    """One thing for each frame of the clip. before : frames of the clip before these;
    whole : these reach to its end
    Raises InputError where their number is not the clip's. what : the message's start
    ("depth X holds 4 maps")"""
    wanted = before + frames
    if held < wanted or (whole and held > wanted):
        raise InputError(
            f"{what}, the clip has {'' if whole else 'at least '}{wanted} frames",
            hint,
        )
    return list(range(before, wanted))
