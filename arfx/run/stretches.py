"""The analysis of one stretch of a clip, the unit of work: in any order, by any worker,
which leaves a file in the job folder.

Where a clip is cut depends on it alone: at key frames, so that a worker can begin to decode
there, at least LEAST_FRAMES apart. Every stretch is analysed as if nothing lay before it
(`arfx.analyse.observe`), and sees the first frame of the next one."""

import contextlib
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Collection, Generator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.observe import Observation
from arfx.analyse.tables import Tables, tables_of, to_bytes
from arfx.errors import NothingToDoError
from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import (
    ClipReader,
    FrameDamageError,
    FrameTimes,
    FrameTimesError,
)
from arfx.media.pose_files import CameraPath
from arfx.run.folder import JobFolder, write
from arfx.run.parameters import required_facts
from arfx.run.schedule import FrameRange
from arfx.run.source import clip_frames, keep_frame
from arfx.run.worker import Paths, done_work, frozen_job, keep_memory

LEAST_FRAMES = 120  # of a stretch: shorter ones would cost more than they save
_ROUNDING_S = 1e-9
Tick = Callable[[], None]


@dataclass(frozen=True)
class Span:
    """The frames between two times, seconds from the clip's first frame, ends included;
    None = no end. info : of the clip
    """

    info: ClipInfo
    start_s: float | None = None
    end_s: float | None = None

    def since_s(self, pts: int) -> float:
        return float((pts - self.info.start_pts) * self.info.time_base)

    def before(self, pts: int) -> bool:
        return (
            self.start_s is not None
            and self.since_s(pts) < self.start_s - _ROUNDING_S
        )

    def behind(self, pts: int) -> bool:
        return self.end_s is not None and self.since_s(pts) > self.end_s + _ROUNDING_S

    def nothing(self) -> NothingToDoError:
        """What is raised where it holds no frame."""
        end = "its end" if self.end_s is None else f"{self.end_s:g} s"
        return NothingToDoError(
            f"{self.info.path} has no frame between {max(self.start_s or 0.0, 0.0):g} s and"
            f" {end}",
            "check --start and --end; `arfx inspect` shows the clip's length",
        )


@dataclass(frozen=True)
class Stretch(FrameRange):
    """first, last : counted from the span's first frame, if all can be decoded
    begins, ends : time from which on its frames are, and the next one's; None = the clip's
    start, its end
    of : frames of all stretches;  careful : as of `ClipReader`"""

    begins: int | None
    ends: int | None
    of: int
    careful: bool = False


@dataclass(frozen=True)
class Stretches:
    """How a clip is cut. before : frames of the clip before the first one;  truncated : why
    it ends early, or None
    seeks : whether workers can begin anywhere, or only decode from the
    clip's start"""

    parts: tuple[Stretch, ...]
    before: int
    truncated: str | None
    seeks: bool


