"""Joining encoded chunks into the final file without encoding again: exact times, tags,
rotation, further streams.

The chunks' own times are not used, only their order: packet i of the clip, in decoding
order, shows the frame whose rank among the chunk's presentation times it has. With all
presentation times sorted into S, packet i is decoded at S[i] less the longest time that a
frame waits: so decode times rise over chunk borders, and the lengths of samples that MP4
and MOV take from them are those of the frames."""

import contextlib
import heapq
import math
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from arfx.core import interrupt
from arfx.core.guard import TIMES, part_name
from arfx.core.opener import ffmpeg_url
from arfx.errors import RenderError
from arfx.media.clip import PHOTO, ClipInfo
from arfx.media.codecs import create_container, open_video
from arfx.media.frames import JUMP_S, ClipReader, read_on
from arfx.media.output import OutputPlan
from arfx.media.photos import write_photo
from arfx.media.writer import abandon, failures, remove_output, set_tags

_MAX_TIMESCALE = (1 << 31) - 1
_MUXER_OWN = re.compile(
    "encoder|duration|rotate|major_brand|minor_version|compatible_brands"
    "|(_statistics|number_of).*",
    re.IGNORECASE | re.DOTALL,
)


def join_chunks(
    chunks: Sequence[Path],
    pts: Sequence[int],
    plan: OutputPlan,
    info: ClipInfo,
    out: Path,
    start_s: float | None = None,
    end_s: float | None = None,
    part: Path | None = None,
    made: Callable[[], None] | None = None,
) -> int:
    """Writes `out` from chunks in order. Returns how many packets of further streams, being
    damaged, it could not hold.

    part : where it is made, on the same disk; what is there is removed. None = a name
    beside it that nobody uses
    made : called when it is whole, before it gets its name
    pts : presentation times of all their frames in info.time_base, rising; start_s, end_s :
    the cut that was made, in
    seconds after the clip's first frame, for the streams that are copied.
    Raises RenderError: chunks and times do not match, chunks of different settings, the
    file cannot be written. Then nothing is left under the final name that was not there
    before."""
    path = out = Path(out)
    if plan.is_sequence:
        out = out.absolute().parent
    part = part or part_name(out)
    left_out = 0
    with failures(path, lambda: remove_output(part)):
        remove_output(part)
        if plan.is_sequence:
            _gather(chunks, len(pts), part)
        elif plan.container == PHOTO:
            write_photo(part, chunks[0], info.path, out.suffix.lower())
        else:
            left_out = _remux(chunks, pts, plan, info, part, start_s, end_s)
        if made is not None:
            made()
        with interrupt.committing():
            empty = plan.is_sequence and out.is_dir() and not any(out.iterdir())
            if empty and not out.samefile(Path.cwd()):
                out.rmdir()
            if not (plan.is_sequence and out.exists()):
                part.replace(out)  # a new or empty folder appears at once
            else:  # it keeps its other files; each image is replaced in one step
                for f in part.iterdir():
                    f.replace(out / f.name)
                    # two names of one file: to rename one to the other leaves both
                    f.unlink(missing_ok=True)
                part.rmdir()
    return left_out


def _packets_of(chunk: Path) -> Any:
    """The opened file for reading packets only: FFmpeg would else decode a picture of each
    to tell its format (14 ms).
    """
    return av.open(ffmpeg_url(chunk), options={"skip_frame": "all"})


def _video_packets(
    chunks: Sequence[Path], pts: Sequence[int], time_base: Fraction, stream: Any
) -> Iterator[tuple[Fraction, Any]]:
    """(decode time in seconds, packet).

    What is decoded last has the last frame's length, since MP4 and MOV end with it.
    """
    # of each packet in decoding order the number of its frame in the clip
    ranks, extradata = list[int](), None
    for chunk in chunks:
        with _packets_of(chunk) as c:
            coded = c.streams.video[0]
            own = bytes(coded.codec_context.extradata or b"")
            if extradata not in (None, own):
                raise RenderError(
                    f"{chunk}: encoded with other settings than the chunks before",
                    "render the job again",
                )
            extradata = own
            times = [p.pts for p in c.demux(coded) if p.size]
            order = np.argsort(np.argsort(times, kind="stable"))
            ranks += (len(ranks) + order).tolist()
    if len(ranks) != len(pts):
        raise RenderError(
            f"the chunks hold {len(ranks)} frames, the clip has {len(pts)}",
            "render the job again",
        )
    i, wait = 0, max(pts[i] - pts[r] for i, r in enumerate(ranks))
    last = pts[-1] - pts[-2] if len(pts) > 1 else 0
    for chunk in chunks:
        with _packets_of(chunk) as c:
            for p in c.demux(c.streams.video[0]):
                if not p.size:
                    continue
                shown = ranks[i]
                p.time_base, p.stream = time_base, stream
                p.pts, p.dts = pts[shown], pts[i] - wait
                shows_to_end = len(pts) - 1 in (i, shown)
                p.duration = last if shows_to_end else pts[shown + 1] - pts[shown]
                yield p.dts * time_base, p
                i += 1


