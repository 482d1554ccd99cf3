"""Render one chunk, the unit of work.

A worker is sent a range, never pixels, and reads the rest from the job folder.
"""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any

from numpy import ndarray

from arfx.config.load import load
from arfx.config.sections import JobConfig
from arfx.core.camera import Camera
from arfx.core.codec import Document, Packed
from arfx.core.colour import Transfer, from_bt709
from arfx.core.facts import FrameFacts
from arfx.core.pixels import Plate
from arfx.core.plan import FramePlan, levels_of
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage
from arfx.media.clip import ClipInfo, probe
from arfx.media.depth_maps import DepthMaps
from arfx.media.frame import Frame
from arfx.media.output import OutputPlan
from arfx.media.writer import ChunkWriter, chunk_suffix, remove_output
from arfx.run.folder import JobFolder, Lines, content_digest, disk_error, save_preview
from arfx.run.frame import real_depth_layer, run_frame
from arfx.run.inputs import job_depth, job_model
from arfx.run.memory import peak_mb
from arfx.run.parameters import make_stages, parameters
from arfx.run.planned import ClipAnalysis
from arfx.run.schedule import FrameRange
from arfx.run.source import behind, job_frame

_OPENING = threading.Lock()  # what threads share is made once


@dataclass
class Context:
    """What a worker keeps between chunks of one job: the scene, and each stage at the
    levels that it has run at.
    """

    folder: JobFolder
    info: ClipInfo
    output: OutputPlan
    analysed: ClipAnalysis
    scene: Scene
    stages: dict[str, Stage]
    facts: Lines[FrameFacts]
    plans: Lines[FramePlan]
    depth: DepthMaps | None
    colours: ndarray | None
    ready: dict[tuple[str, str], ReadyStage] = field(default_factory=dict)

    def prepare(self, needed: Set[tuple[str, str]]) -> None:
        """Make stages ready at these levels. A chunk without work need not wait for
        another's preparation."""
        if needed <= self.ready.keys():
            return
        with _OPENING:
            for name, level in sorted(needed - self.ready.keys()):
                self.ready[name, level] = ReadyStage.of(
                    self.stages[name], self.scene, level
                )

    def rendered(
        self,
        frame: Frame,
        facts: FrameFacts,
        plan: FramePlan,
        seconds: Seconds,
        stages: Seconds,
    ) -> Frame:
        """The frame as its plan makes it. seconds, stages : are added to, by phase and stage"""
        if not plan.steps or plan.changed.empty:
            return frame
        plate, depth = Plate(plan.rect, frame.linear), None
        ready = {s.stage: self.ready[s.stage, s.level] for s in plan.steps}
        if self.depth is not None and any(
            "depth" in at.stage.facts for at in ready.values()
        ):
            with timed(seconds, "decode"):
                depth = real_depth_layer(
                    self.depth, facts, frame, self.scene.camera, plan.rect
                )
        result = run_frame(plate, facts, plan, ready, depth, self.colours)
        for name, s in result.seconds.items():
            stages[name] += s
        with timed(seconds, "edit"):
            out = result.onto(frame)
        seconds["edit"] += plate.seconds
        return out


Seconds = defaultdict[str, float]


@contextmanager
def timed(seconds: Seconds, phase: str) -> Iterator[None]:
    """Adds what the body takes."""
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[phase] += time.perf_counter() - start


@cache
def keep_memory() -> None:
    """Let the C library keep freed blocks: a frame's arrays are allocated for every frame,
    and faulting their pages in again costs more than the work on them. Without glibc
    nothing is changed.

    Call it before there are threads: all share one heap then, while heaps of their own, of
    at most 64 MB, are given back whenever one is empty, whatever the thresholds say."""
    import ctypes

    if os.name != "posix":
        return
    trim_threshold, mmap_threshold, arena_max = (
        -1,
        -3,
        -8,
    )  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX of malloc.h
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(mmap_threshold, 1 << 30)
        mallopt(trim_threshold, 1 << 30)
        mallopt(arena_max, 1)


# (section, key, path) of settings whose files this process sees elsewhere than the job file says
Paths = tuple[tuple[str, str, str], ...]


@cache
def process_name() -> str:
    """Of this machine and process, in names of files that several machines write into one
    folder.
    """
    return f"{re.sub('[^0-9A-Za-z]', '', socket.gethostname())[:32] or 'host'}-{os.getpid()}"


