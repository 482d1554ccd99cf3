"""One decoded picture: upright views of it, linear light of a rectangle, and edits written
back into its planes.

Untouched pixels stay untouched: an edit adds the converted difference to the stored samples
of its rectangle, so every other sample, and every sample whose colour does not change,
keeps its bits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import av
import numpy as np
from numpy import ndarray

from arfx.core.layers import packed
from arfx.core.rect import Rect
from arfx.errors import RenderError
from arfx.media.planes import FrameFormat, copy_picture, planes_of

SWS_MATRIX = {
    "bt709": "ITU709",
    "bt601": "ITU601",
    "smpte240m": "SMPTE240M",
    "fcc": "FCC",
    "bt2020": "BT2020",
}


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture; never changes.

    index : number in the reader's order;  pts : in `time_base` units;  key : key frame.
    """

    picture: av.VideoFrame
    format: FrameFormat
    index: int
    pts: int
    key: bool = False

    @property
    def time_s(self) -> float:
        """Presentation time, seconds."""
        return float(self.pts * self.format.time_base)

    @property
    def rect(self) -> Rect:
        """The whole upright picture."""
        f = self.format
        return (
            Rect.of(f.height, f.width)
            if f.orientation.transpose
            else Rect.of(f.width, f.height)
        )

    def luma(self) -> ndarray:
        """(h, w) uint8, upright, read-only; limited range stays as stored; a view for 8-bit
        YUV and grey.
        """
        f = self.format
        if f.layout.kind == "rgb":
            y: ndarray = self.picture.reformat(format="gray").to_ndarray()
        else:
            y = planes_of(self.picture, f.layout)[0][:, : f.width]
            if f.layout.depth > 8:
                y = (y >> (f.layout.depth - 8)).astype(np.uint8)
        out = f.orientation.upright(y)
        out.setflags(write=False)
        return out

    def rgb8(self, **how: Any) -> ndarray:
        """(h, w, 3) uint8 R'G'B' of the whole upright picture, for looking at.

        how : as of `reformat`"""
        f = self.format
        shown = self.picture.reformat(
            format="rgb24",
            src_colorspace=SWS_MATRIX.get(f.matrix),
            src_color_range=2 if f.full_range else 1,
            dst_color_range=2,
            **how,
        )
        return np.ascontiguousarray(f.orientation.upright(shown.to_ndarray()))

    def reduced(self, width: int) -> ndarray:
        """(h, w, 3) float32 linear RGB of the whole upright picture, at most `width` px
        wide; averaged in coded values.
        """
        f, small = self.format, min(1.0, width / self.rect.width)
        width, height = (max(round(side * small), 1) for side in (f.width, f.height))
        return np.take(
            f.transfer.decode(np.arange(256) / 255).astype(np.float32),
            self.rgb8(width=width, height=height, interpolation="AREA"),
        )

    def _coded(self, rect: Rect) -> tuple[int, ...]:
        if rect.empty or not self.rect.contains(rect):
            raise RenderError(
                f"frame {self.index}: rectangle {[*rect]} is not inside the picture"
                f" {[*self.rect]}"
            )
        shown = self.rect
        turn = self.format.orientation
        return turn.coded_rect(rect, shown.width, shown.height)[:]

    def linear(self, rect: Rect, out: ndarray | None = None) -> ndarray:
        """(h, w, 3) float32 linear RGB of an upright rectangle; not clipped, so slightly
        below 0 and above 1 occur. Any two rectangles agree where they meet. Raises
        RenderError if rect is empty or leaves the picture.

        out : to write it to, None = a new array"""
        from arfx.media import samples  # whose compiler takes long to load

        f, r = self.format, self._coded(rect)
        s = samples.samples_of(f)
        if out is None:
            out = np.empty((rect.height, rect.width, 3), np.float32)
        coded = f.orientation.coded(out)
        into = (
            coded if coded.flags.c_contiguous else np.empty(coded.shape, np.float32)
        )
        planes = samples.three(planes_of(self.picture, f.layout))
        samples.read(s, planes, r, samples.scratch_for(s, r), into)
        if into is not coded:
            coded[...] = into
        return out

    def edited(self, rect: Rect, before: ndarray, after: ndarray) -> Frame:
        """A new frame whose stored samples differ by convert(after) - convert(before)
        inside `rect`.

        before : (h, w, 3) float32, `linear` of the upright rectangle;  after : what it is
        to become; where they are equal the samples keep their bits
        New values are clipped to the legal range; samples that already lay beyond it may
        stay there. Raises RenderError for a rectangle outside the picture, other shapes, or
        values that are not finite."""
        from arfx.media import samples

        f, r = self.format, self._coded(rect)
        s = samples.samples_of(f)
        shape = (rect.height, rect.width, 3)
        if before.shape != shape or after.shape != shape:
            raise RenderError(
                f"frame {self.index}: edit of {shape} pixels given {before.shape} before,"
                f" {after.shape} after"
            )
        picture = copy_picture(self.picture, f.layout)
        old, new = (
            samples.three(planes_of(p, f.layout)) for p in (self.picture, picture)
        )
        light = (packed(f.orientation.coded(x)) for x in (before, after))
        if not samples.add(s, old, new, r, *light, samples.scratch_for(s, r)):
            bad = np.count_nonzero(~np.isfinite(after).all(-1))
            raise RenderError(
                f"frame {self.index}: {bad} edited pixels in {[*rect]} are not"
                " finite numbers"
            )
        return replace(self, picture=picture)
