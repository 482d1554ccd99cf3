"""Video files opened by FFmpeg: ours for writing, others' only as the containers listed
here, and never anything they name; and what the supported codecs and containers can
hold."""

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import av
from av.codec.codec import find_best_pix_fmt_of_list

from arfx.core.machine import preserve_scheduling
from arfx.core.opener import ffmpeg_url, regular, why
from arfx.errors import InputError
from arfx.media.photos import is_photo, open_photo
from arfx.media.planes import PixelLayout, layout_named

os.environ.setdefault(
    "SVT_LOG", "1"
)  # errors only: the AV1 encoder prints its settings otherwise

# FFmpeg detects the format from the content. Its playlists, scripts and image patterns
# (concat, hls, dash, sdp, image2, …) open other files and addresses, so that formats are
# listed which hold their streams themselves.
CONTAINERS = (
    "mov,matroska,webm,avi,mpegts,mpeg,flv,ogg,asf,nut,ivf,mxf,gxf,dv,wtv,yuv4mpegpipe,gif,"
    "apng,wav,h264,hevc,vvc,av1,obu,mpegvideo,m4v,mjpeg"
)
_OPTIONS = {"format_whitelist": CONTAINERS, "protocol_whitelist": "file"}
MAX_SIDE = 8192  # of a frame: a picture of this square in linear light takes 800 MB
_PICTURE = re.compile(
    rb"\x89PNG|\xff\xd8\xff|II[*+]\0|MM\0[*+]|BM|v/1\x01|#\?RADIANCE|\0\0\0\x0cjP  |P[56]\n"
    rb"|8BPS|%!PS|.{8}WEBP",
    re.DOTALL,
)


@dataclass(frozen=True)
class Codec:
    """One output codec. encoder : FFmpeg's name;  containers : best first;  chunk :
    container of its chunks
    options : fixed ones;  crf, preset : defaults, None where there is no such setting;
    threads : given to the encoder
    full_range : whether full-range samples can be distinguished from limited ones in its
    files;  fields : and interlaced pictures
    from others"""

    name: str
    encoder: str
    containers: Sequence[str] = ()
    chunk: str = ".nut"
    options: Mapping[str, str] = field(default_factory=dict)
    threads: int = 2
    crf: float | None = None
    preset: str | None = None
    full_range: bool = True
    lossless: bool = False
    sequence: bool = False
    fields: bool = True

    @cached_property
    def formats(self) -> tuple[PixelLayout, ...]:
        """Working pixel formats that its encoder takes (planar YUV, grey, RGB; without
        transparency).
        """
        if self.encoder == "prores_ks":
            names = ["yuv444p10le"]  # profile 4 is ProRes 4444
        else:
            names = [f.name for f in av.Codec(self.encoder, "w").video_formats or []]
        if self.encoder == "ffv1":
            names.append("gbrp")  # its 8-bit RGB is bgr0: the same, interleaved
        known = [f for n in names if (f := layout_named(n)) and not f.alpha]
        return tuple(f for f in known if f.name == f.plain_name)


TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
CODECS = {name: Codec(name, **fields) for name, fields in TABLES["codecs"].items()}
ALIASES: dict[str, str] = TABLES["aliases"]
SUFFIX_CONTAINER: dict[str, str] = TABLES["containers"]
CONTAINER_SUFFIX = {name: suffix for suffix, name in SUFFIX_CONTAINER.items()}
CLIP_SUFFIXES = frozenset[str](TABLES["clip_suffixes"])


def open_encoder(context: Any) -> None:
    """Open an encoder whose settings are complete. Raises av.error.FFmpegError, ValueError.
    As root, the AV1 encoder makes its threads and its caller real-time when it opens: the
    rest of the machine waits for them."""
    with preserve_scheduling():
        context.open()


@cache
def supported_codecs(container: str) -> frozenset[str]:
    """Names of the codecs that a container can hold, decoders' and encoders' names alike."""
    with av.open(os.devnull, "w", format=container) as out:
        return frozenset(out.supported_codecs)


def nearest_format(
    layout: PixelLayout, codec: Codec, odd: tuple[int, int]
) -> PixelLayout | None:
    """The codec's format that loses least of a source layout, as FFmpeg reckons it; None if
    none holds the picture's size.
    odd : 1 where the coded width, height are odd"""
    able = {f.name: f for f in codec.formats if codec.lossless or f.holds(odd)}
    best, _ = find_best_pix_fmt_of_list(list(able), layout.plain_name)
    return None if best is None else able[best.name]


def open_video(path: Path) -> Any:
    """A container for reading; a photo is a clip of one frame.
    Raises InputError: not a regular file, not a video, or a list of other files (playlist,
    concat script)."""
    regular(path, "clip")
    if is_photo(path):
        return open_photo(path)
    try:
        return av.open(
            ffmpeg_url(path), metadata_errors="replace", container_options=_OPTIONS
        )
    except (av.error.FFmpegError, OSError, ValueError) as e:
        reason, hint = _diagnose(path)
        if not reason and isinstance(
            e, av.error.ArgumentError
        ):  # the list of formats
            reason = "it is of a format that is not read"
            hint = "convert it to .mp4 or .mkv"
        raise InputError(
            f"clip {path} cannot be read as a video: {reason or why(e)}",
            hint
            or "a file that FFmpeg can decode; a recording that was cut off before its index"
            " was written may be repairable",
        ) from e


def check_size(width: int, height: int, path: Path) -> None:
    """Raises InputError for pictures too large to work on."""
    if max(width, height) > MAX_SIDE:
        raise InputError(
            f"clip {path} has pictures of {width}x{height}",
            f"at most {MAX_SIDE} px a side: scale it down",
        )


def create_container(path: Path, container: str | None = None, **options: Any) -> Any:
    """A container for writing.

    container : FFmpeg's name, None = by the suffix;  options : of av.open
    """
    return av.open(ffmpeg_url(path), "w", format=container, **options)


def _diagnose(path: Path) -> tuple[str, str]:
    """What a file is that is no video, and what would be right; empty where its first bytes
    do not tell.
    """
    with path.open("rb") as f:
        head = f.read(1024)
    if not head:
        return "it is empty", "is the recording complete?"
    if _PICTURE.match(head):
        return "it is a picture of a kind that is not read", "save it as PNG or JPEG"
    if all(b >= 32 or b in b"\t\r\n\f" for b in head.removeprefix(b"\xef\xbb\xbf")):
        return (
            "it is text, not a video",
            "a playlist or script is not followed: join what it names into one file",
        )
    return "", ""
