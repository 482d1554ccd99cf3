"""Stored pixels: which formats are worked on directly, views of a picture's planes, and how
they lie when shown upright.

A working format is planar: YUV with any subsampling, grey, or RGB as gbrp, with 8 to 16
bits. Everything else (nv12, yuyv, packed RGB, palettes) is repacked into one once per
picture, without loss where such a format exists."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property
from typing import Any

import av
import numpy as np
from av.codec.codec import find_best_pix_fmt_of_list
from av.video.format import names as video_formats  # type: ignore[attr-defined]
from numpy import ndarray

from arfx.core.colour import SRGB, Transfer
from arfx.core.rect import Rect

_NAME = re.compile(
    r"(?P<kind>yuv[ja]?|gray|gbra?)(?P<sub>420|422|444|440|411|410)?p?"
    r"(?P<bits>9|10|12|14|16)?(le)?"
)
_SUBSAMPLING = {
    "420": (1, 1),
    "422": (1, 0),
    "444": (0, 0),
    "440": (0, 1),
    "411": (2, 0),
    "410": (2, 2),
}
_NAME_OF = {v: k for k, v in _SUBSAMPLING.items()}


@dataclass(frozen=True)
class PixelLayout:
    """A working format. kind : yuv | gray | rgb;  depth : bits per sample;  sub_x, sub_y :
    log2 of the chroma step.
    """

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

    def holds(self, odd: tuple[int, int]) -> bool:
        """Whether its chroma covers a picture of odd width, height."""
        return not (odd[0] and self.sub_x) and not (odd[1] and self.sub_y)

    @property
    def peak(self) -> int:
        return (1 << self.depth) - 1


@cache
def layout_named(name: str) -> PixelLayout | None:
    """The layout of a working format; None for every other format."""
    m = _NAME.fullmatch(name)
    if m is None or name.startswith("yuv") != bool(m["sub"]):
        return None
    kind = "yuv" if m["sub"] else "rgb" if name.startswith("gbr") else "gray"
    sub, alpha = _SUBSAMPLING.get(m["sub"], (0, 0)), m["kind"] in ("yuva", "gbra")
    return PixelLayout(name, kind, int(m["bits"] or 8), *sub, alpha)


@cache
def working_layout(name: str) -> tuple[PixelLayout, str]:
    """The working format for a decoded format, and a notice ("" when the planes are used as
    they are): that which loses least, as FFmpeg reckons it."""
    if layout := layout_named(name):
        return layout, ""
    known = {
        f.name: f for n in video_formats if (f := layout_named(n)) and not f.alpha
    }
    plain = [n for n, f in known.items() if n == f.plain_name]
    best, _ = find_best_pix_fmt_of_list(plain, name)
    assert best is not None
    alpha = any(c.is_alpha for c in av.VideoFormat(name, 16, 16).components)
    lost = " (its transparency is left out)" if alpha else ""
    return known[best.name], f"pixel format {name} is repacked to {best.name}{lost}"


def planes_of(picture: av.VideoFrame, layout: PixelLayout) -> list[ndarray]:
    """Every plane as a whole-line array (rows, line length in samples), padding at the
    right included; views.
    """
    kind = layout.dtype
    return [
        np.frombuffer(p, kind).reshape(-1, p.line_size // kind.itemsize)[: p.height]  # type: ignore[call-overload]
        for p in picture.planes
    ]


def copy_picture(picture: av.VideoFrame, layout: PixelLayout) -> av.VideoFrame:
    """A writable copy with the same samples and tags, under the format's plain name (no yuvj)."""
    out = av.VideoFrame(picture.width, picture.height, layout.plain_name)
    for a, b in zip(planes_of(picture, layout), planes_of(out, layout), strict=True):
        n = min(a.shape[1], b.shape[1])
        np.copyto(b[:, :n], a[:, :n])
    out.pts = picture.pts
    if picture.time_base is not None:  # pictures flushed out of a decoder have none
        out.time_base = picture.time_base
    out.colorspace, out.color_range = picture.colorspace, picture.color_range
    out.color_primaries, out.color_trc = picture.color_primaries, picture.color_trc
    return out


