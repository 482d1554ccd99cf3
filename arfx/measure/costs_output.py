"""What of a job is not a stage's: editing the planes, encoding with every codec that this
machine has, joining chunks.
"""

from __future__ import annotations

import contextlib
import itertools
import queue
import tempfile
from collections.abc import Callable
from dataclasses import replace
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
from arfx.media.planes import copy_picture
from arfx.media.writer import ChunkWriter, chunk_suffix

SIZES = ((640, 360, 24), (1280, 720, 10))  # width, height, frames
USUAL = (
    "h264",
    "ffv1",
)  # encoded twice, and at every size; others at the first alone
JOINED = "h264"


def time_output(
    timed: dict[str, Runs], watch: Stopwatch, progress: Callable[[int, int], None]
) -> None:
    """Add runs of "edit", "encode CODEC" and "join" to `timed`."""
    total = len(CODECS) + (len(SIZES) - 1) * len(USUAL)
    with tempfile.TemporaryDirectory(prefix="arfx-calibrate-") as folder:
        for k, (width, height, count) in enumerate(SIZES):
            clip = write_clip(Path(folder) / f"{width}.mp4", width, height, count)
            info = probe(clip)
            with ClipReader(info) as reader:
                frames = list(reader.frames())
            _edit(timed, info, frames, watch)
            codecs = USUAL if k else tuple(CODECS)
            for n, codec in enumerate(codecs):
                progress(k * len(CODECS) + n, total)
                # a machine without this encoder has no price for it, and a plan says so
                with contextlib.suppress(ArfxError, av.error.FFmpegError, ValueError):
                    _encode(timed, Path(folder), info, frames, codec, watch)
        progress(total, total)


def _edit(
    timed: dict[str, Runs], info: ClipInfo, frames: list[Frame], watch: Stopwatch
) -> None:
    """As in a frame of a job: linear light of a rectangle, then the difference put back
    into the planes.
    """
    width, height = info.width, info.height
    whole = Rect(0, 0, width, height)
    for rect in (
        Rect(width // 3, height // 3, 2 * width // 3, 2 * height // 3),
        whole,
    ):

        def edit(rect: Rect = rect) -> None:
            for frame in frames[:6]:
                plate = frame.linear(rect)
                frame.edited(rect, plate, np.clip(plate * np.float32(0.9), 0, 1))

        edit()
        seconds = watch.of_concurrent(edit) / len(frames[:6])
        timed["edit"].add({"frames": 1.0, "mpx": 2 * rect.area / 1e6}, seconds)


def _encode(
    timed: dict[str, Runs],
    folder: Path,
    info: ClipInfo,
    frames: list[Frame],
    codec: str,
    watch: Stopwatch,
) -> None:
    name = f"{codec}-%03d.{codec}" if CODECS[codec].sequence else f"{codec}.mkv"
    plan = plan_output(info, folder / name, OutputSettings(codec))
    paths: list[Path] = []
    number = itertools.count()
    # a picture belongs to one thread: the library keeps with it what it converts it by
    unused: queue.SimpleQueue[list[Frame]] = queue.SimpleQueue()
    for _ in range(watch.concurrency):
        copies = (copy_picture(f.picture, f.format.layout) for f in frames)
        unused.put(
            [replace(f, picture=p) for f, p in zip(frames, copies, strict=True)]
        )

    def encode() -> None:
        path = folder / f"{codec}-{info.width}-{next(number)}{chunk_suffix(plan)}"
        paths.append(path)
        own = unused.get()
        with ChunkWriter(plan, info, path) as writer:
            for frame in own:
                writer.write(frame)
        unused.put(own)

    mpx = info.width * info.height / 1e6
    if codec in USUAL:
        encode()  # loads it
    for _ in range(2 if codec in USUAL else 1):
        seconds = watch.of_concurrent(encode) / len(frames)
        timed[f"encode {codec}"].add({"frames": 1.0, "mpx": mpx}, seconds)
    if codec == JOINED:
        first = [f.pts for f in frames]
        step = first[-1] - first[0] + max(first[1] - first[0], 1)
        pts = [*first, *(p + step for p in first)]
        joined = paths[0].with_name("joined.mkv")
        seconds = watch.of(lambda: join_chunks(paths[:2], pts, plan, info, joined))
        timed["join"].add({"frames": float(len(pts)), "mpx": len(pts) * mpx}, seconds)


def write_clip(path: Path, width: int, height: int, frames: int) -> Path:
    """A textured table with camera noise, swaying as if hand-held. Returns `path`."""
    g = np.random.default_rng(5)
    table = g.integers(70, 180, (height // 8, width // 8, 3)).astype(np.uint8)
    noise = g.normal(0, 2, (4, height, width, 3)).astype(np.float32)
    with create_container(path) as out:
        stream: Any = out.add_stream(
            "libx264", rate=30, options={"crf": "18", "preset": "veryfast"}
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for i in range(frames):
            t = i / 30
            middle = (width / 20, height / 20)
            turn = cv2.getRotationMatrix2D(middle, 15 + 2 * np.sin(t), 10)
            sway = 0.02 * width * np.sin([0.9 * t, 1.1 * t])
            move = np.array(turn, float)
            move[:, 2] += 0.4 * np.array([width, height]) + sway
            picture = cv2.warpAffine(
                table, move, (width, height), borderMode=cv2.BORDER_REFLECT
            )
            picture = np.clip(picture + noise[i % 4], 0, 255).astype(np.uint8)
            out.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24"))
            )
        out.mux(stream.encode(None))
    return path
