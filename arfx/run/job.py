"""The main job: analyse, plan, render, join, report."""

import contextlib
import json
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from arfx.analyse.job import MARKER, Analysis, AnalysisJob
from arfx.analyse.tables import to_bytes
from arfx.config.sections import JobConfig, frozen
from arfx.core import interrupt
from arfx.core.compiled import telling, work_clock
from arfx.core.cost import load_prices
from arfx.core.facts import read_facts, write_facts
from arfx.core.machine import usable_cores
from arfx.core.plan import FramePlan
from arfx.core.scene import Scene
from arfx.core.stage import Stage
from arfx.core.toml_text import to_toml
from arfx.core.waiting import Notice, Progress, wait_for
from arfx.errors import JobInterruptedError, counted
from arfx.media.join import join_chunks
from arfx.media.output import check_times
from arfx.media.writer import chunk_suffix
from arfx.plan.errors import errors_of_clip, shipped_errors
from arfx.run.analysis import Run, analyse_clip
from arfx.run.cluster.spec import ClusterSpec, PathMap
from arfx.run.cluster.start import Cluster, open_cluster
from arfx.run.executors import (
    Done,
    Processes,
    Results,
    Task,
    Work,
    run_serial,
    run_threads,
)
from arfx.run.folder import MARK, JobFolder, Lines, disk_error, pick_previews, write
from arfx.run.inputs import Inputs, make_scene, open_inputs
from arfx.run.keys import job_keys
from arfx.run.model_size import check_size
from arfx.run.parameters import light_method, make_stages, required_facts
from arfx.run.place import Places
from arfx.run.planned import MAPS, ClipAnalysis, Job, JobPlan, places_in_words
from arfx.run.predict import JobSize, choose, level_policy
from arfx.run.schedule import Chunk, borders, find_chunk
from arfx.run.source import frames_kept
from arfx.run.stretches import analyse_stretch
from arfx.run.summary import build_report
from arfx.run.times import CHUNK, TimeSpent, WorkLog
from arfx.run.worker import keep_memory, render_chunk

# 160 frames of 720p: about as long as it takes to start a process and load its kernels
SHORT_JOB_PX = 150_000_000
# beyond this many, threads wait for each other in the interpreter: processes instead
MOST_THREADS = 4


@dataclass
class Options:
    """How a job is run; none of it changes a pixel.

    folder : of the job, None = beside the output, and removed when all is done
    report : folder of the job's report, which `finish` writes: checked and locked as the
    other places are
    finish(job folder) : called when the output is there, before its folder is given back
    workers : processes, None = one for a short job, else one per core
    executor : a cluster in place of processes;  map_path : where its workers see what this
    machine has
    progress(phase, frames done, frames in all or None);  notice(message) for warnings
    processes : those that work"""

    folder: Path | None = None
    resume: bool = False
    overwrite: bool = False
    workers: int | None = 1
    report: Path | None = None
    finish: Callable[[Path], object] | None = None
    executor: ClusterSpec | None = None
    map_path: Sequence[PathMap] = ()
    progress: Progress = lambda phase, done, total: None
    notice: Notice = print
    processes: Processes = field(default_factory=Processes)


def process(config: JobConfig, options: Options) -> dict[str, Any]:
    """Run a whole job. Returns the report (report.json), which the job folder holds too.

    Raises ArfxError of every kind; after JobInterruptedError and RenderError the folder can
    be resumed."""
    started = work_clock()
    keep_memory()
    if (options.workers or 1) > 1 and options.executor is None:
        options.processes.prepare()
    inputs = open_inputs(config, options.progress)
    for notice in inputs.notices:
        options.notice(notice)
    places = Places(inputs, options.folder, options.report, options.overwrite)
    folder = places.folder
    with (
        places.held(options.resume),
        _interruptible(folder) as check,
        telling(options.notice),
        open_cluster(options.executor, options.map_path, options.notice) as cluster,
        frames_kept(),
    ):

        def progress(
            phase: str,
            done: int,
            total: int | None,
            report: Progress = options.progress,
        ) -> None:
            check()
            report(phase, done, total)

        options = replace(options, progress=progress)
        with options.processes:
            job = plan_job(inputs, folder, options, started, cluster)
            chunks = _chunks(job)
            files = _render(job, chunks, options, cluster)
        start = time.perf_counter()
        if left_out := _join(job, files, places):
            options.notice(
                "damaged packets of sound, subtitles or data that were left out:"
                f" {left_out}"
            )
        report = build_report(job, chunks, time.perf_counter() - start)
        write(folder.report, json.dumps(report, indent=1))
        folder.clear("chunks")
        folder.clear("stretches")
        del job, chunks, files  # the page reads the facts again
        if options.finish is not None:
            options.finish(folder.path)
        folder.placed.unlink(missing_ok=True)
    return report


