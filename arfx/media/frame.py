"""One decoded picture: upright views of it, linear light of a rectangle, and edits written
back into its planes.

Untouched pixels stay untouched: an edit adds the converted difference to the stored samples
of its rectangle, so every other sample, and every sample whose colour does not change,
keeps its bits."""

from __future__ import annotations

import av
import numpy as np

from arfx.core.colour import yuv_from_rgb
from arfx.core.rect import EMPTY, Rect
from arfx.errors import RenderError
from arfx.media.planes import FrameFormat, Orientation, copy_picture, planes_of

MIN_SPARSE_RATIO = (
    3  # pixels of a rectangle for each that is wanted, from which these alone are converted
)
SWS_MATRIX = {
    "bt709": "ITU709",
    "bt601": "ITU601",
    "smpte240m": "SMPTE240M",
    "fcc": "FCC",
    "bt2020": "BT2020",
}


class Frame:
    """One picture; never changes.

    index : number in the reader's order;  pts : in `time_base` units;  key : key frame.
    """

    __slots__ = ("format", "index", "key", "picture", "pts")

    def __init__(
        self,
        picture: av.VideoFrame,
        form: FrameFormat,
        index: int,
        pts: int,
        key: bool = False,
    ) -> None:
        self.picture, self.format, self.index, self.pts, self.key = (
            picture,
            form,
            index,
            pts,
            key,
        )

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
        f = self.format
        full = 2 if f.full_range else 1
        shown = self.picture.reformat(
            format="rgb24",
            src_colorspace=SWS_MATRIX.get(f.matrix),
            src_color_range=full,
            dst_color_range=2,
        )
        return np.ascontiguousarray(f.orientation.upright(shown.to_ndarray()))

    def reduced(self, width: int) -> np.ndarray:
        """(h, w, 3) float32 linear RGB of the whole upright picture, at most `width` px
        wide; averaged in coded values.
        """
        f = self.format
        small = min(1.0, width / self.rect.width)
        shown = self.picture.reformat(
            max(round(f.width * small), 1),
            max(round(f.height * small), 1),
            "rgb24",
            interpolation="AREA",
            src_colorspace=SWS_MATRIX.get(f.matrix),
            src_color_range=2 if f.full_range else 1,
            dst_color_range=2,
        )
        coded = f.orientation.upright(shown.to_ndarray())
        return np.take(f.transfer.decode(np.arange(256) / 255).astype(np.float32), coded)

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
        f, r = self.format, self._coded(rect)
        planes = planes_of(self.picture, f.layout)
        if f.layout.kind != "yuv":
            off, span = f.luma_steps
            table = f.transfer.decode((np.arange(f.layout.peak + 1) - off) / span).astype(
                np.float32
            )
            parts = [
                np.take(table, np.minimum(p[r.slices], f.layout.peak)) for p in planes[:3]
            ]
            coded = np.stack(
                [parts[2], parts[0], parts[1]] if f.layout.kind == "rgb" else parts * 3, -1
            )  # gbrp: G, B, R
            return np.ascontiguousarray(f.orientation.upright(coded))
        from arfx.media import kernels

        return np.ascontiguousarray(f.orientation.upright(kernels.read_yuv(planes, f, r)))

    def linear_at(self, pixels: np.ndarray) -> np.ndarray:
        """(n, 3) float32: `linear` of single upright pixels (n, 2) int, x and y.

        Raises RenderError if one leaves the picture.
        """
        if not len(pixels):
            return np.zeros((0, 3), np.float32)
        x, y = pixels[:, 0], pixels[:, 1]
        rect = Rect(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
        f, coded = self.format, self._coded(rect)
        plain = f.layout.kind == "yuv" and f.orientation == Orientation()
        if not plain or coded.area < MIN_SPARSE_RATIO * len(pixels):
            return np.ascontiguousarray(self.linear(rect)[y - rect.y0, x - rect.x0])
        from arfx.media import kernels

        return kernels.read_yuv_at(planes_of(self.picture, f.layout), f, pixels)

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
        f, r, h = (
            self.format,
            self._coded(rect),
            self._coded(hole) if not hole.empty else EMPTY,
        )
        if transmittance.shape[:2] != (rect.height, rect.width) or transmittance.shape[
            2
        ] not in (1, 3):
            raise RenderError(
                f"frame {self.index}: {transmittance.shape} shares of light for"
                f" {rect.to_json()}"
            )
        if f.layout.kind != "yuv":
            before = self.linear(rect)
            after = before + np.float32(opacity) * (transmittance - 1) * (
                before - bias.astype(np.float32)
            )
            if not hole.empty:
                after[hole.slices_in(rect)] = before[hole.slices_in(rect)]
            return self.edited(rect, before, after)
        from arfx.media import kernels

        picture = copy_picture(self.picture, f.layout)
        whole = np.ascontiguousarray(f.orientation.coded(transmittance), np.float32)
        kernels.dim_yuv(planes_of(picture, f.layout), f, r, h, whole, opacity, bias)
        return Frame(picture, f, self.index, self.pts, self.key)

    @property
    def row_by_row(self) -> bool:
        """Whether `edited` takes `columns`."""
        return self.format.layout.kind == "yuv" and self.format.orientation == Orientation()

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
        b = np.ascontiguousarray(f.orientation.coded(before), np.float32)
        a = np.ascontiguousarray(f.orientation.coded(after), np.float32)
        picture = self.picture if in_place else copy_picture(self.picture, f.layout)
        planes = planes_of(picture, f.layout)
        if f.layout.kind == "yuv":
            from arfx.media import kernels

            bad = kernels.edit_yuv(planes, f, r, columns, b, a)
        else:
            bad = _edit_rgb(planes, f, r, b, a)
        if bad:
            raise RenderError(
                f"frame {self.index}: {bad} edited pixels in {rect.to_json()} are not"
                " finite numbers"
            )
        return Frame(picture, f, self.index, self.pts, self.key)


def _edit_rgb(
    planes: list[np.ndarray], f: FrameFormat, r: Rect, before: np.ndarray, after: np.ndarray
) -> int:
    finite = np.isfinite(before).all(-1) & np.isfinite(after).all(-1)
    if not finite.all():
        return int((~finite).sum())
    b = f.transfer.encode(before)
    a = f.transfer.encode(after)
    d = np.clip(a, np.minimum(b, 0), np.maximum(b, 1)) - b
    d = (
        d @ yuv_from_rgb(f.matrix)[0][:, None]
        if f.layout.kind == "gray"
        else d[..., [1, 2, 0]]
    )  # gbrp: G, B, R
    low, high = f.legal[:2]
    for c in range(d.shape[-1]):
        old = planes[c][r.slices].astype(np.int64)
        new = old + np.rint(d[..., c] * f.luma_steps[1]).astype(np.int64)
        planes[c][r.slices] = np.clip(new, np.minimum(old, low), np.maximum(old, high))
    return 0
