"""The yardstick of tools/bench_job.py: decode a clip and encode it again, nothing else.
Imports PyAV only.

It is a program of its own so that its start is that of a plain PyAV program: with the
imports of the benchmark it would start about .4 s later, and every ratio to it would look
better than it is.

    python tools/plain_pass.py IN OUT '{"encoder": ..., "options": {...}, "pixel_format":
    ..., "threads": 2, "rate": 30}'
"""

from __future__ import annotations

import json
import sys
from typing import Any

import av


def plain(source: str, target: str, settings: dict[str, Any]) -> None:
    """settings : encoder, options, pixel_format, threads, rate (frames/s), as `arfx
    process` gives them to PyAV
    """
    with av.open(source) as read, av.open(target, "w") as write:
        video = read.streams.video[0]
        video.thread_type = "AUTO"
        stream: Any = write.add_stream(
            settings["encoder"], rate=settings["rate"], options=settings["options"]
        )
        stream.width, stream.height, stream.pix_fmt = (
            video.width,
            video.height,
            settings["pixel_format"],
        )
        # frame threads, as arfx.media.writer sets them: PyAV's own choice would be slices
        stream.codec_context.thread_count, stream.codec_context.thread_type = (
            settings["threads"],
            "FRAME",
        )
        for frame in read.decode(video):
            frame.pict_type = 0  # type: ignore[assignment]
            write.mux(stream.encode(frame))
        write.mux(stream.encode(None))


if __name__ == "__main__":
    plain(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
