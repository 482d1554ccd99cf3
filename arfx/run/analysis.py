"""The analysis of a clip: its stretches, by any workers in any order, then one pass over
what they found, in order.
"""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from arfx.analyse.clip import analyse
from arfx.analyse.job import Analysis, AnalysisJob
from arfx.analyse.observe import ClipRows
from arfx.analyse.tables import Tables, from_bytes, rows_of
from arfx.core.waiting import Progress
from arfx.errors import RenderError
from arfx.media.clip import ClipInfo
from arfx.media.frames import (
    ClipReader,
    FrameDamageError,
    FrameTimesError,
    late_frames,
    missing_frames,
)
from arfx.run.executors import Done, Results, Task, run_serial
from arfx.run.folder import JobFolder
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
    whole,
)
from arfx.run.times import ANALYSIS, STRETCH, WorkLog

# (tasks, frames of the clip, progress)
Run = Callable[[Sequence[Task], int, Done], Results]


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


def in_order(tasks: Sequence[Task], frames: int, progress: Done) -> Results:
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
    run(tasks, frames, progress) : has analyse_stretch called on tasks, whoever does it
    Stretches that are there already are taken as they are. Raises
    NothingToDoError if the span holds no frame, or nothing is seen to stand on."""
    span, log = Span(info, *span_s), log or WorkLog(folder.timings)
    with ClipReader(info) as reader:
        times = reader.times()

    def analysed(stretches: Stretches, run: Run) -> AnalysisPass:
        context = Context(
            replace(job, frames=stretches.frames), wanted, span, stretches
        )
        files: dict[Stretch, Path] = {
            part: folder.stretches / f"{part.first:06d}-{part.last:06d}.{key}"
            for part in stretches.parts
        }
        folder.stretches.mkdir(exist_ok=True)
        keep(folder, key, context)
        todo = {part: file for part, file in files.items() if _tables(file) is None}
        for file in todo.values():
            file.unlink(missing_ok=True)
        before = stretches.frames - sum(p.last + 1 - p.first for p in todo)
        total = stretches.frames if stretches.parts[-1].last else None

        def tell(done: int) -> None:
            """done : frames that were analysed, counted as often as that happened"""
            progress("analyse", min(before + done, total or before + done), total)

        tasks: list[Task] = [
            (str(folder.path), key, part.first, part.last, str(file))
            for part, file in todo.items()
        ]
        with contextlib.closing(run(tasks, stretches.frames, tell)) as results:
            for result in results:
                log.note(STRETCH, result["file"], **result)
        start = time.perf_counter()
        found = _joined(context, files, [] if times is None else times.pts)
        seconds = {"analyse": time.perf_counter() - start}
        names = [file.name for file in files.values()]
        log.note(ANALYSIS, key, seconds, stretches=names)
        progress("analyse", len(found.pts), len(found.pts))
        return found

    stretches, damaged = cut(span, times), reader.damaged
    try:
        found = analysed(stretches, run if stretches.seeks else in_order)
    except FrameTimesError as e:  # what the packets say of the frames is not so
        damaged = isinstance(e, FrameDamageError)
        found = analysed(whole(span), in_order)
    return replace(found, damaged=damaged)


def _tables(file: Path) -> Tables | None:
    """None where there is no file that is whole."""
    with contextlib.suppress(OSError, ValueError):
        tables = from_bytes(file.read_bytes())
        if END in tables:
            return tables
    return None


def _joined(
    context: Context, files: Mapping[Stretch, Path], stated: list[int]
) -> AnalysisPass:
    """What the stretches hold together. stated : times of the clip's packets"""
    stretches, span = context.stretches, context.span
    rows, pts, keys = ClipRows(), list[int](), list[int]()
    before, end = stretches.before, StretchEnd(0, False, "")
    for part, file in files.items():
        tables = _tables(file)
        if tables is None:
            raise RenderError(f"{file} has changed", "--resume makes it anew")
        rows.add(tables, len(pts) - part.first)
        frames = rows_of(tables[FRAMES], StretchFrame, len(pts))
        keys += [f.frame for f in frames if f.key]
        pts += [f.pts for f in frames]
        (end,) = rows_of(tables[END], StretchEnd)
        before += end.before
    if not pts:
        raise span.nothing()
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
    analysis = analyse(rows, context.job, context.wanted, frame_span)
    gaps = [(span.since_s(t), count) for t, count in missing]
    return AnalysisPass(analysis, pts, keys, truncated, stretches.careful, gaps)
