"""Video files opened by FFmpeg: ours for writing, others' only as the containers listed here, and never anything they name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av

from arfx.core.opener import av_name, regular
from arfx.errors import InputError

# FFmpeg tells the format from the content. Its playlists, scripts and image patterns (concat, hls, dash, sdp, image2, …) open
# other files and addresses, so that formats are listed which hold their streams themselves.
CONTAINERS = (
    "mov", "matroska", "webm", "avi", "mpegts", "mpeg", "flv", "ogg", "asf", "nut", "ivf", "mxf", "gxf", "dv", "wtv",
    "yuv4mpegpipe", "gif", "apng", "wav", "h264", "hevc", "vvc", "av1", "obu", "mpegvideo", "m4v", "mjpeg",
)  # fmt: skip
_ONLY = {"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"}
MAX_SIDE = 8192  # of a frame: a picture of this square in linear light takes 800 MB
_PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"BM", b"v/1\x01", b"#?RADIANCE",
             b"\0\0\0\x0cjP  ", b"P5\n", b"P6\n", b"8BPS", b"%!PS")  # fmt: skip


def open_video(path: Path, kind: str = "clip") -> Any:
    """A container for reading. kind : as in opener.LIMITS

    Raises InputError: not a regular file, not a video, or a list of other files (playlist, concat script).
    """
    regular(path, kind)
    try:
        return av.open(av_name(path), metadata_errors="replace", container_options=_ONLY)
    except (av.error.FFmpegError, OSError, ValueError) as e:
        why, hint = _refusal(path)
        if not why and isinstance(e, av.error.ArgumentError):  # the list of formats said no
            why, hint = "it is of a format that is not read", "convert it to .mp4 or .mkv"
        raise InputError(
            f"{kind} {path} cannot be read as a video: {why or getattr(e, 'strerror', None) or e}",
            hint or "a file that FFmpeg can decode; a recording that was cut off before its index was written may be repairable",
        ) from e


def check_size(width: int, height: int, path: Path, kind: str = "clip") -> None:
    """Raises InputError for pictures too large to work on."""
    if max(width, height) > MAX_SIDE:
        raise InputError(f"{kind} {path} has pictures of {width}x{height}", f"at most {MAX_SIDE} px a side: scale it down")


def create(path: Path, container: str | None = None, **options: Any) -> Any:
    """A container for writing. container : FFmpeg's name, None = by the suffix;  options : of av.open"""
    return av.open(av_name(path), "w", format=container, **options)


def _refusal(path: Path) -> tuple[str, str]:
    """What a file is that is no video, and what would be right; empty where its first bytes do not tell."""
    with path.open("rb") as f:
        head = f.read(1024)
    if not head:
        return "it is empty", "is the recording complete?"
    if head.startswith(_PICTURES) or head[8:12] == b"WEBP":
        return "it is a picture, not a video", "a clip of several frames; make one of pictures with FFmpeg"
    if all(b >= 32 or b in b"\t\r\n\f" for b in head.removeprefix(b"\xef\xbb\xbf")):
        return "it is text, not a video", "a playlist or script is not followed: join what it names into one file"
    return "", ""
