"""The sequential pass over the clip: decode once, in order, and fold every frame into facts. Checkpointed."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.folds import Analyser
from arfx.core import codec
from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.run.ahead import Ahead
from arfx.run.folder import JobFolder, write
from arfx.run.span import Span

CHECKPOINT_S = 20.0  # at most this much analysis is lost to a kill, or as many times what it takes to write it down
Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Pass:
    """What the pass leaves behind. span : the frames to render;  truncated : a message where the file ends in damage"""

    analysis: Analysis
    span: Span
    truncated: str | None
    decode_s: float
    analyse_s: float


def analyse_clip(
    info: ClipInfo, job: AnalysisJob, wanted: Collection[str], span_s: tuple[float | None, float | None], progress: Progress,
    folder: JobFolder | None = None, key: str = "",
) -> Pass:  # fmt: skip
    """Analyse the frames of span_s (seconds from the clip's first frame, ends included).

    wanted : folds, by name;  folder, key : where the state is checkpointed and what it must match to be taken up again
    What was interrupted goes on from its checkpoint. All of the clip is decoded again even so: what a decoder makes of a
    frame, and when the frame is shown, may depend on any frame before it.
    Raises NothingToDoError if the span holds no frame, or nothing is seen to stand on.
    """
    analyser = Analyser(job, wanted)
    span, analyse_s, expected = Span(span_s, info.time_base), 0.0, info.frame_count_stated if span_s == (None, None) else None
    kept = None if folder is None else Checkpoint(folder.checkpoint, [key, job.anchor, *analyser.folds])
    if kept is not None and (state := kept.read()) is not None:
        span.restore(state["span"])
        analyser.restore(state["folds"])
    with ClipReader(info) as reader, Ahead(reader.frames()) as frames:
        for frame, following in _with_next(span.inside(frames)):
            start = time.perf_counter()
            luma, after = np.ascontiguousarray(frame.luma()), None if following is None else following.luma
            analyser.step(AnalysisFrame(len(span.pts), frame.time_s, luma, frame, after))
            analyse_s += time.perf_counter() - start
            span.take(frame)
            progress("analyse", len(span.pts), expected)
            if kept is not None and kept.due():
                kept.write({"span": span.state(), "folds": analyser.state()})
        truncated, decode_s = reader.truncated, frames.seconds
    span.whole &= not truncated
    span.require_any(info.path)
    start = time.perf_counter()
    analysis = analyser.finish(Analysis(frame_span=(span.from_start_s(), span.before, span.whole)))
    analyse_s += time.perf_counter() - start
    progress("analyse", len(span.pts), len(span.pts))
    return Pass(analysis, span, truncated, decode_s, analyse_s)


class Checkpoint:
    """A file with the state of an unfinished pass. of : what the state must be of to be taken up again"""

    def __init__(self, path: Path, of: list[str]) -> None:
        self._path, self._of = path, of
        self._last, self._cost_s = time.monotonic(), 0.0

    def read(self) -> dict[str, Any] | None:
        """None where there is none, or one of something else, of another version, or damaged: the pass starts over."""
        try:
            saved = codec.loads(self._path.read_bytes())
        except (OSError, ValueError):
            return None
        right = isinstance(saved, dict) and saved.get("of") == self._of and isinstance(saved.get("state"), dict)
        return saved["state"] if right else None

    def due(self) -> bool:
        return time.monotonic() - self._last > CHECKPOINT_S * max(self._cost_s, 1.0)

    def write(self, state: dict[str, Any]) -> None:
        """Raises RenderError where the disk is full."""
        start = time.monotonic()
        write(self._path, codec.dumps({"of": self._of, "state": state}))
        self._last = time.monotonic()
        self._cost_s = self._last - start


def _with_next(frames: Iterator[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Each frame and the one after it."""
    frame = next(frames, None)
    while frame is not None:
        following = next(frames, None)
        yield frame, following
        frame = following
