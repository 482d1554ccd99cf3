"""Pixel formats as planes: which formats are worked on directly, and views of a picture's planes.

A working format is planar: YUV with any subsampling, grey, or RGB as gbrp, with 8 to 16 bits. Everything else
(nv12, yuyv, packed RGB, palettes) is repacked into one once per picture, without loss where such a format exists.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, cached_property

import av
import numpy as np

_YUV = re.compile(r"yuv(?P<kind>[ja]?)(?P<sub>420|422|444|440|411|410)p(?P<bits>9|10|12|14|16)?(le)?$")
_GRAY = re.compile(r"gray(?P<bits>9|10|12|14|16)?(le)?$")
_GBR = re.compile(r"gbra?p(?P<bits>9|10|12|14|16)?(le)?$")
_SUBSAMPLING = {"420": (1, 1), "422": (1, 0), "444": (0, 0), "440": (0, 1), "411": (2, 0), "410": (2, 2)}
_NAME_OF = {v: k for k, v in _SUBSAMPLING.items()}


@dataclass(frozen=True)
class PixelLayout:
    """A working format. kind : yuv | gray | rgb;  depth : bits per sample;  sub_x, sub_y : log2 of the chroma step."""

    name: str
    kind: str
    depth: int
    sub_x: int = 0
    sub_y: int = 0
    alpha: bool = False

    @property
    def dtype(self) -> np.dtype:
        return np.dtype("u1") if self.depth == 8 else np.dtype("<u2")

    @property
    def subsampling(self) -> str:
        return _NAME_OF[self.sub_x, self.sub_y]

    @cached_property
    def plain_name(self) -> str:
        """The same planes without FFmpeg's deprecated j: the range is a tag, not a format."""
        return self.name.replace("yuvj", "yuv")

    @property
    def peak(self) -> int:
        return (1 << self.depth) - 1


@cache
def layout_named(name: str) -> PixelLayout | None:
    """The layout of a working format; None for every other format."""
    if m := _YUV.match(name):
        sx, sy = _SUBSAMPLING[m["sub"]]
        return PixelLayout(name, "yuv", int(m["bits"] or 8), sx, sy, m["kind"] == "a")
    if m := _GRAY.match(name):
        return PixelLayout(name, "gray", int(m["bits"] or 8))
    if m := _GBR.match(name):
        return PixelLayout(name, "rgb", int(m["bits"] or 8), 0, 0, name.startswith("gbra"))
    return None


@cache
def working_layout(name: str) -> tuple[PixelLayout, str]:
    """The working format for a decoded format, and a notice ("" when the planes are used as they are).

    The choice keeps bit depth (8, 10, 12 or 16) and subsampling.
    """
    if layout := layout_named(name):
        return layout, ""
    f = av.VideoFormat(name, 16, 16)
    bits = max(c.bits for c in f.components)
    depth = next((d for d in (8, 10, 12, 16) if bits <= d), 16)
    tail = "" if depth == 8 else f"{depth}le"
    colours = [c for c in f.components if not c.is_alpha]
    if f.is_rgb or f.has_palette:
        target = f"gbrp{tail}"
    elif len(colours) == 1 or name.startswith("mono"):
        target = f"gray{tail}"
    else:
        sub = (round(np.log2(16 / f.chroma_width(16))), round(np.log2(16 / f.chroma_height(16))))
        target = f"yuv{_NAME_OF.get(sub, '444')}p{tail}"
    layout = layout_named(target)
    assert layout is not None
    lost = " (its transparency is left out)" if any(c.is_alpha for c in f.components) else ""
    return layout, f"pixel format {name} is repacked to {target}{lost}"


def planes_of(picture: av.VideoFrame, layout: PixelLayout) -> list[np.ndarray]:
    """Every plane as a whole-line array (rows, line length in samples), padding at the right included; views."""
    out = []
    for p in picture.planes:
        size = layout.dtype.itemsize
        rows = p.buffer_size // p.line_size
        line = np.frombuffer(p, layout.dtype, count=rows * p.line_size // size)  # type: ignore[call-overload]
        out.append(line.reshape(rows, p.line_size // size)[: p.height])
    return out


def chroma_size(layout: PixelLayout, width: int, height: int) -> tuple[int, int]:
    """Width and height of the chroma planes; an odd picture has one more column or row of them than half."""
    return -(-width >> layout.sub_x), -(-height >> layout.sub_y)


def copy_picture(picture: av.VideoFrame, layout: PixelLayout) -> av.VideoFrame:
    """A writable copy with the same samples and tags, under the format's plain name (no yuvj)."""
    out = av.VideoFrame(picture.width, picture.height, layout.plain_name)
    for a, b in zip(planes_of(picture, layout), planes_of(out, layout), strict=True):
        n = min(a.shape[1], b.shape[1])
        np.copyto(b[:, :n], a[:, :n])
    _keep_time(picture, out)
    out.colorspace, out.color_range = picture.colorspace, picture.color_range
    out.color_primaries, out.color_trc = picture.color_primaries, picture.color_trc
    return out


def _keep_time(picture: av.VideoFrame, out: av.VideoFrame) -> None:
    out.pts = picture.pts
    if picture.time_base is not None:  # pictures flushed out of a decoder have none
        out.time_base = picture.time_base


def repacked(picture: av.VideoFrame, layout: PixelLayout) -> av.VideoFrame:
    """The picture in the working format; itself when it already is in it."""
    if picture.format.name == layout.name:
        return picture
    held = layout_named(picture.format.name)
    if held is not None and held.plain_name == layout.plain_name:
        return copy_picture(picture, held)
    out = picture.reformat(
        format=layout.name,
        src_colorspace=picture.colorspace,
        dst_colorspace=picture.colorspace,
        src_color_range=picture.color_range,
        dst_color_range=picture.color_range,
        interpolation="POINT",
    )
    _keep_time(picture, out)
    return out
