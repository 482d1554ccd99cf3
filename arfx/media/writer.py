"""Encoding one chunk of a clip: a file of its own, starting on a key frame, written aside
and renamed when whole.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.filter
import numpy as np
from av.codec.context import Flags

from arfx.core.guard import TIMES
from arfx.errors import ArfxError
from arfx.media.clip import ClipInfo
from arfx.media.codecs import CODECS, create_container, open_encoder
from arfx.media.frame import SWS_MATRIX, Frame
from arfx.media.images import write_exr, write_failed, write_png
from arfx.media.output import OutputPlan
from arfx.media.planes import repacked

_DEEPEST_REORDER = 16  # H.264 and H.265 allow at most 16 frames of reordering


def chunk_suffix(plan: OutputPlan) -> str:
    """The extension of a chunk's file; "" for an image sequence, whose chunks are folders.
    NUT keeps every time exactly; codecs that it cannot hold with their tags (FFV1, ProRes)
    go into Matroska, whose rounded times do no harm: both are intra-only, and joining takes
    the times from the clip."""
    return "" if plan.is_sequence else CODECS[plan.codec].chunk


class ChunkWriter:
    """Context manager: frames in, a file (or a folder of images) out under `path`, or
    nothing after an error. Raises RenderError: the file cannot be written, the encoder fails."""

    def __init__(self, plan: OutputPlan, info: ClipInfo, path: Path) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        with failures(self.path, lambda: remove_output(self.part)):
            remove_output(self.part)
            kind = _Images if plan.is_sequence else _Video
            self._file: _Images | _Video = kind(plan, info, self.part)

    def __enter__(self) -> ChunkWriter:
        return self

    def write(self, frame: Frame) -> None:
        """Encodes one frame; frames must come in order of presentation."""
        with failures(self.path, self._abandon):
            self._file.write(frame)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._abandon()
            return
        with failures(self.path, self._abandon):
            self._file.finish()
            remove_output(self.path)
            self.part.replace(self.path)

    def _abandon(self) -> None:
        abandon(self._file)
        remove_output(self.part)


class _Images:
    """A folder with an image of each frame, and their times."""

    def __init__(self, plan: OutputPlan, info: ClipInfo, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        self._times: list[str] = []
        folder.mkdir(parents=True)

    def write(self, frame: Frame) -> None:
        path = self._folder / (Path(self._plan.path).name % frame.index)
        linear = frame.linear(frame.rect)
        if self._plan.codec == "exr":
            write_exr(path, linear)
        else:
            kind = np.uint8 if self._plan.pixel_format == "rgb24" else np.uint16
            coded = np.clip(frame.clip.transfer.encode(linear), 0, 1)
            write_png(path, np.rint(coded * np.iinfo(kind).max).astype(kind))
        self._times.append(f"{frame.index} {frame.time_s:.9f}\n")

    def finish(self) -> None:
        (self._folder / TIMES).write_text("".join(self._times))

    def close(self) -> None:
        """Nothing is open."""


class _Video:
    """An encoder, and the container of its packets."""

    def __init__(self, plan: OutputPlan, info: ClipInfo, path: Path) -> None:
        self._plan = plan
        codec = CODECS[plan.codec]
        # no random identifiers: same frames, same bytes
        options = {"fflags": "+bitexact", "avoid_negative_ts": "disabled"}
        kind = {".nut": "nut", ".mkv": "matroska"}[codec.chunk]
        self._container = create_container(path, kind, container_options=options)
        settings = dict(plan.options)
        if info.fields and plan.codec == "h264":
            settings = {"x264-params": f"{info.fields}=1"} | settings
        rate = Fraction(info.fps or 25).limit_denominator(1001)
        s = self._container.add_stream(codec.encoder, rate=rate, options=settings)
        ctx = s.codec_context
        s.width, s.height = info.coded_width, info.coded_height
        packed = plan.codec == "ffv1" and plan.pixel_format == "gbrp"
        s.pix_fmt = "bgr0" if packed else plan.pixel_format
        s.time_base = ctx.time_base = info.time_base
        # slice threads cost x264 half its speed
        ctx.thread_count, ctx.thread_type = codec.threads, "FRAME"
        set_tags(ctx, plan, info)
        self._fields: Any = None
        if info.fields:
            ctx.flags |= Flags.interlaced_dct | Flags.interlaced_me
            self._fields = graph = av.filter.Graph()
            source = graph.add_buffer(
                width=s.width,
                height=s.height,
                format=s.pix_fmt,
                time_base=info.time_base,
            )
            field, sink = graph.add("setfield", info.fields), graph.add("buffersink")
            graph.link_nodes(source, field, sink).configure()
        open_encoder(ctx)
        self._stream = s
        self._shown: list[int] = []
        self._shift = self._muxed = 0

    def write(self, frame: Frame) -> None:
        f, plan = frame.clip, self._plan
        picture = repacked(  # the same planes where the formats agree
            frame.picture,
            self._stream.pix_fmt,
            src_colorspace=SWS_MATRIX[f.matrix],
            dst_colorspace=SWS_MATRIX[plan.matrix],
            src_color_range=2 if f.full_range else 1,
            dst_color_range=2 if plan.full_range else 1,
            interpolation="BICUBIC",
        )
        if not self._shown:
            # no chunk container holds times below 0; joining only needs their order
            self._shift = max(-frame.pts, 0)
        self._shown.append(frame.pts + self._shift)
        picture.pts, picture.time_base = self._shown[-1], f.time_base
        if self._fields is not None:  # which marks it as interlaced
            self._fields.vpush(picture)
            picture = self._fields.vpull()
        picture.pict_type = 0  # the source's I/P/B would be forced on the encoder
        self._mux(self._stream.encode(picture))

    def _mux(self, packets: list[av.Packet]) -> None:
        """Writes packets with decode times of our own: x265 leaves those of chunks shorter
        than its delay undefined.
        """
        for p in packets:
            k = self._muxed - _DEEPEST_REORDER
            p.dts = self._shown[k] if k >= 0 else self._shown[0] + k
            self._container.mux(p)
            self._muxed += 1

    def finish(self) -> None:
        self._mux(self._stream.encode(None))
        self.close()

    def close(self) -> None:
        self._container.close()


def set_tags(context: Any, plan: OutputPlan, info: ClipInfo) -> None:
    """What a video stream says of its colours, fields and pixels' shape."""
    context.colorspace, context.color_range = plan.matrix_tag, plan.range_tag
    context.color_trc, context.color_primaries = plan.transfer_tag, plan.primaries_tag
    if info.fields:
        context.field_order = info.field_order
    if info.sample_aspect is not None:
        context.sample_aspect_ratio = info.sample_aspect


def abandon(file: Any) -> None:
    """Close one that is whole already, or has failed: the first error is the one that counts."""
    with contextlib.suppress(av.error.FFmpegError, OSError):
        file.close()


@contextlib.contextmanager
def failures(path: Path, undo: Callable[[], None]) -> Iterator[None]:
    """After what went wrong in the body, `undo`; it is raised: a RenderError where the system or
    FFmpeg cannot write `path`."""
    try:
        yield
    except BaseException as e:
        with contextlib.suppress(OSError):
            undo()
        system = isinstance(e, (av.error.FFmpegError, OSError, ValueError))
        if system and not isinstance(e, ArfxError):
            raise write_failed(path, e) from e
        raise


def remove_output(path: Path) -> None:
    """Removes a file or a folder of images, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()
