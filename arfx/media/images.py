"""Single pictures: PNG with 8 or 16 bits, EXR with 32-bit floats; and pictures from
outside, decoded by OpenCV.

OpenCV's wheels carry no OpenEXR, so EXR goes through FFmpeg's encoder and decoder, whose
samples are exact. From outside only formats are read that are listed here, recognised by
their content, and of a bounded size. The size is read from the header before anything is
decoded: a few kilobytes can state gigabytes."""

import contextlib
import importlib
import io
import re
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import cv2
import numpy as np
from numpy import ndarray
from PIL import Image, UnidentifiedImageError

from arfx.core.colour import SRGB
from arfx.core.opener import read_bytes, why
from arfx.errors import InputError, RenderError

# kind of picture, as in opener.LIMITS -> largest number of pixels
MAX_PIXELS = {
    "image": 1 << 25,  # 8192 x 4096, 400 MB in linear light
    "depth map": 1 << 25,  # 8192 x 4096, four times the largest video
    "pattern": 1 << 26,  # a page scanned at 600 dpi, twice over
    "picture": 1 << 28,  # a telephone's 200 megapixels, decoded grey
}
# longest side of a print's picture that is kept: twice what it is searched for with
PRINT_PX = 1024
_PILLOW = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "JPEG2000", "TIFF")
_HEIF = re.compile(rb".{4}ftyp(he(ic|ix|im|is|vc|vx)|m[is]f1)", re.DOTALL)
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_EXR = b"v/1\x01"
_WINDOWS = (b"dataWindow", b"displayWindow")  # FFmpeg makes a picture of the second
_DEPTH_CHANNELS = (b"Z", b"V", b"Y", b"R")
_HDR = re.compile(rb"\n\s*\n[-+][XY] (\d{1,9}) [-+][XY] (\d{1,9})\n")


