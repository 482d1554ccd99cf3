"""A photo as a clip of one frame: read by its content, written with the colour profile and
EXIF of the one it was made of.
"""

import contextlib
import io
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import av
import numpy as np

from arfx.core.opener import ffmpeg_url, read_bytes
from arfx.errors import InputError
from arfx.media.images import decode_picture, is_heif, open_picture

WRITTEN = (".png", ".jpg", ".jpeg")  # endings of one picture as an output
_STILL = re.compile(
    rb"(\x89PNG\r\n\x1a\n|\xff\xd8\xff|II\*\0|MM\0\*)(?!.*acTL)|.{8}WEBP(?!.*ANIM)",
    re.DOTALL,
)
_ORIENTATION = 0x0112  # EXIF's tag
_TIFF_STORAGE = {
    *range(254, 267),
    273,
    *range(277, 282),
    284,
    *range(317, 350),
    34675,
}  # how a TIFF holds its pixels
_IHDR_END = 33  # bytes of a PNG up to the end of its first chunk
_JPEG_QUALITY = 95


def is_photo(path: Path) -> bool:
    """Whether a file is a JPEG, PNG, TIFF, WebP or HEIC picture; animated ones are videos,
    and no photos.
    """
    with path.open("rb") as f:
        head = f.read(4096)
    return _STILL.match(head) is not None or is_heif(head)


def open_photo(path: Path) -> Any:
    """A container in memory that holds the upright photo as its only frame, of 8 or 16 bits.

    Raises InputError.
    """
    import cv2

    bgr = decode_picture(path, "picture", cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if bgr.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"photo {path} holds {bgr.dtype} samples", "save it with 8 or 16 bits"
        )
    h, w = bgr.shape[:2]
    return av.open(
        io.BytesIO(np.moveaxis(bgr[..., [1, 0, 2]], -1, 0).tobytes()),
        format="rawvideo",
        options={
            "video_size": f"{w}x{h}",
            "pixel_format": "gbrp" if bgr.dtype == np.uint8 else "gbrp16le",
            "framerate": "65536",  # its clock
        },
    )


def write_photo(part: Path, chunk: Path, source: Path, suffix: str) -> None:
    """The only frame of a chunk as a picture. Raises OSError, av.error.FFmpegError.

    source : the photo whose colour profile and EXIF it gets;  suffix : of the kind, one of WRITTEN
    """
    import cv2
    from PIL import Image

    with av.open(ffmpeg_url(chunk)) as container:
        frame = next(container.decode(video=0))
        deep = suffix == ".png" and frame.format.components[0].bits > 8
        rgb = frame.to_ndarray(format="rgb48le" if deep else "rgb24")
    profile = exif = b""
    # whatever its header holds: the pixels were read
    with contextlib.suppress(Exception):
        data = read_bytes(source, "picture")
        with open_picture(data, source, "photo") as picture:
            tags = picture.getexif()
            if _ORIENTATION in tags:
                tags[_ORIENTATION] = 1
            for tag in tags.keys() & _TIFF_STORAGE:
                del tags[tag]
            profile = picture.info.get("icc_profile") or b""
            exif = tags.tobytes() if tags else b""
    if suffix == ".png":
        data = cv2.imencode(suffix, rgb[..., ::-1])[1].tobytes()
        chunks = b""
        if profile:
            chunks += _png_chunk(b"iCCP", b"icc\0\0" + zlib.compress(profile))
        if exif:
            chunks += _png_chunk(b"eXIf", exif.removeprefix(b"Exif\0\0"))
        part.write_bytes(data[:_IHDR_END] + chunks + data[_IHDR_END:])
        return
    Image.fromarray(rgb).save(
        part,
        "JPEG",
        quality=_JPEG_QUALITY,
        subsampling=0,
        icc_profile=profile or None,
        exif=exif,
    )


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    return (
        struct.pack(">I", len(content))
        + kind
        + content
        + struct.pack(">I", zlib.crc32(kind + content))
    )