@dataclass(frozen=True)
class WorkerInputs(Document):
    """inputs.json: what workers are to know beside the job file.

    key : of the analysis;  prints : as of `Inputs`
    """

    key: str
    camera: Camera
    output: OutputPlan
    prints: Mapping[str, Annotated[ndarray, Packed("<f4", "f4")]]

    @staticmethod
    def read(folder: JobFolder) -> WorkerInputs:
        return WorkerInputs.from_line(folder.inputs.read_text(encoding="utf-8"))


def frozen_job(
    folder: JobFolder, paths: Paths
) -> tuple[JobConfig, ClipInfo, WorkerInputs]:
    """The job as its folder keeps it."""
    moved: dict[str, dict[str, str]] = {}
    for section, name, place in paths:
        moved.setdefault(section, {})[name] = place
    config = load(folder.job, moved, parameters())
    assert config.input.clip is not None
    info = probe(config.input.clip, Transfer(config.input.transfer))
    return config, info, WorkerInputs.read(folder)


@lru_cache(maxsize=1)
def open_context(path: str, job_key: str, paths: Paths) -> Context:
    """The context of a job. job_key only keeps two jobs that reuse a folder apart."""
    folder = JobFolder(Path(path))
    config, info, inputs = frozen_job(folder, paths)
    analysed = ClipAnalysis.read(folder)
    return Context(
        folder,
        info,
        inputs.output,
        analysed,
        analysed.scene(config, inputs.camera, job_model(config), folder),
        make_stages(config),
        Lines(folder.facts, FrameFacts.from_line, header=1),
        Lines(folder.plan, FramePlan.from_line),
        job_depth(config),
        from_bt709(info.primaries_tag),
    )


def render_chunk(
    folder: str,
    job_key: str,
    chunk: FrameRange,
    tick: Callable[[], None],
    alone: bool = False,
    paths: Paths = (),
) -> dict[str, Any]:
    """Render a chunk into a file that appears when it is whole.

    alone : no other chunk is rendered meanwhile, so that decoding and encoding get threads
    of their own
    Returns what `done_work` tells, and seconds by stage. Raises RenderError (frames missing in the
    source, a full disk, a stage that failed)."""
    keep_memory()
    with _OPENING:
        context = open_context(folder, job_key, paths)
    frames = slice(chunk.first, chunk.last + 1)
    facts, plans = context.facts[frames], context.plans[frames]
    decoded = context.analysed.frames
    seconds, stages = Seconds(float), Seconds(float)
    with timed(seconds, "prepare"):
        context.prepare(levels_of(plans))

    def encode(out: Frame) -> None:
        with timed(seconds, "encode"):
            writer.write(out)

    final = context.folder.chunks / chunk.name(job_key)
    suffix = chunk_suffix(context.output)
    aside = final.with_name(
        f"{process_name()}-{threading.get_ident()}-{final.name}{suffix}"
    )
    try:
        with ChunkWriter(context.output, context.info, aside) as writer:
            with behind(encode) if alone else nullcontext(encode) as put:
                for of_frame, plan in zip(facts, plans, strict=True):
                    with timed(seconds, "decode"):
                        frame = job_frame(
                            context.info, decoded, of_frame.index, alone
                        )
                    out = context.rendered(frame, of_frame, plan, seconds, stages)
                    if frame.index in context.analysed.previews:
                        previews = context.folder.previews
                        save_preview(previews, frame.index, frame, out)
                    put(out)
                    tick()
            closing = time.perf_counter()
        seconds["encode"] += time.perf_counter() - closing
        content = content_digest(aside)
        final = final.with_name(f"{final.name}.{content}{suffix}")
        if final.is_dir() and content_digest(final) == content:
            remove_output(aside)  # another worker's is there, and may be in use
        else:
            if final.is_dir():  # not what it was
                remove_output(final)
            aside.replace(final)
    except OSError as e:
        raise disk_error(e, final) from None
    return done_work(chunk, job_key, final, seconds, stages=stages)


def done_work(
    part: FrameRange, key: str, file: Path, seconds: Mapping[str, float], **more: Any
) -> dict[str, Any]:
    """What is told of a chunk or a stretch that is done: its file's place in the job folder,
    seconds, who did it, and the most memory that this process held.
    """
    thread, name = threading.current_thread(), f"{os.getpid()}"
    if thread is not threading.main_thread():  # it may not be the only one that works
        name = f"{name} {thread.name}"
    return {
        "key": part.name(key),
        "file": f"{file.parent.name}/{file.name}",
        "first": part.first,
        "last": part.last,
        "seconds": seconds,
        "rss_mb": peak_mb(),
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "worker": name,
        **more,
    }
