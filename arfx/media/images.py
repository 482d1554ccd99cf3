"""Single images: PNG with 8 or 16 bits, EXR with 32-bit floats.

OpenCV's wheels carry no OpenEXR, so EXR goes through FFmpeg's encoder and decoder, whose samples are exact.
"""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from arfx.core.colour import SRGB, Transfer
from arfx.core.opener import read_bytes
from arfx.errors import InputError, RenderError
from arfx.media.pictures import check_pixels, decode_picture


def write_png(path: Path, rgb: np.ndarray) -> None:
    """rgb : (h, w, 3) or (h, w) uint8 or uint16, R'G'B'. Raises RenderError when it cannot be written."""
    import cv2

    if rgb.dtype not in (np.uint8, np.uint16):
        raise RenderError(f"{path}: PNG holds 8 or 16 bits, not {rgb.dtype}")
    ok, data = cv2.imencode(".png", rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    if not ok:
        raise RenderError(f"{path}: the image cannot be encoded as PNG")
    _write(path, data.tobytes())


def write_exr(path: Path, linear: np.ndarray) -> None:
    """linear : (h, w, 3) or (h, w) float32, stored bit for bit. Raises RenderError when it cannot be written."""
    a = np.ascontiguousarray(linear, np.float32)
    fmt = "grayf32le" if a.ndim == 2 else "gbrpf32le"
    ctx = av.CodecContext.create("exr", "w")
    ctx.width, ctx.height, ctx.pix_fmt, ctx.time_base = a.shape[1], a.shape[0], fmt, Fraction(1, 25)
    ctx.options = {"compression": "zip16", "format": "float"}
    packets = ctx.encode(av.VideoFrame.from_ndarray(a, format=fmt)) + ctx.encode(None)
    _write(path, b"".join(bytes(p) for p in packets))


def load_image(path: Path, transfer: Transfer = SRGB) -> np.ndarray:
    """Linear float32 RGB (h, w, 3) of an image: EXR and Radiance HDR as stored, others through `transfer`.

    Raises InputError: missing, or not an image.
    """
    import cv2

    path = Path(path)
    if path.suffix.lower() == ".exr":
        a = read_exr(path, "image")
        return np.repeat(a[..., None], 3, -1) if a.ndim == 2 else np.ascontiguousarray(a[..., :3])
    raw = decode_picture(path, "image", cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    rgb = np.repeat(raw[..., None], 3, -1) if raw.ndim == 2 else raw[..., 2::-1]
    if rgb.dtype.kind == "f":
        return np.ascontiguousarray(rgb, np.float32)
    peak = (1 << 8 * rgb.dtype.itemsize) - 1
    return np.take(transfer.decode(np.linspace(0, 1, peak + 1)).astype(np.float32), rgb)


def read_exr(path: Path, kind: str) -> np.ndarray:
    """(h, w[, channels]) float32 as stored. Raises InputError."""
    data = read_bytes(path, kind)
    check_pixels(data, path, kind)
    try:
        with av.open(io.BytesIO(data), "r", format="exr_pipe") as c:
            return np.asarray(next(c.decode(video=0)).to_ndarray())
    except (av.error.FFmpegError, StopIteration, ValueError) as e:
        raise InputError(f"{kind} {path} cannot be read as an EXR image: {e}") from e


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as e:
        raise RenderError(f"{path} cannot be written: {e.strerror or e}", "is the disk full, or the folder read-only?") from e