def worker_count(pixels: int, stated: int | None = None) -> tuple[int, bool]:
    """How many workers, and whether they are threads of this process: as many processes as
    stated, else one per usable core.

    Threads where the cores are few; else processes, but only one for a short job, in which
    starting others would take longer than they save. pixels : of all frames"""
    if stated is not None:
        return stated, False
    cores = usable_cores()
    if cores <= MOST_THREADS:
        return cores, True
    return (cores if pixels > SHORT_JOB_PX else 1), False


def plan_job(
    inputs: Inputs,
    folder: JobFolder,
    options: Options,
    started: float | None = None,
    cluster: Cluster | None = None,
) -> Job:
    """Analyse (or resume that) and plan. started : `work_clock` when the work began; None = now"""
    config = inputs.config
    log = WorkLog(folder.timings, work_clock() if started is None else started)
    analysis_key, job_key = job_keys(inputs)
    stages, prices = make_stages(config), load_prices()
    policy = level_policy(config, stages, prices)
    errors = (
        shipped_errors()
        if config.pipeline.tradeoff is None
        else errors_of_clip(config.pipeline.tradeoff)
    )
    write(folder.job, MARK + to_toml(frozen(config)))
    write(
        folder.inputs,
        json.dumps(
            {"camera": inputs.camera.to_json(), "output": inputs.output.to_json()}
        ),
    )
    fresh = not folder.sealed(job_key)
    if fresh:
        folder.unseal()
        folder.clear("chunks/")  # another plan may choose other levels
        _analyse(inputs, folder, analysis_key, options, log, cluster)
    analysed, facts = ClipAnalysis.read(folder), list(read_facts(folder.facts))
    scene = analysed.scene(config, inputs.camera, inputs.model, folder)
    start = work_clock()
    if fresh:
        workers = options.workers if cluster is None else cluster.workers
        size = _size(inputs, analysed, stages, log.spent(analysis_key, []), workers)
        notices: list[str] = []
        plans, document = wait_for(
            "plan",
            lambda: choose(
                config,
                stages,
                facts,
                scene,
                policy,
                errors,
                prices,
                size,
                notices.append,
            ),
            options.progress,
        )
        for notice in notices:
            options.notice(notice)
        write(folder.plan_summary, json.dumps(document, indent=1))
        write(folder.plan, (json.dumps(p.to_json()) + "\n" for p in plans))
        folder.seal(job_key)
    document = json.loads(folder.plan_summary.read_text(encoding="utf-8"))
    plans = Lines(folder.plan, FramePlan.from_line)[:]
    plan = JobPlan(
        plans, document["levels"], document["predicted"], work_clock() - start
    )
    return Job(
        inputs,
        folder,
        job_key,
        analysis_key,
        analysed,
        facts,
        scene,
        stages,
        prices,
        plan,
        log,
    )


def _size(
    inputs: Inputs,
    analysed: ClipAnalysis,
    stages: Mapping[str, Stage],
    spent: TimeSpent,
    stated: int | None,
) -> JobSize:
    frames, area_px = len(analysed.pts), inputs.camera.rect.area
    workers, threads = worker_count(frames * area_px, stated)
    workers = max(min(workers, len(borders(frames))), 1)
    return JobSize(
        frames,
        area_px / 1e6,
        spent.seconds.get("decode", 0.0),
        spent.wall_s,
        inputs.output.codec,
        workers,
        0 if threads or workers == 1 else workers,
        inputs.model.face_count / 1e6,
        frozenset(
            name
            for name, stage in stages.items()
            if type(stage).health is not Stage.health
        ),
    )


