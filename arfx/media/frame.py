"""One decoded picture: upright views of it, linear light of a rectangle, and edits written back into its planes.

Untouched pixels stay untouched: an edit adds the converted difference to the stored samples of its rectangle, so
every other sample, and every sample whose colour does not change, keeps its bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING

import av
import numpy as np

from arfx.core.colour import SRGB, Transfer, yuv_from_rgb
from arfx.core.rect import EMPTY, Rect
from arfx.errors import RenderError
from arfx.media.orient import Orientation
from arfx.media.planes import PixelLayout, chroma_size, copy_picture, planes_of

if TYPE_CHECKING:
    from arfx.media.lines import Chroma, Luma, Planes

LEAST_SPARSE = 3  # pixels of a rectangle for each that is wanted, from which these alone are converted
SWS_MATRIX = {"bt709": "ITU709", "bt601": "ITU601", "smpte240m": "SMPTE240M", "fcc": "FCC", "bt2020": "BT2020"}


@dataclass(frozen=True)
class FrameFormat:
    """What all frames of a clip share. width, height : coded px; chroma_location : left | center | topleft."""

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
        """Whether chroma lies on the left, and on the top, luma sample of its group (else in the middle)."""
        return self.chroma_location in ("left", "topleft"), self.chroma_location == "topleft"

    @property
    def luma_steps(self) -> tuple[float, float]:
        """(offset, steps from black to white) of stored luma, grey or RGB samples. Source: ITU-R BT.601/709/2020."""
        up = 1 << (self.layout.depth - 8)
        return (0.0, float(self.layout.peak)) if self.full_range else (16.0 * up, 219.0 * up)

    @property
    def chroma_steps(self) -> tuple[float, float]:
        """(value of no chroma, steps from -0.5 to 0.5)."""
        up = 1 << (self.layout.depth - 8)
        return 128.0 * up, float(self.layout.peak) if self.full_range else 224.0 * up

    @property
    def legal(self) -> tuple[int, int, int, int]:
        """Lowest and highest legal luma, lowest and highest legal chroma."""
        up = 1 << (self.layout.depth - 8)
        p = self.layout.peak
        return (0, p, 0, p) if self.full_range else (16 * up, 235 * up, 16 * up, 240 * up)


class Frame:
    """One picture; never changes. index : number in the reader's order;  pts : in `time_base` units;  key : key frame."""

    __slots__ = ("format", "index", "key", "picture", "pts")

    def __init__(self, picture: av.VideoFrame, form: FrameFormat, index: int, pts: int, key: bool = False) -> None:
        self.picture, self.format, self.index, self.pts, self.key = picture, form, index, pts, key

    @property
    def time_s(self) -> float:
        """Presentation time, seconds."""
        return float(self.pts * self.format.time_base)

    @property
    def rect(self) -> Rect:
        """The whole upright picture."""
        f = self.format
        return Rect.of(f.height, f.width) if f.orientation.transpose else Rect.of(f.width, f.height)

    def luma(self) -> np.ndarray:
        """(h, w) uint8, upright, read-only; limited range stays as stored; a view for 8-bit YUV and grey."""
        f = self.format
        if f.layout.kind == "rgb":
            y: np.ndarray = self.picture.reformat(format="gray").to_ndarray()
        else:
            y = planes_of(self.picture, f.layout)[0][:, : f.width]
            if f.layout.depth > 8:
                y = (y >> (f.layout.depth - 8)).astype(np.uint8)
        out = f.orientation.upright(y)
        out.setflags(write=False)
        return out

    def rgb8(self) -> np.ndarray:
        """(h, w, 3) uint8 R'G'B' of the whole upright picture, for looking at."""
        f = self.format
        full = 2 if f.full_range else 1
        shown = self.picture.reformat(
            format="rgb24", src_colorspace=SWS_MATRIX.get(f.matrix), src_color_range=full, dst_color_range=2,
        )  # fmt: skip
        return np.ascontiguousarray(f.orientation.upright(shown.to_ndarray()))

    def reduced(self, width: int) -> np.ndarray:
        """(h, w, 3) float32 linear RGB of the whole upright picture, at most `width` px wide; averaged in coded values."""
        f = self.format
        small = min(1.0, width / self.rect.width)
        shown = self.picture.reformat(
            max(round(f.width * small), 1), max(round(f.height * small), 1), "rgb24", interpolation="AREA",
            src_colorspace=SWS_MATRIX.get(f.matrix), src_color_range=2 if f.full_range else 1, dst_color_range=2,
        )  # fmt: skip
        coded = f.orientation.upright(shown.to_ndarray())
        return np.take(f.transfer.decode(np.arange(256) / 255).astype(np.float32), coded)

    def _coded(self, rect: Rect) -> Rect:
        if rect.empty or not self.rect.contains(rect):
            raise RenderError(f"frame {self.index}: rectangle {rect.to_json()} is not inside the picture {self.rect.to_json()}")
        return self.format.orientation.coded_rect(rect, self.rect.width, self.rect.height)

    def linear(self, rect: Rect) -> np.ndarray:
        """(h, w, 3) float32 linear RGB of an upright rectangle; not clipped, so slightly below 0 and above 1 occur.

        Any two rectangles agree where they meet. Raises RenderError if rect is empty or leaves the picture.
        """
        f, r = self.format, self._coded(rect)
        planes = planes_of(self.picture, f.layout)
        if f.layout.kind != "yuv":
            off, span = f.luma_steps
            table = f.transfer.decode((np.arange(f.layout.peak + 1) - off) / span).astype(np.float32)
            parts = [np.take(table, np.minimum(p[r.slices], f.layout.peak)) for p in planes[:3]]
            coded = np.stack([parts[2], parts[0], parts[1]] if f.layout.kind == "rgb" else parts * 3, -1)  # gbrp: G, B, R
            return np.ascontiguousarray(f.orientation.upright(coded))
        from arfx.media import kernels
        from arfx.media.curves import decode_curve

        coded = np.empty((r.height, r.width, 3), np.float32)
        kernels.linear_from_yuv(_stored(planes, f), (r.x0, r.y0, r.x1, r.y1), decode_curve(f.transfer), coded)
        return np.ascontiguousarray(f.orientation.upright(coded))

    def linear_at(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 3) float32: `linear` of single upright pixels (n, 2) int, x and y. Raises RenderError if one leaves the picture."""
        if not len(pixels):
            return np.zeros((0, 3), np.float32)
        x, y = pixels[:, 0], pixels[:, 1]
        rect = Rect(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
        f, coded = self.format, self._coded(rect)
        plain = f.layout.kind == "yuv" and f.orientation == Orientation()
        if not plain or coded.area < LEAST_SPARSE * len(pixels):
            return np.ascontiguousarray(self.linear(rect)[y - rect.y0, x - rect.x0])
        from arfx.media import kernels
        from arfx.media.curves import decode_curve

        planes = planes_of(self.picture, f.layout)
        out = np.empty((len(pixels), 3), np.float32)
        kernels.linear_at_yuv(_stored(planes, f), np.ascontiguousarray(pixels, np.int32), decode_curve(f.transfer), out)
        return out

    def dimmed(self, rect: Rect, left: np.ndarray, opacity: float, bias: np.ndarray, hole: Rect) -> Frame:
        """A new frame with less light inside `rect`, but for `hole`: of every linear value's part above `bias` (3,) a share
        1 + opacity (left - 1) is left.

        left : (h, w, 3 or 1) float32 over the upright `rect`; 1 keeps a pixel's bits. Errors and legal range as in `edited`.
        """
        f, r, h = self.format, self._coded(rect), self._coded(hole) if not hole.empty else EMPTY
        if left.shape[:2] != (rect.height, rect.width) or left.shape[2] not in (1, 3):
            raise RenderError(f"frame {self.index}: {left.shape} shares of light for {rect.to_json()}")
        if f.layout.kind != "yuv":
            before = self.linear(rect)
            after = before + np.float32(opacity) * (left - 1) * (before - bias.astype(np.float32))
            if not hole.empty:
                after[hole.slices_in(rect)] = before[hole.slices_in(rect)]
            return self.edited(rect, before, after)
        picture = copy_picture(self.picture, f.layout)
        whole = np.ascontiguousarray(f.orientation.coded(left), np.float32)
        _dim_yuv(planes_of(picture, f.layout), f, r, h, whole, opacity, bias)
        return Frame(picture, f, self.index, self.pts, self.key)

    @property
    def row_by_row(self) -> bool:
        """Whether `edited` takes `columns`."""
        return self.format.layout.kind == "yuv" and self.format.orientation == Orientation()

    def edited(
        self, rect: Rect, before: np.ndarray, after: np.ndarray, columns: np.ndarray | None = None, in_place: bool = False
    ) -> Frame:
        """A new frame whose stored samples differ by convert(after) - convert(before) inside `rect`.

        before, after : (h, w, 3) float32 linear RGB of the upright rectangle; equal pixels keep their bits.
        columns : (h, 2) int32 of each row, outside of which neither is looked at; None = all. Only where `row_by_row`
        in_place : this frame's own samples are changed; only for one that `dimmed` or `edited` made
        New values are clipped to the legal range; samples that already lay beyond it may stay there.
        Raises RenderError for a rectangle outside the picture, other shapes, or values that are not finite.
        """
        f, r = self.format, self._coded(rect)
        shape = (rect.height, rect.width, 3)
        if before.shape != shape or after.shape != shape:
            raise RenderError(f"frame {self.index}: edit of {shape} pixels given {before.shape} before, {after.shape} after")
        b = np.ascontiguousarray(f.orientation.coded(before), np.float32)
        a = np.ascontiguousarray(f.orientation.coded(after), np.float32)
        picture = self.picture if in_place else copy_picture(self.picture, f.layout)
        planes = planes_of(picture, f.layout)
        whole = np.tile(np.array([0, r.width], np.int32), (r.height, 1)) if columns is None else columns
        bad = _edit_yuv(planes, f, r, whole, b, a) if f.layout.kind == "yuv" else _edit_rgb(planes, f, r, b, a)
        if bad:
            raise RenderError(f"frame {self.index}: {bad} edited pixels in {rect.to_json()} are not finite numbers")
        return Frame(picture, f, self.index, self.pts, self.key)


@lru_cache(maxsize=8)
def _rgb_from_yuv(matrix: str) -> np.ndarray:
    return np.linalg.inv(yuv_from_rgb(matrix))


def _stored(planes: list[np.ndarray], f: FrameFormat) -> Planes:
    from arfx.media.lines import Planes

    to_rgb, (yo, yn), (co, cn) = _rgb_from_yuv(f.matrix), f.luma_steps, f.chroma_steps
    scale = np.float32(yo), np.float32(1 / yn), np.float32(co), np.float32(1 / cn)
    matrix = np.float32(to_rgb[0, 2]), np.float32(-to_rgb[1, 1]), np.float32(-to_rgb[1, 2]), np.float32(to_rgb[2, 1])
    y, u, v = planes[:3]
    return Planes(y, u, v, (f.layout.sub_x, f.layout.sub_y), f.cosited, chroma_size(f.layout, f.width, f.height), scale, matrix)


def _luma(f: FrameFormat) -> Luma:
    from arfx.media.lines import Luma

    return Luma(yuv_from_rgb(f.matrix).astype(np.float32), np.float32(f.luma_steps[1]), *f.legal[:2], f.width)


def _chroma(r: Rect, step: int) -> Chroma:
    from arfx.media.lines import Chroma

    lines = np.empty((2, r.height, -(-r.x1 >> step) - (r.x0 >> step)), np.float32)
    return Chroma(lines, np.empty((r.height, 2), np.int32))


def _edit_chroma(planes: list[np.ndarray], f: FrameFormat, r: Rect, chroma: Chroma) -> None:
    from arfx.media import kernels

    rect, steps = (r.x0, r.y0, r.x1, r.y1), (f.layout.sub_x, f.layout.sub_y)
    for plane, lines in zip(planes[1:3], chroma.lines, strict=True):
        factor = np.float32(f.chroma_steps[1])
        kernels.edit_chroma(plane, lines, chroma.reach, rect, f.height, steps, f.cosited[1], factor, f.legal[2:])


def _bits(array: np.ndarray) -> np.ndarray:
    """A contiguous array of 32 bits as int32, not to be written: whoever made it, it is one type to the compiler."""
    out = array.view(np.int32)
    out.flags.writeable = False
    return out


def _edit_yuv(
    planes: list[np.ndarray], f: FrameFormat, r: Rect, columns: np.ndarray, before: np.ndarray, after: np.ndarray
) -> int:
    from arfx.media import kernels
    from arfx.media.curves import encode_curve

    chroma = _chroma(r, f.layout.sub_x)
    bad = kernels.edit_luma(
        planes[0], (r.x0, r.y0, r.x1, r.y1), _bits(columns), _bits(before), _bits(after), encode_curve(f.transfer), _luma(f),
        f.layout.sub_x, f.cosited[0], chroma,
    )  # fmt: skip
    _edit_chroma(planes, f, r, chroma)
    return int(bad)


def _dim_yuv(
    planes: list[np.ndarray], f: FrameFormat, r: Rect, hole: Rect, left: np.ndarray, opacity: float, bias: np.ndarray
) -> None:
    from arfx.media.curves import decode_curve, encode_curve
    from arfx.media.dimming import dim_luma

    _, _, alpha, power = f.transfer.curve
    curves = decode_curve(f.transfer), encode_curve(f.transfer), np.array([1 / power, alpha - 1], np.float32)
    chroma = _chroma(r, f.layout.sub_x)
    dim_luma(
        _stored(planes, f), (r.x0, r.y0, r.x1, r.y1), (hole.x0, hole.y0, hole.x1, hole.y1), left, np.float32(opacity),
        bias.astype(np.float32) if bias.any() else None, curves, _luma(f), chroma,
    )  # fmt: skip
    _edit_chroma(planes, f, r, chroma)


def _edit_rgb(planes: list[np.ndarray], f: FrameFormat, r: Rect, before: np.ndarray, after: np.ndarray) -> int:
    finite = np.isfinite(before).all(-1) & np.isfinite(after).all(-1)
    if not finite.all():
        return int((~finite).sum())
    b = f.transfer.encode(before)
    a = f.transfer.encode(after)
    d = np.clip(a, np.minimum(b, 0), np.maximum(b, 1)) - b
    d = d @ yuv_from_rgb(f.matrix)[0][:, None] if f.layout.kind == "gray" else d[..., [1, 2, 0]]  # gbrp: G, B, R
    low, high = f.legal[:2]
    for c in range(d.shape[-1]):
        old = planes[c][r.slices].astype(np.int64)
        new = old + np.rint(d[..., c] * f.luma_steps[1]).astype(np.int64)
        planes[c][r.slices] = np.clip(new, np.minimum(old, low), np.maximum(old, high))
    return 0