def cut(span: Span, times: FrameTimes | None) -> Stretches:
    """The stretches of a span.

    times : `ClipReader.times`. Raises NothingToDoError where it holds no frame.
    """
    if times is None or times.irregular:
        return whole(span)
    first = sum(map(span.before, times.pts))
    stop = len(times.pts) - sum(map(span.behind, times.pts))
    if first >= stop:
        raise span.nothing()
    borders = [first]
    for key in times.keys:
        k = bisect_left(times.pts, key)
        if k >= borders[-1] + LEAST_FRAMES and k + LEAST_FRAMES // 2 <= stop:
            borders.append(k)
    edges = [*borders, stop]
    parts = [
        Stretch(
            a - first,
            b - 1 - first,
            times.pts[a] if a else None,
            times.pts[b] if b < stop else None,
            stop - first,
        )
        for a, b in pairwise(edges)
    ]
    seeks = True
    if len(parts) > 1:
        with ClipReader(span.info, threads=1) as reader:
            seeks = reader.seeks_to(times.pts[borders[len(borders) // 2]])
    return Stretches(tuple(parts), first, times.truncated, seeks)


def whole(span: Span) -> Stretches:
    """One stretch: of a clip whose frames, or their times, tell themselves only when all
    are decoded.
    """
    info = span.info
    known = info.frame_count_stated or (
        round(info.duration_s * info.fps) if info.duration_s and info.fps else 0
    )
    frames = max(known, 1)
    part = Stretch(0, frames - 1, None, None, frames, careful=True)
    return Stretches((part,), 0, None, False)


@dataclass(frozen=True, eq=False)
class Context:
    """What a worker keeps between stretches of one job. wanted : facts, by name"""

    job: AnalysisJob
    wanted: Collection[str]
    span: Span


_contexts: dict[tuple[str, str], Context] = {}
_OPENING = threading.Lock()


def keep(folder: JobFolder, key: str, context: Context) -> None:
    """For the workers of this process."""
    _contexts.clear()
    _contexts[str(folder.path), key] = context


def open_context(path: str, key: str, paths: Paths) -> Context:
    """The context of a job. key : of its analysis; it keeps two jobs that reuse a folder apart"""
    with _OPENING:
        if (path, key) not in _contexts:
            _contexts.clear()
            _contexts[path, key] = _context(JobFolder(Path(path)), paths)
        return _contexts[path, key]


def _context(folder: JobFolder, paths: Paths) -> Context:
    """Without files of which a stretch needs nothing: where the markers lie, and the
    camera's poses, are asked for in the end.
    """
    config, info, inputs = frozen_job(folder, paths)
    job = AnalysisJob(
        config.markers,
        inputs.camera,
        config.params["analyse"],
        config.params["light"],
        anchor=config.model.anchor,
        poses=(
            None
            if config.input.poses is None
            else CameraPath(config.input.poses, (), None)
        ),  # that there are some
        prints=inputs.prints,
    )
    span = Span(info, config.input.start, config.input.end)
    return Context(job, required_facts(config), span)


def analyse_stretch(
    folder: str,
    key: str,
    stretch: Stretch,
    tick: Tick,
    alone: bool = False,
    paths: Paths = (),
) -> dict[str, Any]:
    """Analyse a stretch into a file of tables that appears when it is whole.

    alone : no other one is analysed meanwhile, so that decoding gets threads of its own
    Returns what `done_work` tells. Raises RenderError for a full disk, FrameTimesError where
    the clip cannot be cut."""
    keep_memory()
    context = open_context(folder, key, paths)
    try:
        tables, seconds = observe(context, stretch, tick, alone)
    except FrameDamageError:
        if stretch.begins is None:
            raise
        # a strict decoder that began in an open group may miss what it needs not
        tables, seconds = observe(context, stretch, tick, alone, seeks=False)
    file = JobFolder(Path(folder)).stretches / stretch.name(key)
    write(file, to_bytes(tables))
    return done_work(stretch, key, file, seconds)


class StretchEnd(NamedTuple):
    """How a stretch ended. before : frames of the clip that were decoded before the span;
    ended : it reaches the clip's end;  truncated : why early, or empty"""

    before: int
    ended: bool
    truncated: str


FRAMES = "frames"  # the table of their times


def observe(
    context: Context,
    stretch: Stretch,
    tick: Tick,
    alone: bool,
    seeks: bool = True,
) -> tuple[Tables, dict[str, float]]:
    """What the frames of a stretch show, and seconds: the tables of its `Observation`, of
    the frames' times, and of StretchEnd.

    seeks : else the clip is decoded from its start"""
    observation = Observation(context.job, context.wanted, stretch.of)
    pts = list[int]()
    end = StretchEnd(0, False, "")
    careful = stretch.careful
    strict = not careful and (stretch.begins is None or not alone)
    source = clip_frames(
        context.span.info, stretch.begins, alone, careful, strict, seeks
    )
    decoded_s, analyse_s = source.seconds, 0.0

    def check() -> None:
        if careful:
            return
        if source.reader.damaged:
            raise FrameDamageError(f"{context.span.info.path}: frames are damaged")
        if source.reader.repaired:
            raise FrameTimesError(
                f"{context.span.info.path}: frame times go backwards"
            )

    def frames() -> Generator[Frame]:
        nonlocal end
        for frame in source:
            check()
            if context.span.behind(frame.pts):
                return
            if context.span.before(frame.pts):
                end = end._replace(before=end.before + 1)
            else:
                yield frame
        check()
        end = end._replace(ended=True, truncated=source.reader.truncated or "")

    with contextlib.closing(frames()) as all_frames:
        frame = next(all_frames, None)
        while frame is not None:
            if stretch.ends is not None and frame.pts >= stretch.ends:
                source.put_back(frame, stretch.ends)
                break
            following = next(all_frames, None)
            start = time.perf_counter()
            luma = np.ascontiguousarray(frame.luma())
            after = None if following is None else following.luma
            index = stretch.first + len(pts)
            observation.step(AnalysisFrame(index, frame.time_s, luma, frame, after))
            analyse_s += time.perf_counter() - start
            pts.append(frame.pts)
            if not careful:
                keep_frame(frame)
            tick()
            frame = following
    rows = [*observation.rows(), end]
    tables = {**tables_of(rows), FRAMES: {"pts": np.array(pts)}}
    return tables, {"decode": source.seconds - decoded_s, "analyse": analyse_s}
