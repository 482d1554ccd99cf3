"""One decoded picture: upright views of it, linear light of a rectangle, and edits written
back into its planes.

Untouched pixels stay untouched: an edit adds the converted difference to the stored samples
of its rectangle, so every other sample, and every sample whose colour does not change,
keeps its bits."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any

import av
import numpy as np

from arfx.core.rect import EMPTY, Rect
from arfx.errors import RenderError
from arfx.media.planes import FrameFormat, Orientation, copy_picture, planes_of

# pixels of a rectangle for each that is wanted, from which these alone are converted
MIN_SPARSE_RATIO = 8
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

    def luma(self) -> np.ndarray:
        """(h, w) uint8, upright, read-only; limited range stays as stored; a view for 8-bit
        YUV and grey.
        """
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
        return np.ascontiguousarray(self._rgb24())

    def reduced(self, width: int) -> np.ndarray:
        """(h, w, 3) float32 linear RGB of the whole upright picture, at most `width` px
        wide; averaged in coded values.
        """
        f, small = self.format, min(1.0, width / self.rect.width)
        width, height = (max(round(side * small), 1) for side in (f.width, f.height))
        coded = self._rgb24(width=width, height=height, interpolation="AREA")
        return np.take(f.transfer.decode(np.arange(256) / 255).astype(np.float32), coded)

    def _rgb24(self, **how: Any) -> np.ndarray:
        """The whole upright picture. how : as of `reformat`"""
        f = self.format
        shown = self.picture.reformat(
            format="rgb24",
            src_colorspace=SWS_MATRIX.get(f.matrix),
            src_color_range=2 if f.full_range else 1,
            dst_color_range=2,
            **how,
        )
        return f.orientation.upright(shown.to_ndarray())

    def _coded(self, rect: Rect) -> Rect:
        if rect.empty or not self.rect.contains(rect):
            raise RenderError(
                f"frame {self.index}: rectangle {rect.to_json()} is not inside the picture"
                f" {self.rect.to_json()}"
            )
        return self.format.orientation.coded_rect(rect, self.rect.width, self.rect.height)

    def linear(self, rect: Rect) -> np.ndarray:
        """(h, w, 3) float32 linear RGB of an upright rectangle; not clipped, so slightly
        below 0 and above 1 occur. Any two rectangles agree where they meet. Raises
        RenderError if rect is empty or leaves the picture."""
        r, (kernels, planes) = self._coded(rect), self._stored(self.picture)
        out = np.empty((r.height, r.width, 3), np.float32)
        kernels.read(planes, astuple(r), out)
        return np.ascontiguousarray(self.format.orientation.upright(out))

    def linear_at(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 3) float32: `linear` of single upright pixels (n, 2) int, x and y.

        Raises RenderError if one leaves the picture.
        """
        if not len(pixels):
            return np.zeros((0, 3), np.float32)
        x, y = pixels[:, 0], pixels[:, 1]
        rect = Rect(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
        if not self.row_by_row or self._coded(rect).area < MIN_SPARSE_RATIO * len(pixels):
            return np.ascontiguousarray(self.linear(rect)[y - rect.y0, x - rect.x0])
        out = np.empty((len(pixels), 3), np.float32)
        kernels, planes = self._stored(self.picture)
        kernels.read_at(planes, np.ascontiguousarray(pixels, np.int32), out)
        return out

    def _stored(self, picture: av.VideoFrame) -> Any:
        from arfx.media import kernels  # whose compiler takes long to load

        planes = planes_of(picture, self.format.layout)
        return kernels, kernels.stored(planes, self.format)

    def dimmed(
        self,
        rect: Rect,
        transmittance: np.ndarray,
        opacity: float,
        bias: np.ndarray,
        hole: Rect,
    ) -> Frame:
        """A new frame with less light inside `rect`, but for `hole`: every linear value's
        part above `bias` (3,) is multiplied by 1 + opacity (transmittance - 1).
        transmittance : (h, w, 3 or 1) float32 over the upright `rect`; 1 keeps a pixel's
        bits. Errors, range: see `edited`.
        """
        f, r = self.format, self._coded(rect)
        h = EMPTY if hole.empty else self._coded(hole)
        if transmittance.shape[:2] != (rect.height, rect.width) or transmittance.shape[
            2
        ] not in (1, 3):
            raise RenderError(
                f"frame {self.index}: {transmittance.shape} shares of light for"
                f" {rect.to_json()}"
            )
        picture = copy_picture(self.picture, f.layout)
        kernels, planes = self._stored(picture)
        kernels.dim(
            planes,
            astuple(r),
            astuple(h),
            kernels.read_only(f.orientation.coded(transmittance)),
            np.float32(opacity),
            bias.astype(np.float32),
        )
        return replace(self, picture=picture)

    @property
    def row_by_row(self) -> bool:
        """Whether `edited` takes `columns`."""
        return self.format.orientation == Orientation()

    def edited(
        self,
        rect: Rect,
        before: np.ndarray,
        after: np.ndarray,
        columns: np.ndarray | None = None,
        in_place: bool = False,
    ) -> Frame:
        """A new frame whose stored samples differ by convert(after) - convert(before)
        inside `rect`.

        before, after : (h, w, 3) float32 linear RGB of the upright rectangle; equal pixels
        keep their bits.
        columns : (h, 2) int32 of each row, outside of which neither is looked at; None =
        all. Only where `row_by_row`
        in_place : this frame's own samples are changed; only for one that `dimmed` or `edited` made
        New values are clipped to the legal range; samples that already lay beyond it may
        stay there. Raises RenderError for a rectangle outside the picture, other shapes, or
        values that are not finite."""
        f, r = self.format, self._coded(rect)
        shape = (rect.height, rect.width, 3)
        if before.shape != shape or after.shape != shape:
            raise RenderError(
                f"frame {self.index}: edit of {shape} pixels given {before.shape} before,"
                f" {after.shape} after"
            )
        picture = self.picture if in_place else copy_picture(self.picture, f.layout)
        if columns is None:
            columns = np.tile(np.array([0, r.width], np.int32), (r.height, 1))
        kernels, planes = self._stored(picture)
        light = (kernels.read_only(f.orientation.coded(x)) for x in (before, after))
        if bad := kernels.edit(planes, astuple(r), columns, *light):
            raise RenderError(
                f"frame {self.index}: {bad} edited pixels in {rect.to_json()} are not"
                " finite numbers"
            )
        return replace(self, picture=picture)
