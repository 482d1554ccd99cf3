"""Encoding one chunk of a clip: a file of its own, starting on a key frame, written aside
and renamed when whole.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.filter
import numpy as np
from av.codec.context import Flags

from arfx.core.guard import TIMES
from arfx.errors import RenderError
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
    nothing after an error. Raises RenderError: the file cannot be written, the encoder
    fails, frames out of order, no frame at all."""

    def __init__(self, plan: OutputPlan, info: ClipInfo, path: Path) -> None:
        self.plan, self.info, self.path = plan, info, Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        self._container: Any = None
        self._stream: Any = None
        self._fields: Any = None  # marks pictures as interlaced
        self._last: int | None = None
        self._shown: list[int] = []
        self._shift = 0
        self._muxed = 0
        self._times: list[tuple[int, float]] = []

    def __enter__(self) -> ChunkWriter:
        try:
            remove_output(self.part)
            if self.plan.is_sequence:
                self.part.mkdir(parents=True)
            else:
                self._open()
        except (av.error.FFmpegError, OSError, ValueError) as e:
            self._abandon()
            raise write_failed(self.path, e) from e
        return self

    def _open(self) -> None:
        plan, info = self.plan, self.info
        kind = {".nut": "nut", ".mkv": "matroska"}[chunk_suffix(plan)]
        options = {
            "fflags": "+bitexact",
            "avoid_negative_ts": "disabled",
        }  # no random identifiers: same frames, same bytes
        self._container = create_container(self.part, kind, container_options=options)
        fields = (
            {"x264-params": f"{info.fields}=1"}
            if info.fields and plan.codec == "h264"
            else {}
        )
        rate = Fraction(info.fps or 25).limit_denominator(1001)
        s = self._container.add_stream(
            CODECS[plan.codec].encoder, rate=rate, options=fields | dict(plan.options)
        )
        ctx = s.codec_context
        s.width, s.height = info.coded_width, info.coded_height
        s.pix_fmt = (
            "bgr0"
            if plan.codec == "ffv1" and plan.pixel_format == "gbrp"
            else plan.pixel_format
        )
        s.time_base = ctx.time_base = info.time_base
        ctx.thread_count, ctx.thread_type = (
            plan.encoder_threads,
            "FRAME",
        )  # slice threads cost x264 half its speed
        ctx.colorspace, ctx.color_range = plan.matrix_tag, plan.range_tag
        ctx.color_trc, ctx.color_primaries = plan.transfer_tag, plan.primaries_tag
        if info.fields:
            ctx.flags |= Flags.interlaced_dct | Flags.interlaced_me
            ctx.field_order = info.field_order
            self._fields = av.filter.Graph()
            source = self._fields.add_buffer(
                width=s.width, height=s.height, format=s.pix_fmt, time_base=info.time_base
            )
            self._fields.link_nodes(
                source,
                self._fields.add("setfield", info.fields),
                self._fields.add("buffersink"),
            ).configure()
        if info.sample_aspect is not None:
            ctx.sample_aspect_ratio = info.sample_aspect
        open_encoder(ctx)
        self._stream = s

    def write(self, frame: Frame) -> None:
        """Encodes one frame; frames must come in order of presentation."""
        if self._last is not None and frame.pts <= self._last:
            raise RenderError(
                f"frame {frame.index}: its time {frame.pts} does not follow {self._last}"
            )
        self._last = frame.pts
        if self.plan.is_sequence:
            self._write_image(frame)
            return
        picture = self._stored(frame)
        if not self._shown:
            self._shift = max(
                -frame.pts, 0
            )  # no chunk container holds times below 0; joining only needs their order
        self._shown.append(frame.pts + self._shift)
        picture.pts, picture.time_base = self._shown[-1], self.info.time_base
        if self._fields is not None:
            self._fields.vpush(picture)
            picture = self._fields.vpull()
        picture.pict_type = 0  # the source's I/P/B would be forced on the encoder
        try:
            self._mux(self._stream.encode(picture))
        except (av.error.FFmpegError, OSError, ValueError) as e:
            raise write_failed(self.path, e) from e

    def _mux(self, packets: list[av.Packet]) -> None:
        """Writes packets with decode times of our own: x265 leaves those of chunks shorter
        than its delay undefined.
        """
        for p in packets:
            k = self._muxed - _DEEPEST_REORDER
            p.dts = self._shown[k] if k >= 0 else self._shown[0] + k
            self._container.mux(p)
            self._muxed += 1

    def _stored(self, frame: Frame) -> av.VideoFrame:
        """The frame's picture in the encoder's pixel format: the same planes where the
        formats agree.
        """
        f, plan = frame.format, self.plan
        return repacked(
            frame.picture,
            self._stream.pix_fmt,
            src_colorspace=SWS_MATRIX[f.matrix],
            dst_colorspace=SWS_MATRIX[plan.matrix],
            src_color_range=2 if f.full_range else 1,
            dst_color_range=2 if plan.full_range else 1,
            interpolation="BICUBIC",
        )

    def _write_image(self, frame: Frame) -> None:
        path, linear = (
            self.part / (Path(self.plan.path).name % frame.index),
            frame.linear(frame.rect),
        )
        if self.plan.codec == "exr":
            write_exr(path, linear)
        else:
            kind = np.uint8 if self.plan.pixel_format == "rgb24" else np.uint16
            write_png(
                path,
                np.rint(
                    np.clip(frame.format.transfer.encode(linear), 0, 1) * np.iinfo(kind).max
                ).astype(kind),
            )
        self._times.append((frame.index, frame.time_s))

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._abandon()
            return
        try:
            if self._last is None:
                raise RenderError(f"{self.path}: a chunk without frames")
            if self.plan.is_sequence:
                lines = [f"{i} {t:.9f}\n" for i, t in self._times]
                (self.part / TIMES).write_text("".join(lines))
            else:
                self._mux(self._stream.encode(None))
                self._close()
            remove_output(self.path)
            self.part.replace(self.path)
        except (av.error.FFmpegError, OSError) as e:
            self._abandon()
            raise write_failed(self.path, e) from e
        except BaseException:
            self._abandon()
            raise

    def _close(self) -> None:
        if self._container is not None:
            container, self._container = self._container, None
            container.close()

    def _abandon(self) -> None:
        with contextlib.suppress(
            av.error.FFmpegError, OSError
        ):  # thrown away; the first error is reported
            self._close()
        remove_output(self.part)


def remove_output(path: Path) -> None:
    """Removes a file or a folder of images, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()
