"""HDR video: its transfer functions, and the static data that a clip carries beside them.

Sources: ITU-T H.273 (tags), SMPTE ST 2086 (mastering display), CTA-861.3 (content light)."""

import struct
from collections.abc import Mapping
from typing import Any

import av

from arfx.core.colour import HLG, PQ, Transfer

Options = tuple[tuple[str, str], ...]  # of an encoder
TRANSFERS = {16: Transfer(PQ), 18: Transfer(HLG)}  # by their number, H.273 table 3
# What changes from scene to scene, and is of the picture before it was changed
_DYNAMIC = {"DOVI_METADATA": "Dolby Vision", "DYNAMIC_HDR_PLUS": "HDR10+"}
# By codec: the encoder's option, its two keys, and their units in 1 and in cd/m2. x265 counts
# as H.265 does, in .00002 and .0001 cd/m2.
_OPTIONS = {
    "h265": ("x265-params", "master-display", "max-cll", 50000, 10000),
    "av1": ("svtav1-params", "mastering-display", "content-light", 1, 1),
}


def side_data(picture: av.VideoFrame) -> dict[str, bytes]:
    """What a picture carries, by FFmpeg's name of its type."""
    try:
        sides: list[Any] = list(picture.side_data)
    except (
        ValueError
    ):  # PyAV lists none where it does not know the type of one, as of EXIF
        return {}
    return {s.type.name: bytes(s) for s in sides}


def left_out(beside: Mapping[str, bytes]) -> list[str]:
    """Notices of what is not kept."""
    return [
        f"the clip's {name} metadata is left out; its picture, colour tags and static HDR"
        " data are kept"
        for kind, name in _DYNAMIC.items()
        if kind in beside
    ]


def mastering_display(beside: Mapping[str, bytes]) -> tuple[float, ...] | None:
    """Of FFmpeg's ten fractions and two flags (libavutil/mastering_display_metadata.h)."""
    data = beside.get("MASTERING_DISPLAY_METADATA", b"")
    if len(data) < 88:
        return None
    *numbers, primaries, luminance = struct.unpack("=22i", data[:88])
    pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
    if not (primaries and luminance and all(below for _, below in pairs)):
        return None
    return tuple(above / below for above, below in pairs)


def content_light(beside: Mapping[str, bytes]) -> tuple[int, int] | None:
    data = beside.get("CONTENT_LIGHT_LEVEL", b"")
    return struct.unpack("=2I", data[:8]) if len(data) >= 8 else None


def with_static_data(
    options: Options,
    codec: str,
    display: tuple[float, ...] | None,
    light: tuple[int, int] | None,
    notices: list[str],
) -> Options:
    """An encoder's options, with what makes it write these; a notice where it cannot.

    display, light : as of `mastering_display` and `content_light`"""
    if display is None and light is None:
        return options
    if codec not in _OPTIONS:
        notices.append(
            f"{codec} files do not keep the clip's mastering display and light level"
        )
        return options
    name, of_display, of_light, units, units_cd_m2 = _OPTIONS[codec]
    said = []
    if display is not None:
        numbers = [f"{units * x:.10g}" for x in display[:8]]
        red, green, blue, white = (
            ",".join(numbers[k : k + 2]) for k in range(0, 8, 2)
        )
        least, most = (f"{units_cd_m2 * x:.10g}" for x in display[8:])
        said.append(
            f"{of_display}=G({green})B({blue})R({red})WP({white})L({most},{least})"
        )
    if light is not None:
        said.append(f"{of_light}={light[0]},{light[1]}")
    return tuple((k, ":".join([v, *said]) if k == name else v) for k, v in options)
