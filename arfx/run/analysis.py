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


def in_order(tasks: Iterator[Task], count: int, frames: int, progress: Done) -> Results:
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
        done = _Pass(context, progress, folder, key, log)
        return done.done(run, [] if times is None else times.pts)

    stretches, damaged = cut(span, times), reader.damaged
    try:
        found = joined(stretches, run if stretches.seeks else in_order)
    except FrameTimesError as e:  # what the packets say of the frames is not so
        damaged = isinstance(e, FrameDamageError)
        found = joined(whole(span), in_order)
    return replace(found, damaged=damaged)


class _Pass:
    """The stretches of a clip, joined in order as far as they are there."""

    def __init__(
        self,
        context: Context,
        progress: Progress,
        folder: JobFolder,
        key: str,
        log: WorkLog,
    ) -> None:
        stretches = context.stretches
        self.context, self.stretches = context, stretches
        self.folder, self.key, self.log = folder, key, log
        self.rows = ClipRows()
        self.pts, self.keys = list[int](), list[int]()
        self.before, self.ended, self.truncated = stretches.before, False, ""
        self.seconds: Any = Counter()
        self.walls, self.names = dict[str, float](), list[str]()
        self._progress, self._shown = progress, 0
        self._next = 0  # the stretch that is joined next
        self._ready = {
            part.first for part in stretches.parts if self._path(part).exists()
        }
        self._rows = {row["key"]: row for row in log.rows() if row["work"] == STRETCH}

    def done(self, run: Run, stated: list[int]) -> AnalysisPass:
        """stated : times of the clip's packets"""
        folder, parts, frames = self.folder, self.stretches.parts, self.stretches.frames
        folder.stretches.mkdir(exist_ok=True)
        keep(folder, self.key, self.context)
        waiting = {
            part.first: part.last + 1 - part.first
            for part in parts
            if part.first not in self._ready
        }
        made_before = frames - sum(waiting.values())

        def tasks() -> Iterator[Task]:
            for part in parts:
                if part.first in waiting:
                    yield (
                        str(folder.path),
                        self.key,
                        part.first,
                        part.last,
                        str(self._path(part)),
                    )

        with contextlib.ExitStack() as stack:
            stack.callback(release)
            self._join_ready()
            results = run(
                tasks(), len(waiting), frames, lambda n: self._tell(made_before + n)
            )
            for result in stack.enter_context(contextlib.closing(results)):
                # not of one that was there already, though nobody had heard of it
                if "seconds" in result:
                    self._note(result["file"], result)
                self._ready.add(result["first"])
                self._join_ready()
        start = time.perf_counter()
        if not self.pts:
            raise self.context.span.nothing()
        since_s, info = self.context.span.since_s, self.context.span.info
        times = [since_s(t) for t in self.pts]
        missing = missing_frames(
            self.pts, stated, gaps="mov" not in info.container
        )  # whose index says what a gap is
        truncated = (self.truncated or self.stretches.truncated) if self.ended else None
        if self.ended and not truncated and (lost := late_frames(self.pts, stated)):
            truncated = (
                f"{info.path}: the last frames cannot be decoded ({lost}); processed to the"
                " last good frame"
            )
        span = (times, self.before, self.ended and not truncated)
        analysis = analyse(self.rows, self.context.job, self.context.wanted, span)
        self.seconds.update({"analyse": time.perf_counter() - start})
        self.log.note(ANALYSIS, self.key, self.seconds, self.walls, stretches=self.names)
        self._progress("analyse", len(self.pts), len(self.pts))
        return AnalysisPass(
            analysis,
            self.pts,
            self.keys,
            truncated,
            self.stretches.careful,
            [(since_s(t), count) for t, count in missing],
        )

    def _join_ready(self) -> None:
        """As far as the stretches are there."""
        parts = self.stretches.parts
        while self._next < len(parts) and parts[self._next].first in self._ready:
            part = parts[self._next]
            start = time.perf_counter()
            tables, name, own_s = self._tables(part)
            first = len(self.pts)
            self.rows.add(tables, first - part.first)
            frames = rows_of(tables[FRAMES], StretchFrame, first)
            self.keys += [f.frame for f in frames if f.key]
            self.pts += [f.pts for f in frames]
            (end,) = rows_of(tables[END], StretchEnd)
            self.before += end.before
            self.ended, self.truncated = end.ended, end.truncated
            self._next += 1
            self.names.append(name)
            if row := self._rows.get(name):
                self.seconds.update(row["seconds"])
                for process, wall_s in row["walls"].items():
                    if process != self.log.process:
                        self.walls[process] = max(self.walls.get(process, 0.0), wall_s)
            self.seconds.update({"analyse": time.perf_counter() - start - own_s})

    def _tables(self, part: Stretch) -> tuple[Tables, str, float]:
        """(what a stretch shows, name of its file, seconds that it took to make it now).

        From its file, if that is whole.
        """
        path = self._path(part)
        with contextlib.suppress(OSError, ValueError):
            tables = from_bytes(path.read_bytes())
            if END in tables:
                return tables, path.name, 0.0
        start = time.perf_counter()
        tables, seconds = observe(self.context, part, self._tick, True)
        write(path, to_bytes(tables))
        self._note(
            path.name,
            {"first": part.first, "last": part.last, "seconds": seconds, **who()},
        )
        return tables, path.name, time.perf_counter() - start

    def _path(self, part: Stretch) -> Path:
        name = digest(
            self.key,
            sorted(self.context.wanted),
            part.to_json(),
            self.stretches.frames,
        )
        path: Path = self.folder.stretches / f"{part.first:06d}-{part.last:06d}.{name}"
        return path

    def _note(self, name: str, result: Mapping[str, Any]) -> None:
        self.log.note(STRETCH, name, **result)
        self._rows[name] = {"seconds": result["seconds"], "walls": {}}

    def _tick(self) -> None:
        self._tell(self._shown + 1)

    def _tell(self, frames: int) -> None:
        """frames : that were analysed, counted as often as that happened"""
        self._shown = max(self._shown, frames)
        expected = self.stretches.frames if self.stretches.parts[-1].last else None
        self._progress(
            "analyse",
            self._shown if expected is None else min(self._shown, expected),
            expected,
        )
