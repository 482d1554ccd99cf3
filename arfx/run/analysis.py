"""The sequential pass over the clip: decode once, in order, and fold every frame into facts. Checkpointed."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Stateful
from arfx.analyse.folds import Analyser
from arfx.core import codec
from arfx.errors import NothingToDoError
from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.run.background_io import Prefetch
from arfx.run.folder import JobFolder, write
from arfx.run.times import WorkLog

CHECKPOINT_S = 20.0  # at most this much analysis is lost to a kill, or as many times what it takes to write it down
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class AnalysisPass:
    """span : the frames to render;  truncated : a message where the file ends in damage
    seconds : of decoding and analysing, by all processes;  walls : of the earlier ones (`WorkLog`)"""

    analysis: Analysis
    span: Span
    truncated: str | None
    seconds: Mapping[str, float]
    walls: Mapping[str, float]


def analyse_clip(
    info: ClipInfo, job: AnalysisJob, wanted: Collection[str], span_s: tuple[float | None, float | None],
    progress: Callable[[str, int, int | None], None], folder: JobFolder, key: str, log: WorkLog | None = None,
) -> AnalysisPass:  # fmt: skip
    """Analyse the frames of span_s (seconds from the clip's first frame, ends included).

    wanted : folds, by name;  folder, key : where the state is checkpointed, and what it must match to be resumed from
    After an interruption the whole clip is decoded again: a frame, and when it is shown, may depend on any frame before it.
    Raises NothingToDoError if the span holds no frame, or nothing is seen to stand on."""
    analyser, log = Analyser(job, wanted), log or WorkLog(folder.timings)
    span, analyse_s, expected = Span(span_s, info.time_base), 0.0, info.frame_count_stated if span_s == (None, None) else None
    checkpoint = Checkpoint(folder.checkpoint, [key, job.anchor, *analyser.folds])
    before_s, walls, began = 0.0, {}, time.perf_counter()
    if (state := checkpoint.read()) is not None:
        span.restore(state["span"])
        analyser.restore(state["folds"])
        before_s, walls = state["seconds"], state["walls"]
    with ClipReader(info) as reader, Prefetch(reader.frames()) as frames:
        for frame, following in itertools.pairwise(itertools.chain(span.inside(frames), [None])):
            assert frame is not None
            start = time.perf_counter()
            luma, after = np.ascontiguousarray(frame.luma()), None if following is None else following.luma
            analyser.step(AnalysisFrame(len(span.pts), frame.time_s, luma, frame, after))
            analyse_s += time.perf_counter() - start
            span.take(frame)
            progress("analyse", len(span.pts), expected)
            if checkpoint.due():
                spent = {"seconds": before_s + time.perf_counter() - began, "walls": log.walls(walls)}
                checkpoint.write({"span": span.state(), "folds": analyser.state(), **spent})
        truncated, decode_s = reader.truncated, frames.seconds
    span.whole &= not truncated
    span.require_any(info.path)
    start = time.perf_counter()
    analysis = analyser.finish(Analysis(frame_span=(span.from_start_s(), span.before, span.whole)))
    analyse_s += time.perf_counter() - start
    progress("analyse", len(span.pts), len(span.pts))
    # the time up to a checkpoint is known as a whole: divided as the rest was
    scale = 1 + before_s / max(decode_s + analyse_s, 1e-9)
    return AnalysisPass(analysis, span, truncated, {"decode": decode_s * scale, "analyse": analyse_s * scale}, walls)


class Checkpoint:
    """A file with the state of an unfinished pass. of : what a state must be of to be resumed from"""

    def __init__(self, path: Path, of: list[str]) -> None:
        self._path, self._of = path, of
        self._last, self._cost_s = time.monotonic(), 0.0

    def read(self) -> dict[str, Any] | None:
        """None where there is none, or one of something else, of another version, or damaged: the pass starts over."""
        try:
            saved = codec.loads(self._path.read_bytes())
        except (OSError, ValueError):
            return None
        matches = isinstance(saved, dict) and saved.get("of") == self._of and isinstance(saved.get("state"), dict)
        return saved["state"] if matches else None

    def due(self) -> bool:
        return time.monotonic() - self._last > CHECKPOINT_S * max(self._cost_s, 1.0)

    def write(self, state: dict[str, Any]) -> None:
        """Raises RenderError where the disk is full."""
        start = time.monotonic()
        write(self._path, codec.dumps({"of": self._of, "state": state}))
        self._last = time.monotonic()
        self._cost_s = self._last - start


class Span(Stateful):
    """The frames between two times, seconds from the clip's first frame, ends included; None = no end.

    pts : presentation times of the frames that were taken, in the clip's time base: who takes a frame calls `take`
    keys : which of them decoding can begin at
    origin : of the clip's first frame;  before : frames of the clip before the span;  whole : it reaches to the clip's end"""

    given = frozenset({"_start_s", "_end_s", "_time_base"})

    def __init__(self, span_s: tuple[float | None, float | None], time_base: Fraction) -> None:
        self._start_s = -math.inf if span_s[0] is None else span_s[0]
        self._end_s = math.inf if span_s[1] is None else span_s[1]
        self._time_base = time_base
        self.pts: list[int] = []
        self.keys: list[int] = []
        self.origin: int | None = None
        self.before, self.whole = 0, True

    def inside(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Those of the clip's `frames`, in order, that lie in the span and after those that were taken before."""
        last = self.pts[-1] if self.pts else -math.inf
        for frame in frames:
            if self.origin is None:
                self.origin = frame.pts
            if frame.pts <= last:
                continue
            since_s = self._since_s(frame.pts)
            if since_s > self._end_s + _ROUNDING_S:
                self.whole = False
                return
            if since_s < self._start_s - _ROUNDING_S:
                self.before += 1
            else:
                last = frame.pts
                yield frame

    def take(self, frame: Frame) -> None:
        if frame.key:
            self.keys.append(len(self.pts))
        self.pts.append(frame.pts)

    def from_start_s(self) -> list[float]:
        """Seconds of the frames that were taken, from the clip's first frame."""
        return [self._since_s(t) for t in self.pts]

    def _since_s(self, pts: int) -> float:
        return float((pts - (self.origin or 0)) * self._time_base)

    def require_any(self, path: Path) -> None:
        """Raises NothingToDoError where no frame was taken."""
        if not self.pts:
            end = "its end" if math.isinf(self._end_s) else f"{self._end_s:g} s"
            raise NothingToDoError(
                f"{path} has no frame between {max(self._start_s, 0):g} s and {end}",
                "check --start and --end; `arfx inspect` shows the clip's length",
            )
