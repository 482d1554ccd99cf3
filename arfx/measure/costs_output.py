"""What of a job is not a stage's: editing the planes, encoding with every codec that this
machine has, joining chunks.
"""

import contextlib
import itertools
import queue
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from arfx.core.rect import Rect
from arfx.errors import ArfxError
from arfx.measure.timing import Runs, Stopwatch
from arfx.media.clip import ClipInfo, probe
from arfx.media.codecs import CODECS, create_container
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.media.join import join_chunks
from arfx.media.output import OutputSettings, plan_output
from arfx.media.writer import ChunkWriter, chunk_suffix

SIZES = ((640, 360, 24), (1280, 720, 10))  # width, height, frames
USUAL = (
    "h264",
    "ffv1",
)  # encoded twice, and at every size; others at the first alone
JOINED = "h264"
EDITED = 6  # frames
Unused = queue.SimpleQueue[list[Frame]]  # of each thread


def time_output(
    timed: dict[str, Runs], watch: Stopwatch, progress: Callable[[int, int], None]
) -> None:
    """Add runs of "edit", "encode CODEC" and "join" to `timed`."""
    total = len(CODECS) + (len(SIZES) - 1) * len(USUAL)
    with tempfile.TemporaryDirectory(prefix="arfx-calibrate-") as folder:
        for k, (width, height, count) in enumerate(SIZES):
            clip = write_clip(Path(folder) / f"{width}.mp4", width, height, count)
            info = probe(clip)
            # a picture belongs to one thread: the library keeps with it what it converts it by
            unused: Unused = queue.SimpleQueue()
            for _ in range(watch.concurrency):
                with ClipReader(info) as reader:
                    unused.put(list(reader.frames()))
            _edit(timed, info, unused, watch)
            codecs = USUAL if k else tuple(CODECS)
            for n, codec in enumerate(codecs):
                progress(k * len(CODECS) + n, total)
                # a machine without this encoder has no price for it, and a plan says so
                with contextlib.suppress(ArfxError, av.error.FFmpegError, ValueError):
                    _encode(timed, Path(folder), info, unused, codec, watch)
        progress(total, total)


def _edit(
    timed: dict[str, Runs], info: ClipInfo, unused: Unused, watch: Stopwatch
) -> None:
    """As in a frame of a job: linear light of a rectangle, then the difference put back
    into the planes.
    """
    width, height = info.width, info.height
    middle = Rect(width // 3, height // 3, 2 * width // 3, 2 * height // 3)
    for rect in (middle, Rect.of(width, height)):

        def edit(rect: Rect = rect) -> None:
            own = unused.get()
            for frame in own[:EDITED]:
                plate = frame.linear(rect)
                frame.edited(rect, plate, np.clip(plate * np.float32(0.9), 0, 1))
            unused.put(own)

        edit()
        seconds = watch.of_concurrent(edit) / EDITED
        timed["edit"].add({"frames": 1.0, "mpx": 2 * rect.area / 1e6}, seconds)


def _encode(
    timed: dict[str, Runs],
    folder: Path,
    info: ClipInfo,
    unused: Unused,
    codec: str,
    watch: Stopwatch,
) -> None:
    name = f"{codec}-%03d.{codec}" if CODECS[codec].sequence else f"{codec}.mkv"
    plan = plan_output(info, folder / name, OutputSettings(codec))
    paths: list[Path] = []
    pts: list[int] = []
    number = itertools.count()

    def encode() -> None:
        path = folder / f"{codec}-{info.width}-{next(number)}{chunk_suffix(plan)}"
        paths.append(path)
        own = unused.get()
        with ChunkWriter(plan, info, path) as writer:
            for frame in own:
                writer.write(frame)
        unused.put(own)
        pts[:] = [frame.pts for frame in own]

    mpx = info.width * info.height / 1e6
    if codec in USUAL:
        encode()  # loads it
    for _ in range(2 if codec in USUAL else 1):
        seconds = watch.of_concurrent(encode) / len(pts)
        timed[f"encode {codec}"].add({"frames": 1.0, "mpx": mpx}, seconds)
    if codec == JOINED:
        step = pts[-1] - pts[0] + max(pts[1] - pts[0], 1)
        both = [*pts, *(p + step for p in pts)]
        joined = paths[0].with_name("joined.mkv")
        seconds = watch.of(lambda: join_chunks(paths[:2], both, plan, info, joined))
        work = {"frames": float(len(both)), "mpx": len(both) * mpx}
        timed["join"].add(work, seconds)


def write_clip(path: Path, width: int, height: int, frames: int) -> Path:
    """A textured table with camera noise, swaying as if hand-held. Returns `path`."""
    g = np.random.default_rng(5)
    tiles = g.integers(70, 180, (height // 8, width // 8, 3)).astype(np.uint8)
    table = cv2.resize(tiles, (width, height))
    noise = g.normal(0, 2, (4, height, width, 3)).astype(np.float32)
    with create_container(path) as out:
        stream: Any = out.add_stream(
            "libx264", rate=30, options={"crf": "18", "preset": "veryfast"}
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for i in range(frames):
            sway = np.rint(0.02 * width * np.sin([1.1 * i / 30, 0.9 * i / 30]))
            moved = np.roll(table, sway.astype(int), (0, 1))
            picture = np.clip(moved + noise[i % 4], 0, 255).astype(np.uint8)
            out.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24"))
            )
        out.mux(stream.encode(None))
    return path