def _remux(
    chunks: Sequence[Path],
    pts: Sequence[int],
    plan: OutputPlan,
    info: ClipInfo,
    part: Path,
    start_s: float | None,
    end_s: float | None,
) -> int:
    left_out = 0
    options = {"fflags": "+bitexact", "avoid_negative_ts": "disabled"}
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(open_video(info.path))
        first = stack.enter_context(av.open(ffmpeg_url(chunks[0])))
        if plan.container in ("mp4", "mov"):
            scale = _timescale(info, source, plan)
            options |= {"movflags": "faststart", "movie_timescale": str(scale)}
        out = create_container(part, plan.container, container_options=options)
        stack.callback(abandon, out)
        out.metadata.update(_plain_metadata(source.metadata))
        streams: dict[int, Any] = {}
        for s in source.streams:  # the source's order of streams
            if s.index == info.stream_index:
                shown = _add_video(out, first.streams.video[0], s, plan, info)
            elif s.index in plan.streams:
                streams[s.index] = _add_stream(out, s, s, s.time_base)
                if s.type == "video":
                    rate = s.average_rate or s.guessed_rate or Fraction(25)
                    streams[s.index].codec_context.framerate = rate
        if start_s is None and end_s is None and source.chapters():
            out.set_chapters(source.chapters())
        video = _video_packets(chunks, pts, info.time_base, shown)
        further = _copied_packets(source, info, streams, start_s, end_s)
        # by decode time, so that the muxer never holds more than a moment of either
        for _, packet in heapq.merge(video, further, key=lambda timed: timed[0]):
            try:
                out.mux(packet)
            except (av.error.InvalidDataError, av.error.ArgumentError):
                if packet.stream.index == shown.index:
                    raise
                left_out += 1  # damaged, and the clip did not say so
        out.close()
    return left_out


def _plain_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    """Tags that belong to the recording, not to the file that held it."""
    return {k: v for k, v in metadata.items() if not _MUXER_OWN.fullmatch(k)}


def _add_stream(out: Any, template: Any, source: Any, time_base: Fraction) -> Any:
    """A stream in `out` with the parameters of `template`, and the language and disposition
    of a source stream.
    """
    stream = out.add_stream_from_template(template, opaque=True)
    stream.time_base = time_base
    stream.metadata.update(_plain_metadata(source.metadata))
    stream.disposition = source.disposition
    return stream


def _add_video(
    out: Any, template: Any, source: Any, plan: OutputPlan, info: ClipInfo
) -> Any:
    stream = _add_stream(out, template, source, info.time_base)
    ctx = stream.codec_context
    set_tags(ctx, plan, info)
    if info.fps:
        ctx.framerate = Fraction(info.fps).limit_denominator(1001)
    if plan.codec == "h265" and plan.container in ("mp4", "mov"):
        # the tag that all players know; parameter sets are in the header
        ctx.codec_tag = "hvc1"
    if info.display_matrix is not None:
        stream.set_display_matrix(info.display_matrix)
    return stream


def _copied_packets(
    container: Any,
    info: ClipInfo,
    streams: Mapping[int, Any],
    start_s: float | None,
    end_s: float | None,
) -> Iterator[tuple[Fraction, Any]]:
    """(decode time in seconds, packet) for the streams of the output, by their numbers in
    the clip, in file order. start_s, end_s : seconds after the clip's first frame; a packet
    that ends before or begins after them is left out. A further video stream begins at its
    last key frame before start_s, so that it can be decoded. What begins anew goes on as
    the frames do."""
    if not streams:
        return
    zero = info.start_pts * info.time_base
    low = -math.inf if start_s is None else zero + Fraction(start_s)
    high = math.inf if end_s is None else zero + Fraction(end_s)
    waiting: dict[int, list[Any]] = {}
    last, jumps, shifts = dict[int, Fraction](), Counter[int](), list[int]()
    for packet in read_on(container, [container.streams[i] for i in streams]):
        if isinstance(packet, Exception) or packet.is_corrupt:
            continue
        stated = packet.dts if packet.pts is None else packet.pts
        if stated is None:
            continue
        number, time = packet.stream_index, stated * packet.time_base
        if last.get(number, time) - time > JUMP_S:
            jumps[number] += 1
            if not shifts:
                with ClipReader(info) as reader:
                    shifts += reader.shifts() or [0]
        last[number] = time
        if jumps[number]:
            shift = shifts[min(jumps[number], len(shifts)) - 1] * info.time_base
            ticks, time = round(shift / packet.time_base), time + shift
            packet.pts = None if packet.pts is None else packet.pts + ticks
            packet.dts = None if packet.dts is None else packet.dts + ticks
        if time >= high:
            continue
        if time + (packet.duration or 0) * packet.time_base <= low:
            if packet.stream.type == "video":
                if packet.is_keyframe:
                    waiting[number] = []
                waiting.setdefault(number, []).append(packet)
            continue
        for p in [*waiting.pop(number, []), packet]:
            decoded = (p.pts if p.dts is None else p.dts) * p.time_base
            p.stream = streams[number]
            yield decoded, p


def _timescale(info: ClipInfo, source: Any, plan: OutputPlan) -> int:
    """A movie clock in which a late start of any stream is a whole number: edit lists count
    in it.
    """
    scale = info.time_base.denominator
    while scale < 10000:
        scale *= 2
    for i in plan.streams:
        both = math.lcm(scale, source.streams[i].time_base.denominator)
        if both <= _MAX_TIMESCALE:
            scale = both
    return scale


def _gather(chunks: Sequence[Path], count: int, part: Path) -> None:
    """The images of all chunk folders in one."""
    part.mkdir(parents=True)
    times = []
    for chunk in chunks:
        for f in sorted(chunk.iterdir()):
            if f.name == TIMES:
                times.append(f.read_text())
                continue
            try:
                os.link(f, part / f.name)
            except OSError:  # another file system, or one without links
                shutil.copyfile(f, part / f.name)
    images = sum(1 for _ in part.iterdir())
    if images != count:
        raise RenderError(
            f"the chunks hold {images} images, the clip has {count} frames",
            "render the job again",
        )
    (part / TIMES).write_text("".join(times))
