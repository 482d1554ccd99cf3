"""The analysis of a clip: its stretches, by any workers in any order, then one pass over
what they found, in order.
"""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from arfx.analyse.clip import analyse
from arfx.analyse.job import Analysis, AnalysisJob
from arfx.analyse.observe import ClipRows
from arfx.analyse.tables import Tables, from_bytes, rows_of
from arfx.errors import RenderError
from arfx.media.frames import (
    ClipReader,
    FrameDamageError,
    FrameTimesError,
    late_frames,
    missing_frames,
)
from arfx.run.executors import Done, Results, Task, run_serial
from arfx.run.folder import JobFolder
from arfx.run.planned import DecodedFrames
from arfx.run.stretches import (
    FRAMES,
    Context,
    Span,
    Stretch,
    StretchEnd,
    Stretches,
    analyse_stretch,
    cut,
    keep,
    whole,
)
from arfx.run.times import ANALYSIS, STRETCH, WorkLog

# (tasks, frames of the clip, progress)
Run = Callable[[Sequence[Task], int, Done], Results]


def in_order(tasks: Sequence[Task], frames: int, progress: Done) -> Results:
    """The stretches one after the other, in this thread."""
    return run_serial(tasks, progress, analyse_stretch)


def analyse_clip(
    span: Span,
    job: AnalysisJob,
    wanted: Collection[str],
    folder: JobFolder,
    key: str,
    log: WorkLog | None = None,
    run: Run = in_order,
) -> tuple[Analysis, DecodedFrames]:
    """Analyse the frames of a span.

    wanted : facts, by name;  folder, key : where the stretches are kept, and what they are of
    run(tasks, frames, progress) : has analyse_stretch called on tasks, whoever does it
    Stretches that are there already are taken as they are. Raises
    NothingToDoError if the span holds no frame, or nothing is seen to stand on."""
    log, progress = log or WorkLog(folder.timings), job.progress
    with ClipReader(span.info) as reader:
        times = reader.times()

    def analysed(stretches: Stretches, run: Run) -> tuple[Analysis, DecodedFrames]:
        context = Context(job, wanted, span)
        files = {part: folder.stretches / part.name(key) for part in stretches.parts}
        folder.stretches.mkdir(exist_ok=True)
        keep(folder, key, context)
        todo = {part: file for part, file in files.items() if _tables(file) is None}
        for file in todo.values():
            file.unlink(missing_ok=True)
        frames = stretches.parts[0].of
        before = frames - sum(part.frames for part in todo)
        total = frames if frames > 1 else None

        def tell(done: int) -> None:
            """done : frames that were analysed, counted as often as that happened"""
            progress("analyse", min(before + done, total or before + done), total)

        tasks = [(str(folder.path), key, part) for part in todo]
        with contextlib.closing(run(tasks, frames, tell)) as results:
            for result in results:
                log.note(STRETCH, **result)
        start = time.perf_counter()
        stated = [] if times is None else times.pts
        found, decoded = _joined(context, stretches, files, stated)
        seconds = {"analyse": time.perf_counter() - start}
        names = [file.name for file in files.values()]
        log.note(ANALYSIS, key, seconds, stretches=names)
        progress("analyse", len(decoded.pts), len(decoded.pts))
        return found, decoded

    stretches, damaged = cut(span, times), reader.damaged
    try:
        found, frames = analysed(stretches, run if stretches.seeks else in_order)
    except FrameTimesError as e:  # what the packets say of the frames is not so
        damaged = isinstance(e, FrameDamageError)
        found, frames = analysed(whole(span), in_order)
    return found, replace(frames, damaged=damaged)


def _tables(file: Path) -> Tables | None:
    """None where there is no file that is whole."""
    with contextlib.suppress(OSError, ValueError):
        tables = from_bytes(file.read_bytes())
        if StretchEnd.__name__ in tables:
            return tables
    return None


def _joined(
    context: Context,
    stretches: Stretches,
    files: Mapping[Stretch, Path],
    stated: list[int],
) -> tuple[Analysis, DecodedFrames]:
    """What the stretches hold together. stated : times of the clip's packets"""
    span, careful = context.span, stretches.parts[0].careful
    rows, pts = ClipRows(), list[int]()
    before, end = stretches.before, StretchEnd(0, False, "")
    for part, file in files.items():
        tables = _tables(file)
        if tables is None:
            raise RenderError(f"{file} has changed", "--resume makes it anew")
        rows.add(tables, len(pts) - part.first)
        pts += tables[FRAMES]["pts"].tolist()
        (end,) = rows_of(tables, StretchEnd)
        before += end.before
    if not pts:
        raise span.nothing()
    # an MP4's index says what a gap is
    missing = missing_frames(pts, stated, gaps="mov" not in span.info.container)
    truncated = (end.truncated or stretches.truncated) if end.ended else None
    if end.ended and not truncated and (lost := late_frames(pts, stated)):
        truncated = (
            f"{span.info.path}: the last frames cannot be decoded ({lost}); processed"
            " to the last good frame"
        )
    times = [span.since_s(t) for t in pts]
    frame_span = (times, before, end.ended and not truncated)
    analysis = analyse(rows, context.job, context.wanted, frame_span)
    gaps = [(span.since_s(t), count) for t, count in missing]
    return analysis, DecodedFrames(pts, truncated, careful, gaps, False)