def write_png(path: Path, rgb: ndarray) -> None:
    """rgb : (h, w, 3) or (h, w) uint8 or uint16, R'G'B'.

    Raises RenderError when it cannot be written.
    """
    _, data = cv2.imencode(".png", rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    _write(path, data.tobytes())


def write_exr(path: Path, linear: ndarray) -> None:
    """linear : (h, w, 3) or (h, w) float32, stored bit for bit.

    Raises RenderError when it cannot be written.
    """
    a = np.ascontiguousarray(linear, np.float32)
    fmt = "grayf32le" if a.ndim == 2 else "gbrpf32le"
    ctx = av.CodecContext.create("exr", "w")
    ctx.height, ctx.width = a.shape[:2]
    ctx.pix_fmt, ctx.time_base = fmt, Fraction(1, 25)
    ctx.options = {"compression": "zip16", "format": "float"}
    packets = ctx.encode(av.VideoFrame.from_ndarray(a, format=fmt)) + ctx.encode(None)
    _write(path, b"".join(bytes(p) for p in packets))


def load_image(path: Path) -> ndarray:
    """Linear float32 RGB (h, w, 3) of an image: EXR and Radiance HDR as stored, others as sRGB.
    Raises InputError: missing, or not an image."""
    raw = decode_picture(Path(path), "image", cv2.IMREAD_UNCHANGED)
    rgb = np.repeat(raw[..., None], 3, -1) if raw.ndim == 2 else raw[..., 2::-1]
    if rgb.dtype.kind == "f":
        return np.ascontiguousarray(rgb, np.float32)
    return _linear(rgb)


def _linear(coded: ndarray) -> ndarray:
    """float32 of whole numbers in sRGB."""
    values = np.linspace(0, 1, 1 << 8 * coded.dtype.itemsize)
    return np.take(SRGB.decode(values).astype(np.float32), coded)


def load_print(path: Path) -> tuple[ndarray, float]:
    """Linear float32 RGB (h, w, 3) of a print's picture, upright and at most PRINT_PX long;
    and its height over its width. Raises InputError: missing, or not an image."""
    rgb = decode_picture(Path(path), "pattern", cv2.IMREAD_COLOR)[..., ::-1]
    h, w = rgb.shape[:2]
    linear = _linear(rgb)
    if (small := PRINT_PX / max(h, w)) < 1:
        size = max(round(w * small), 1), max(round(h * small), 1)
        linear = cv2.resize(linear, size, interpolation=cv2.INTER_AREA)
    return linear, h / w


def _exr_header(data: bytes) -> dict[bytes, tuple[int, int]]:
    """By name where the value of an attribute begins, and its bytes.

    Raises ValueError, IndexError or struct.error where it is cut.
    """
    at, found = 8, {}
    while data[at]:
        name, kind = data[at : at + 512].split(b"\0", 2)[:2]
        at += len(name) + len(kind) + 6
        (size,) = struct.unpack_from("<i", data, at - 4)
        if size < 0:
            raise ValueError
        found[name] = at, size
        at += size
    return found


def _one_channel(data: bytes, path: Path) -> bytes:
    """A depth map's EXR with the channel that holds depth called Y, and no other that FFmpeg
    knows: Y is the only single one it reads. Raises InputError, and as `_exr_header`.
    """
    at, size = _exr_header(data)[b"channels"]
    end, ends = at + size, dict[bytes, int]()
    while at < end and data[at]:
        name = data[at:end].split(b"\0", 1)[0]
        ends[name] = at + len(name)
        at += len(name) + 17
    wanted = next((n for n in _DEPTH_CHANNELS if n in ends), None)
    if wanted is None:
        held = ", ".join(n.decode(errors="replace") for n in ends)
        what = f"depth map {path} holds the channels {held}, none of which is known as depth"
        raise InputError(what, "one called Z, V, Y or R")
    renamed = bytearray(data)
    for name, last in ends.items():
        renamed[last - 1] = ord("Y" if name == wanted else "_")
    return bytes(renamed)


def write_failed(path: Path, error: BaseException) -> RenderError:
    """One clear message for a write that failed: full disk, read-only folder, file limit."""
    reason = why(error)
    return RenderError(
        f"{path} cannot be written: {reason}",
        "is the disk full, or the folder read-only?",
    )


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as e:
        raise write_failed(path, e) from e


def decode_picture(path: Path, kind: str, flags: int) -> ndarray:
    """As cv2.imdecode; of a depth map in an EXR the channel that holds it.

    Raises InputError: not a file of that kind, too large, damaged."""
    data = read_bytes(path, kind)
    check_size(data, path, kind)
    try:
        if is_heif(data):
            grey = flags == cv2.IMREAD_GRAYSCALE
            with open_picture(data, path, kind) as picture:
                raw = np.asarray(picture.convert("L" if grey else "RGB"))
            return raw if grey else raw[..., ::-1]
        if data.startswith(_EXR) and flags == cv2.IMREAD_UNCHANGED:
            if kind == "depth map":
                data = _one_channel(data, path)
            (picture,) = av.CodecContext.create("exr", "r").decode(av.Packet(data))
            raw = picture.to_ndarray()
            return raw if raw.ndim == 2 else raw[..., 2::-1]
        decoded: ndarray | None = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        if decoded is None:
            raise ValueError
        return decoded
    except InputError:
        raise
    except Exception as e:  # whatever the readers of pictures stumble over
        what = "it is damaged, cut short, or of a variant that is not known"
        raise InputError(
            f"{kind} {path} cannot be read: {what}", "save it again"
        ) from e


def is_heif(data: bytes) -> bool:
    return _HEIF.match(data) is not None


def open_picture(data: bytes, path: Path, kind: str) -> Any:
    """Pillow's picture, which is not decoded yet.

    Raises InputError where it is HEIC and the plug-in for it absent, and what Pillow raises."""
    Image.MAX_IMAGE_PIXELS = None  # our own limits hold, of which it would warn
    formats: tuple[str, ...] = _PILLOW
    if is_heif(data):
        formats = ("HEIF",)
        try:
            importlib.import_module("pillow_heif").register_heif_opener()
        except ImportError:
            text = f"{kind} {path} is HEIC, which needs the package pillow-heif"
            hint = "pip install pillow-heif, or save it as JPEG"
            raise InputError(text, hint) from None
    return Image.open(io.BytesIO(data), formats=formats)


def exif_turn(path: Path) -> int:
    """EXIF's orientation of a picture that was decoded upright; 1 = as stored, also where
    none is stated.
    """
    try:
        with Image.open(path) as picture:
            turn = picture.info.get("original_orientation") or picture.getexif().get(
                0x0112, 1
            )
            return int(turn) if turn in range(1, 9) else 1
    except Exception:  # whatever its header holds: the pixels were read
        return 1


def _tiff_sizes(source: Path | io.BytesIO) -> list[tuple[int, int]]:
    import tifffile

    sizes: dict[int, tuple[int, int]] = {}
    # its pages alone: what its metadata names is not opened
    with tifffile.TiffFile(source) as file:
        for page in cast(list[Any], file.pages):
            if page.offset in sizes:
                raise ValueError  # it comes after itself: tifffile would go round for ever
            sizes[page.offset] = (page.imagewidth, page.imagelength)
    return list(sizes.values())


def check_size(source: bytes | Path, path: Path, kind: str) -> None:
    """Of every page of a picture, as the header states it; source : its bytes, or where a TIFF is
    that is too large for it.

    Raises InputError: damaged, or with more pixels than MAX_PIXELS[kind]."""
    pages: list[tuple[int, int]] = []
    try:
        if isinstance(source, Path):
            pages = _tiff_sizes(source)
        elif source.startswith(_TIFF):
            pages = _tiff_sizes(io.BytesIO(source))
        elif source.startswith(b"#?"):
            if found := _HDR.search(source[:65536]):
                pages = [(int(found[2]), int(found[1]))]
        elif source.startswith(_EXR):
            held = _exr_header(source)
            for name in sorted(held.keys() & _WINDOWS):
                x0, y0, x1, y1 = struct.unpack_from("<4i", source, held[name][0])
                pages.append((x1 - x0 + 1, y1 - y0 + 1))
        else:
            with (
                contextlib.suppress(UnidentifiedImageError),
                open_picture(source, path, kind) as picture,
            ):
                pages = [picture.size]
    except InputError:
        raise
    except Exception as e:  # whatever the readers of headers stumble over
        what = f"{kind} {path} cannot be read: its header is damaged"
        raise InputError(what, "save it again") from e
    if not pages:
        what = f"{kind} {path} is not a picture that can be read"
        raise InputError(what, f"{', '.join(_PILLOW)}, HDR or EXR")
    most = MAX_PIXELS[kind]
    for width, height in pages:
        if not 0 < width * height <= most:
            raise InputError(
                f"{kind} {path} is {width}x{height}",
                f"at most {most / 1e6:.0f} megapixels: scale it down",
            )
