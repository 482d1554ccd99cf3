"""The analysis of one stretch of a clip, the unit of work: in any order, by any worker,
which leaves a file in the job folder.

Where a clip is cut depends on it alone: at key frames, so that a worker can begin to decode
there, at least LEAST_FRAMES apart. Every stretch is analysed as if nothing lay before it
(`arfx.analyse.observe`), and sees the first frame of the next one."""

import contextlib
import json
import os
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Collection, Generator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.observe import Observation
from arfx.analyse.tables import Tables, by_columns, to_bytes
from arfx.core.codec import Document, Packed
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
from arfx.run.memory import peak_mb
from arfx.run.parameters import required_facts
from arfx.run.source import clip_frames, keep_frame
from arfx.run.worker import Paths, frozen_job, keep_memory, who

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
class Stretch(Document):
    """first, last : its frames, counted from the span's first one, if all can be decoded
    begins, ends : time from which on its frames are, and the next one's; None = the clip's
    start, its end"""

    first: int
    last: int
    begins: int | None
    ends: int | None


@dataclass(frozen=True)
class Stretches(Document):
    """How a clip is cut. before : frames of the clip before the first one;  truncated : why
    it ends early, or None
    seeks : whether workers can begin anywhere, or only decode from the
    clip's start
    careful : in one thread (`ClipReader`)"""

    parts: tuple[Stretch, ...]
    before: int
    truncated: str | None
    seeks: bool
    careful: bool

    @property
    def frames(self) -> int:
        return self.parts[-1].last + 1


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
        )
        for a, b in pairwise(edges)
    ]
    seeks = True
    if len(parts) > 1:
        with ClipReader(span.info, threads=1) as reader:
            seeks = reader.seeks_to(times.pts[borders[len(borders) // 2]])
    return Stretches(tuple(parts), first, times.truncated, seeks, False)


def whole(span: Span) -> Stretches:
    """One stretch: of a clip whose frames, or their times, tell themselves only when all
    are decoded.
    """
    info = span.info
    known = info.frame_count_stated or (
        round(info.duration_s * info.fps) if info.duration_s and info.fps else 0
    )
    return Stretches(
        (Stretch(0, max(known - 1, 0), None, None),),
        0,
        None,
        False,
        True,
    )


@dataclass(frozen=True, eq=False)
class Context:
    """What a worker keeps between stretches of one job. wanted : facts, by name"""

    job: AnalysisJob
    wanted: Collection[str]
    span: Span
    stretches: Stretches


@dataclass(frozen=True)
class _Listed(Document):
    """stretches.json: what workers are to know beside the job.

    key : of the analysis;  prints : `AnalysisJob.prints`
    """

    key: str
    stretches: Stretches
    prints: Mapping[str, Annotated[ndarray, Packed("<f4", "f4")]]


_contexts: dict[tuple[str, str], Context] = {}
_OPENING = threading.Lock()


def keep(folder: JobFolder, key: str, context: Context) -> None:
    """For the workers of this process, and, in the folder, for those of others."""
    _contexts.clear()
    _contexts[str(folder.path), key] = context
    write(
        folder.stretch_list,
        json.dumps(_Listed(key, context.stretches, context.job.prints).to_json()),
    )


def listed(folder: JobFolder, key: str) -> bool:
    """Whether the folder says where the clip of this analysis is cut."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return bool(json.loads(folder.stretch_list.read_bytes())["key"] == key)
    return False


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
    config, info, camera, _ = frozen_job(folder, paths)
    kept = _Listed.from_line(folder.stretch_list.read_text(encoding="utf-8"))
    job = AnalysisJob(
        config.markers,
        camera,
        config.params["analyse"],
        config.params["light"],
        anchor=config.model.anchor,
        poses=(
            None
            if config.input.poses is None
            else CameraPath(config.input.poses, (), None)
        ),  # that there are some
        prints=kept.prints,
        frames=kept.stretches.frames,
    )
    return Context(
        job,
        required_facts(config),
        Span(info, config.input.start, config.input.end),
        kept.stretches,
    )


def analyse_stretch(
    folder: str,
    key: str,
    first: int,
    last: int,
    target: str,
    tick: Tick,
    alone: bool = False,
    paths: Paths = (),
) -> dict[str, Any]:
    """Analyse frames first … last into a file of tables that appears when it is whole.

    target : its path;  alone : no other one is analysed meanwhile, so that decoding gets
    threads of its own
    Returns the file's name, seconds, who analysed it, and the most memory that this process
    held. Raises RenderError for a full disk, FrameTimesError where the clip cannot be
    cut."""
    keep_memory()
    context = open_context(folder, key, paths)
    stretch = next(
        s for s in context.stretches.parts if (s.first, s.last) == (first, last)
    )
    try:
        tables, seconds = observe(context, stretch, tick, alone)
    except FrameDamageError:
        if stretch.begins is None:
            raise
        # a strict decoder that began in an open group may miss what it needs not
        tables, seconds = observe(context, stretch, tick, alone, seeks=False)
    write(Path(target), to_bytes(tables))
    return {
        "file": Path(target).name,
        "first": first,
        "last": last,
        "seconds": seconds,
        "pid": os.getpid(),
        "rss_mb": peak_mb(),
        **who(),
    }


class StretchFrame(NamedTuple):
    """A frame of a stretch. frame : from 0;  key : decoding can begin there"""

    frame: int
    pts: int
    key: bool


class StretchEnd(NamedTuple):
    (
        """How a stretch ended. before : frames of the clip that were decoded before the span;
    ended : it reaches the clip's end;  truncated : why early, or """
        ""
    )

    before: int
    ended: bool
    truncated: str


FRAMES, END = "stretch/frames", "stretch/end"


def observe(
    context: Context,
    stretch: Stretch,
    tick: Tick,
    alone: bool,
    seeks: bool = True,
) -> tuple[Tables, dict[str, float]]:
    """What the frames of a stretch show, and seconds: the tables of its `Observation`, and of
    StretchFrame and StretchEnd.

    seeks : else the clip is decoded from its start"""
    observation = Observation(context.job, context.wanted)
    shown = list[StretchFrame]()
    end = StretchEnd(0, False, "")
    careful = context.stretches.careful
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

    def step(frame: Frame, following: Frame | None) -> None:
        luma = np.ascontiguousarray(frame.luma())
        after = None if following is None else following.luma
        index = stretch.first + len(shown)
        observation.step(AnalysisFrame(index, frame.time_s, luma, frame, after))

    with contextlib.closing(frames()) as all_frames:
        frame = next(all_frames, None)
        while frame is not None:
            if stretch.ends is not None and frame.pts >= stretch.ends:
                source.put_back(frame, stretch.ends)
                break
            following = next(all_frames, None)
            start = time.perf_counter()
            step(frame, following)
            analyse_s += time.perf_counter() - start
            shown.append(StretchFrame(len(shown), frame.pts, frame.key))
            if not careful:
                keep_frame(frame)
            tick()
            frame = following
    tables = {
        **observation.tables(),
        FRAMES: by_columns(shown, StretchFrame),
        END: by_columns([end], StretchEnd),
    }
    return tables, {"decode": source.seconds - decoded_s, "analyse": analyse_s}
