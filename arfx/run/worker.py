"""Render one chunk, the unit of work.

A worker is sent a range, never pixels, and reads the rest from the job folder.
"""

import json
import os
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from numpy import ndarray

from arfx.config.load import load
from arfx.config.sections import JobConfig
from arfx.core.camera import Camera
from arfx.core.colour import Transfer, from_bt709
from arfx.core.facts import FrameFacts
from arfx.core.pixels import Plate
from arfx.core.plan import FramePlan, levels_of
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, Stage
from arfx.errors import RenderError
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


def frozen_job(
    folder: JobFolder, paths: Paths
) -> tuple[JobConfig, ClipInfo, Camera, OutputPlan]:
    """The job as its folder keeps it."""
    moved: dict[str, dict[str, str]] = {}
    for section, name, place in paths:
        moved.setdefault(section, {})[name] = place
    config = load(folder.job, moved, parameters())
    inputs = json.loads(folder.inputs.read_text(encoding="utf-8"))
    assert config.input.clip is not None
    return (
        config,
        probe(config.input.clip, Transfer(config.input.transfer)),
        Camera.from_json(inputs["camera"]),
        OutputPlan.from_json(inputs["output"]),
    )


@lru_cache(maxsize=1)
def open_context(path: str, job_key: str, paths: Paths) -> Context:
    """The context of a job. job_key only keeps two jobs that reuse a folder apart."""
    folder = JobFolder(Path(path))
    config, info, camera, output = frozen_job(folder, paths)
    analysed = ClipAnalysis.read(folder)
    return Context(
        folder,
        info,
        output,
        analysed,
        analysed.scene(config, camera, job_model(config), folder),
        make_stages(config),
        Lines(folder.facts, FrameFacts.from_line, header=1),
        Lines(folder.plan, FramePlan.from_line),
        job_depth(config),
        from_bt709(info.primaries_tag),
    )


def render_chunk(
    folder: str,
    job_key: str,
    first: int,
    last: int,
    target: str,
    tick: Callable[[], None],
    alone: bool = False,
    paths: Paths = (),
) -> dict[str, Any]:
    """Render frames first … last into a file that appears when it is whole.

    target : its path, to which the digest of its content and the extension are added
    alone : no other chunk is rendered meanwhile, so that decoding and encoding get threads
    of their own
    Returns the file's name, seconds by stage, decode and encode seconds, who rendered it,
    and the most memory that this process held. Raises RenderError (frames missing in the
    source, a full disk, a stage that failed)."""
    keep_memory()
    with _OPENING:
        context = open_context(folder, job_key, paths)
    analysed = context.analysed
    facts = {f.index: f for f in context.facts[first : last + 1]}
    plans = {p.index: p for p in context.plans[first : last + 1]}
    start = time.perf_counter()
    needed = levels_of(plans.values())
    if (
        needed - context.ready.keys()
    ):  # a chunk without work need not wait for another's preparation
        with _OPENING:
            for name, level in sorted(needed - context.ready.keys()):
                context.ready[name, level] = ReadyStage.of(
                    context.stages[name], context.scene, level
                )
    seconds: dict[str, float] = {
        "prepare": time.perf_counter() - start,
        "decode": 0.0,
        "edit": 0.0,
        "encode": 0.0,
    }
    stage_seconds: dict[str, float] = {}

    def encode(out: Frame) -> None:
        start = time.perf_counter()
        writer.write(out)
        seconds["encode"] += time.perf_counter() - start

    final, suffix = Path(target), chunk_suffix(context.output)
    aside = final.with_name(
        f"{process_name()}-{threading.get_ident()}-{final.name}{suffix}"
    )
    try:
        with ChunkWriter(context.output, context.info, aside) as writer:
            with behind(encode) if alone else nullcontext(encode) as put:
                for index in range(first, last + 1):
                    start = time.perf_counter()
                    frame = job_frame(
                        context.info, analysed.pts, index, alone, analysed.careful
                    )
                    seconds["decode"] += time.perf_counter() - start
                    if frame is None:
                        raise RenderError(
                            f"{context.info.path}: frame {index} could not be decoded again"
                            " where the analysis saw it",
                            "the file has changed, or seeking in it is broken: copy it to"
                            " another container and try again",
                        )
                    out = _frame(
                        context,
                        frame,
                        facts[index],
                        plans[index],
                        seconds,
                        stage_seconds,
                    )
                    if index in analysed.previews:
                        save_preview(context.folder.previews, index, frame, out)
                    put(out)
                    tick()
            start = time.perf_counter()
        seconds["encode"] += time.perf_counter() - start
        content = content_digest(aside)
        final = final.with_name(f"{final.name}.{content}{suffix}")
        if (
            final.is_dir() and content_digest(final) == content
        ):  # another worker's, of the same images: it may be in use
            remove_output(aside)
        else:
            if final.is_dir():  # not what it was
                remove_output(final)
            aside.replace(final)
    except OSError as e:
        raise disk_error(e, final) from None
    return {
        "file": final.name,
        "first": first,
        "last": last,
        "seconds": seconds,
        "stages": stage_seconds,
        "rss_mb": peak_mb(),
        **who(),
    }


def who() -> dict[str, str]:
    """Of this worker: its host, and the process's number, with the thread's name where it
    is not the only one that works.
    """
    thread = threading.current_thread()
    name = (
        f"{os.getpid()}"
        if thread is threading.main_thread()
        else f"{os.getpid()} {thread.name}"
    )
    return {"host": socket.gethostname(), "worker": name}


def _frame(
    context: Context,
    frame: Frame,
    facts: FrameFacts,
    plan: FramePlan,
    seconds: dict[str, float],
    stage_seconds: dict[str, float],
) -> Frame:
    if not plan.steps or plan.changed.empty:
        return frame
    plate = Plate(plan.rect, frame.linear)
    depth = None
    if context.depth is not None and any(
        "depth" in context.stages[s.stage].facts for s in plan.steps
    ):
        start = time.perf_counter()
        depth = real_depth_layer(
            context.depth, facts, frame, context.scene.camera, plan.rect
        )
        seconds["decode"] += time.perf_counter() - start
    ready = {s.stage: context.ready[s.stage, s.level] for s in plan.steps}
    result = run_frame(plate, facts, plan, ready, depth, context.colours)
    for name, s in result.seconds.items():
        stage_seconds[name] = stage_seconds.get(name, 0.0) + s
    start = time.perf_counter()
    out = result.onto(frame)
    seconds["edit"] += time.perf_counter() - start + plate.seconds
    return out