def repacked(picture: av.VideoFrame, name: str, **how: Any) -> av.VideoFrame:
    """The picture in the format of that name; itself when it already is in it.

    how : it is converted, as of `reformat`; nothing = all but the layout of samples stays"""
    given = picture.format.name
    if given == name:
        return picture
    held = layout_named(given)
    if held is not None and held.plain_name == name.replace("yuvj", "yuv"):
        return copy_picture(picture, held)
    if not how:
        how = {"interpolation": "POINT"}
        for end in ("src", "dst"):
            how[f"{end}_colorspace"] = picture.colorspace
            how[f"{end}_color_range"] = picture.color_range
    return picture.reformat(format=name, **how)


@dataclass(frozen=True)
class Orientation:
    """upright = flips of (the transpose of) coded. All eight orientations of a rectangle."""

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @property
    def rotation_deg(self) -> int:
        """Counter-clockwise rotation from coded to upright, 0, 90, 180 or 270; of a
        mirrored one, that before the mirror.
        """
        return 90 * self.transpose + 180 * (self.transpose != self.flip_y)

    def upright(self, coded: ndarray) -> ndarray:
        """View of coded (h, w, ...) as it is shown."""
        v = coded.swapaxes(0, 1) if self.transpose else coded
        return v[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]

    def coded(self, upright: ndarray) -> ndarray:
        """The inverse of `upright`, also a view."""
        if not self.transpose:
            return self.upright(upright)
        return Orientation(True, self.flip_y, self.flip_x).upright(upright)

    def coded_rect(self, rect: Rect, width: int, height: int) -> Rect:
        """Where an upright rectangle lies among the coded pixels.

        width, height : of the upright picture, px.
        """
        x0, x1 = rect.x0, rect.x1
        if self.flip_x:
            x0, x1 = width - x1, width - x0
        y0, y1 = rect.y0, rect.y1
        if self.flip_y:
            y0, y1 = height - y1, height - y0
        return Rect(y0, x0, y1, x1) if self.transpose else Rect(x0, y0, x1, y1)


def orientation_of(matrix: Sequence[int] | None) -> tuple[Orientation, bool]:
    """Orientation of an FFmpeg display matrix (9 integers), and whether it is one exactly.
    x' = a x + c y, y' = b x + d y with a, b, c, d at 0, 1, 3, 4 (FFmpeg
    libavutil/display.h). A turn that is no multiple of 90 degrees is taken to the nearest
    one."""
    if matrix is None:
        return Orientation(), True
    a, b, c, d = (float(matrix[i]) for i in (0, 1, 3, 4))
    straight, turned = abs(a) + abs(d), abs(b) + abs(c)
    if straight == 0 and turned == 0:
        return Orientation(), False
    if straight >= turned:
        return Orientation(False, a < 0, d < 0), turned < 1e-3 * straight
    return Orientation(True, c < 0, b < 0), straight < 1e-3 * turned


@dataclass(frozen=True)
class FrameFormat:
    """What all frames of a clip share.

    width, height : coded px; chroma_location : left | center | topleft.
    """

    layout: PixelLayout
    width: int
    height: int
    time_base: Fraction
    matrix: str = "bt709"
    full_range: bool = False
    transfer: Transfer = SRGB
    chroma_location: str = "left"
    orientation: Orientation = field(default_factory=Orientation)

    @property
    def cosited(self) -> tuple[bool, bool]:
        """Whether chroma lies on the left, and on the top, luma sample of its group (else
        in the middle).
        """
        where = self.chroma_location
        return where in ("left", "topleft"), where == "topleft"

    @property
    def stored(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Of luma, grey or RGB samples, and of chroma: the value of 0, steps up to 1 (of chroma
        from -0.5 to 0.5), lowest and highest legal value.

        Source: ITU-R BT.601/709/2020."""
        up, peak = 1 << (self.layout.depth - 8), self.layout.peak
        if self.full_range:
            return (0, peak, 0, peak), (128 * up, peak, 0, peak)
        luma, chroma = (16, 219, 16, 235), (128, 224, 16, 240)
        return tuple(up * v for v in luma), tuple(up * v for v in chroma)
