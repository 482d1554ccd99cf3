"""The clip's further streams (audio, second video, subtitles), packet by packet, bits and times as they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

from arfx.media.clip import ClipInfo
from arfx.media.output import OutputPlan

_MUXER_OWN = {"encoder", "duration", "rotate", "major_brand", "minor_version", "compatible_brands", "number_of_frames"}


def plain_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    """Tags that belong to the recording, not to the file that held it."""
    return {k: v for k, v in metadata.items() if k.lower() not in _MUXER_OWN and not k.startswith(("_STATISTICS", "NUMBER_OF"))}


def add_copied_stream(out: Any, source: Any) -> Any:
    """A stream in `out` with the parameters, language and disposition of a source stream."""
    stream = out.add_stream_from_template(source, opaque=True)
    stream.time_base = source.time_base
    stream.metadata.update(plain_metadata(source.metadata))
    stream.disposition = source.disposition
    if source.type == "video":
        stream.codec_context.framerate = source.average_rate or source.guessed_rate or Fraction(25)
    return stream


def copied_packets(
    container: Any, info: ClipInfo, plan: OutputPlan, start_s: float | None, end_s: float | None
) -> Iterator[tuple[Fraction, Any]]:
    """(decode time in seconds, packet) of the streams that the plan copies, in file order.

    start_s, end_s : seconds after the clip's first frame; a packet that ends before or begins after them is left out.
    A further video stream begins at its last key frame before start_s, so that it can be decoded.
    A file that breaks off ends the copy where it breaks, like the frames.
    """
    import av

    zero = info.start_pts * info.time_base
    low = None if start_s is None else zero + Fraction(start_s)
    high = None if end_s is None else zero + Fraction(end_s)
    waiting: dict[int, list[Any]] = {}
    packets = container.demux([container.streams[i] for i in plan.streams])
    while True:
        try:
            packet = next(packets, None)
        except (av.error.FFmpegError, OSError):
            return
        if packet is None:
            return
        if packet.size == 0 or packet.is_corrupt or (packet.pts is None and packet.dts is None):
            continue
        stamp = packet.pts if packet.pts is not None else packet.dts
        at = stamp * packet.time_base
        if high is not None and at >= high:
            continue
        if low is not None and at + (packet.duration or 0) * packet.time_base <= low:
            if packet.stream.type == "video":
                held = waiting.setdefault(packet.stream_index, [])
                if packet.is_keyframe:
                    held.clear()
                held.append(packet)
            continue
        for p in [*waiting.pop(packet.stream_index, []), packet]:
            decoded = p.dts if p.dts is not None else p.pts
            yield decoded * p.time_base, p