def _analyse(
    inputs: Inputs,
    folder: JobFolder,
    analysis_key: str,
    options: Options,
    log: WorkLog,
    cluster: Cluster | None = None,
) -> None:
    config, anchor = inputs.config, inputs.config.model.anchor

    def scene_of(clip: Analysis) -> Scene:
        return make_scene(
            config,
            inputs.camera,
            inputs.model,
            clip.world_from_marker,
            clip.anchor.key,
            clip.static,
        )

    job = AnalysisJob(
        config.markers,
        inputs.camera,
        config.params["analyse"],
        config.params["light"],
        inputs.marker_map,
        inputs.panorama,
        anchor,
        inputs.depth,
        config.input.depth_align == anchor == MARKER,
        inputs.poses,
        scene_of,
        options.progress,
        light_method(config),
        inputs.prints,
    )
    span = (config.input.start, config.input.end)

    done = analyse_clip(
        inputs.info,
        job,
        required_facts(config),
        span,
        options.progress,
        folder,
        analysis_key,
        log,
        _run(analyse_stretch, inputs, folder, analysis_key, options, cluster),
    )
    clip = done.analysis
    check_times(inputs.output, done.pts, inputs.info.time_base)
    seen, notices = clip.summary["markers_seen"], list(clip.notices)
    if anchor == MARKER:
        notices += [
            f"marker {m.key} was never seen"
            for m in config.markers
            if not seen.get(m.key)
        ]
    if done.truncated:
        notices.append(done.truncated)
    if done.damaged and not done.missing:
        notices.append(
            f"{inputs.info.path}: packets are damaged, lost or joined: what a frame lacks"
            " is the decoder's guess"
        )
    if done.missing:
        count = counted(sum(count for _, count in done.missing), "frames")
        notices.append(
            f"{inputs.info.path}: {count} missing, damaged or not in the file:"
            f" {places_in_words(done.missing)}"
        )
    notices += check_size(scene_of(clip), clip.facts)
    for notice in notices:
        options.notice(notice)
    write_facts(folder.facts, clip.facts)
    write(folder.environment, to_bytes({MAPS: dict(clip.environment_maps)}))
    ClipAnalysis(
        done.pts,
        done.keys,
        clip.anchor.key,
        clip.world_from_marker,
        clip.static,
        clip.summary,
        done.truncated,
        pick_previews(clip.facts),
        [*inputs.notices, *notices],
        clip.real_planes,
        done.careful,
        done.missing,
        done.damaged,
    ).write(folder)


def _run(
    work: Work,
    inputs: Inputs,
    folder: JobFolder,
    key: str,
    options: Options,
    cluster: Cluster | None,
) -> Run:
    """What has tasks done, by this machine's workers or a cluster's. key : of what is done"""

    def run_here(tasks: Sequence[Task], frames: int, progress: Done) -> Results:
        pixels = frames * inputs.camera.rect.area
        workers, threads = worker_count(pixels, options.workers)
        if min(workers, len(tasks)) <= 1:
            return run_serial(tasks, progress, work)
        parallel = run_threads if threads else options.processes.run
        return parallel(tasks, workers, progress, work)

    if cluster is None:
        return run_here
    return cluster.run(inputs, folder, key, work is render_chunk, run_here)


def _chunks(job: Job) -> list[Chunk]:
    return [Chunk(first, last, job.key) for first, last in borders(len(job.facts))]


def _render(
    job: Job, chunks: list[Chunk], options: Options, cluster: Cluster | None = None
) -> list[Path]:
    """The chunks' files, in order; those that are there already are kept."""
    folder, suffix = job.folder, chunk_suffix(job.inputs.output)
    files = {c.first: find_chunk(folder.chunks, c.name, suffix) for c in chunks}
    todo = [c for c in chunks if files[c.first] is None]
    names, total = {c.first: c.name for c in todo}, len(job.facts)
    tasks: list[Task] = [
        (str(folder.path), job.key, c.first, c.last, str(folder.chunks / c.name))
        for c in todo
    ]

    def progress(done: int) -> None:
        options.progress("render", total - sum(c.frames for c in todo) + done, total)

    progress(0)
    run = _run(render_chunk, job.inputs, folder, job.key, options, cluster)
    # an error here too stops the workers
    with contextlib.closing(run(tasks, total, progress)) as results:
        for result in results:
            files[result["first"]] = folder.chunks / result["file"]
            job.log.note(CHUNK, names[result["first"]], **result)
    progress(sum(c.frames for c in todo))
    return [path for path in files.values() if path is not None]


def _join(job: Job, files: Sequence[Path], places: Places) -> int:
    output, section = job.inputs.output, job.inputs.config.input

    def before_moving() -> None:
        places.check_output()  # again: rendering took its time
        job.folder.record_outputs(places.part)

    try:
        return join_chunks(
            files,
            job.analysed.pts,
            output,
            job.inputs.info,
            output.path,
            section.start,
            section.end,
            places.part,
            before_moving,
        )
    except OSError as e:
        raise disk_error(e, output.path) from None


@contextlib.contextmanager
def _interruptible(folder: JobFolder) -> Iterator[Callable[[], None]]:
    """Signals and disk errors in the body become one message. Yields a check to be called often."""
    with interrupt.catching((signal.SIGINT,)):
        try:
            interrupt.resume()
            yield interrupt.check
        except (KeyboardInterrupt, Exception) as e:
            if interrupt.pending() or isinstance(
                e, KeyboardInterrupt
            ):  # whatever a library has made of it
                error = JobInterruptedError(
                    f"{interrupt.cause()}; what is done is kept in {folder.path}",
                    "the same command with --resume goes on",
                )
                error.exit_code = interrupt.exit_code() or error.exit_code
                raise error from None
            if isinstance(e, OSError):
                raise disk_error(
                    e, Path(e.filename) if e.filename else folder.path
                ) from None
            raise
