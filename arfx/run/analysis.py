"""The analysis of a clip: its stretches, by any workers in any order, then one pass over
what they found, in order.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from arfx.analyse.clip import analyse
from arfx.analyse.job import Analysis, AnalysisJob
from arfx.analyse.observe import ClipRows
from arfx.analyse.tables import Tables, from_bytes, rows_of, to_bytes
from arfx.core.waiting import Progress
from arfx.media.clip import ClipInfo
from arfx.media.frames import (
    ClipReader,
    FrameDamageError,
    FrameTimesError,
    late_frames,
    missing_frames,
)
from arfx.run.executors import Done, Results, Task, run_serial
from arfx.run.folder import JobFolder, digest, write
from arfx.run.source import release
from arfx.run.stretches import (
    END,
    FRAMES,
    Context,
    Span,
    Stretch,
    StretchEnd,
    Stretches,
    StretchFrame,
    analyse_stretch,
    cut,
    keep,
    observe,
    whole,
)
from arfx.run.times import ANALYSIS, STRETCH, WorkLog
from arfx.run.worker import who

# (tasks, how many there are at most, frames of the clip, progress, a worker can begin anywhere)
Run = Callable[[Iterator[Task], int, int, Done], Results]


@dataclass(frozen=True)
class AnalysisPass:
    """pts : presentation times of the frames to render, in the clip's time base;  keys :
    which of them decoding can begin at
    truncated : a message where the file ends in damage;  careful, missing, damaged : as of
    `ClipAnalysis`"""

    analysis: Analysis
    pts: list[int]
    keys: list[int]
    truncated: str | None
    careful: bool
    missing: list[tuple[float, int]]
    damaged: bool = False


def in_order(
    tasks: Iterator[Task], count: int, frames: int, progress: Done
) -> Results:
    """The stretches one after the other, in this thread."""
    return run_serial(tasks, progress, analyse_stretch)


def analyse_clip(
    info: ClipInfo,
    job: AnalysisJob,
    wanted: Collection[str],
    span_s: tuple[float | None, float | None],
    progress: Progress,
    folder: JobFolder,
    key: str,
    log: WorkLog | None = None,
    run: Run = in_order,
) -> AnalysisPass:
    """Analyse the frames of span_s (seconds from the clip's first frame, ends included).

    wanted : facts, by name;  folder, key : where the stretches are kept, and what they are of
    run(tasks, most that there are, frames, progress) : has analyse_stretch called on tasks,
    whoever does it Stretches that are there already are taken as they are. Raises
    NothingToDoError if the span holds no frame, or nothing is seen to stand on."""
    span, log = Span(info, *span_s), log or WorkLog(folder.timings)
    with ClipReader(info) as reader:
        times = reader.times()

    def joined(stretches: Stretches, run: Run) -> AnalysisPass:
        clip = replace(job, frames=stretches.frames)
        context = Context(clip, wanted, span, stretches)
        observed = _Pass(context, progress, folder, key, log)
        observed.observe(run)
        return observed.analysed([] if times is None else times.pts)

    stretches, damaged = cut(span, times), reader.damaged
    try:
        found = joined(stretches, run if stretches.seeks else in_order)
    except FrameTimesError as e:  # what the packets say of the frames is not so
        damaged = isinstance(e, FrameDamageError)
        found = joined(whole(span), in_order)
    return replace(found, damaged=damaged)


class _Pass:
    """The stretches of a clip, observed and joined."""

    def __init__(
        self,
        context: Context,
        progress: Progress,
        folder: JobFolder,
        key: str,
        log: WorkLog,
    ) -> None:
        self.context, self.folder, self.key, self.log = context, folder, key, log
        self._progress, self._shown = progress, 0
        self._seconds: Any = Counter()
        self._rows = {row["key"]: row for row in log.rows() if row["work"] == STRETCH}

    def observe(self, run: Run) -> None:
        """Leave a file of every stretch, but where there is one."""
        folder, stretches = self.folder, self.context.stretches
        folder.stretches.mkdir(exist_ok=True)
        keep(folder, self.key, self.context)
        todo = [part for part in stretches.parts if not self._path(part).exists()]
        before = stretches.frames - sum(part.last + 1 - part.first for part in todo)
        tasks: Iterator[Task] = (
            (str(folder.path), self.key, part.first, part.last, str(self._path(part)))
            for part in todo
        )
        results = run(
            tasks, len(todo), stretches.frames, lambda n: self._tell(before + n)
        )
        with contextlib.closing(results):
            for result in results:
                # not of one that was there already, though nobody had heard of it
                if "seconds" in result:
                    self._note(result["file"], result)

    def analysed(self, stated: list[int]) -> AnalysisPass:
        """What the stretches hold together. stated : times of the clip's packets"""
        stretches, span = self.context.stretches, self.context.span
        rows, names = ClipRows(), list[str]()
        pts, keys = list[int](), list[int]()
        before, end = stretches.before, StretchEnd(0, False, "")
        for part in stretches.parts:
            path, tables = self._path(part), self._tables(part)
            start = time.perf_counter()
            rows.add(tables, len(pts) - part.first)
            frames = rows_of(tables[FRAMES], StretchFrame, len(pts))
            keys += [f.frame for f in frames if f.key]
            pts += [f.pts for f in frames]
            (end,) = rows_of(tables[END], StretchEnd)
            before += end.before
            names.append(path.name)
            self._seconds.update({"analyse": time.perf_counter() - start})
        if not pts:
            raise span.nothing()
        start = time.perf_counter()
        times = [span.since_s(t) for t in pts]
        # an MP4's index says what a gap is
        missing = missing_frames(pts, stated, gaps="mov" not in span.info.container)
        truncated = (end.truncated or stretches.truncated) if end.ended else None
        if end.ended and not truncated and (lost := late_frames(pts, stated)):
            truncated = (
                f"{span.info.path}: the last frames cannot be decoded ({lost}); processed"
                " to the last good frame"
            )
        frame_span = (times, before, end.ended and not truncated)
        analysis = analyse(rows, self.context.job, self.context.wanted, frame_span)
        self._seconds.update({"analyse": time.perf_counter() - start})
        self._log_analysis(names)
        self._progress("analyse", len(pts), len(pts))
        gaps = [(span.since_s(t), count) for t, count in missing]
        return AnalysisPass(analysis, pts, keys, truncated, stretches.careful, gaps)

    def _log_analysis(self, names: list[str]) -> None:
        """names : of the stretches' files"""
        walls = dict[str, float]()
        for row in (self._rows[name] for name in names if name in self._rows):
            self._seconds.update(row["seconds"])
            for process, wall_s in row["walls"].items():
                if process != self.log.process:
                    walls[process] = max(walls.get(process, 0.0), wall_s)
        self.log.note(ANALYSIS, self.key, self._seconds, walls, stretches=names)

    def _tables(self, part: Stretch) -> Tables:
        """Of a stretch's file; made now where that is not whole."""
        path = self._path(part)
        with contextlib.suppress(OSError, ValueError):
            tables = from_bytes(path.read_bytes())
            if END in tables:
                return tables
        try:
            tables, seconds = observe(self.context, part, self._tick, True)
        finally:
            release()
        write(path, to_bytes(tables))
        frames = {"first": part.first, "last": part.last}
        self._note(path.name, {**frames, "seconds": seconds, **who()})
        return tables

    def _path(self, part: Stretch) -> Path:
        name = digest(
            self.key,
            sorted(self.context.wanted),
            part.to_json(),
            self.context.stretches.frames,
        )
        path: Path = (
            self.folder.stretches / f"{part.first:06d}-{part.last:06d}.{name}"
        )
        return path

    def _note(self, name: str, result: Mapping[str, Any]) -> None:
        self.log.note(STRETCH, name, **result)
        self._rows[name] = {"seconds": result["seconds"], "walls": {}}

    def _tick(self) -> None:
        self._tell(self._shown + 1)

    def _tell(self, frames: int) -> None:
        """frames : that were analysed, counted as often as that happened"""
        self._shown = max(self._shown, frames)
        stretches = self.context.stretches
        expected = stretches.frames if stretches.parts[-1].last else None
        self._progress(
            "analyse",
            self._shown if expected is None else min(self._shown, expected),
            expected,
        )
