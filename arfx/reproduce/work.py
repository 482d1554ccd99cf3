"""Scenes, jobs and times for the papers' modules: synthetic clips, whole jobs under any settings,
single frames of them.

Everything lies in a temporary folder. What two items need is made once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.config.load import load, merge
from arfx.config.sections import JobConfig
from arfx.core import interrupt
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.stage import Stage
from arfx.core.waiting import Notice, Progress
from arfx.errors import RenderError
from arfx.measure.steps import Chain, FrameRenderer, open_frames
from arfx.measure.timing import WALL
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.papers import FORMULAS, PAPER
from arfx.run.folder import JobFolder
from arfx.run.inputs import open_inputs
from arfx.run.job import Options, plan_job, process
from arfx.run.memory import peak_mb
from arfx.run.parameters import parameters
from arfx.run.planned import Job
from arfx.synth.clip import make_clip
from arfx.synth.description import SceneFile, parse_scene

Settings = Mapping[str, Mapping[str, Any]]  # of a job file: section, key, value
DEFAULTS: Settings = {}
# by the printed methods
AS_PRINTED: Settings = {name: {"formula": PAPER} for name in FORMULAS[PAPER]}
# GLB, y up, about one unit wide: teapot, apple and aeroplane of table 1 of Tan, Chen, Sun 2009;
# teapot, cube and rabbit of figure 5 of Jia, Tang 2013; what shows indirect light, and blur
MODELS = Path(__file__).with_name("models")
SCENES = Path(__file__).with_name("scenes")
# of a timed job: rendered before, so that imports, compiled code and first contacts are not
# counted
WARM_FRAMES = 2


class Clip(NamedTuple):
    """A synthetic clip. folder : clip, camera, model, job.toml and truth (`arfx synth`);
    scene : what it shows
    """

    folder: Path
    scene: SceneFile

    def frames(self) -> list[ndarray]:
        """Every frame, (h, w, 3) uint8 R'G'B'."""
        with ClipReader(probe(self.folder / self.scene.clip.file)) as reader:
            return [frame.rgb8() for frame in reader.frames()]


class Timed(NamedTuple):
    """frames_per_s : decoding, analysing, rendering and encoding by one worker; start-up,
    planning and what is prepared once per
    clip left out;  stage_s : seconds a frame by stage;  peak_mb : most memory of the
    process;  start_mb : before the job
    """

    frames_per_s: float
    stage_s: dict[str, float]
    peak_mb: float
    start_mb: float


class Shot(NamedTuple):
    """One frame of a planned job, ready to be rendered step by step.

    chain : all its steps, at the job's levels
    """

    job: Job
    renderer: FrameRenderer
    chain: Chain

    @property
    def facts(self) -> FrameFacts:
        return self.renderer.facts

    @property
    def light(self) -> Light:
        return self.job.scene.light_of(self.facts)

    @property
    def stages(self) -> dict[str, Stage]:
        return {stage.name: stage for stage, _ in self.chain}

    def picture(self) -> ndarray:
        """(h, w, 3) uint8 sRGB of the whole frame after all steps."""
        return self.renderer.image(self.chain)

    def layer(self, name: Layer) -> ndarray:
        return self.renderer.layer(self.chain, name)

    def up_to(self, stage: str) -> Chain:
        return self.chain[: list(self.stages).index(stage) + 1]

    def with_stage(self, stage: Stage) -> Shot:
        """The same with this one in place of the job's of its name."""
        steps = (
            (stage if own.name == stage.name else own, at) for own, at in self.chain
        )
        return self._replace(chain=tuple(steps))


@dataclass
class Work:
    """folder : for whatever is made;  short : small pictures, few frames and repeats: times
    then mean nothing
    """

    folder: Path
    short: bool = False
    progress: Progress = lambda phase, done, total: None
    notice: Notice = lambda message: None
    _planned: dict[str, Job] = field(default_factory=dict)

    def scaled(self, full: Any, short: Any) -> Any:
        """A size or count, by how much is wanted."""
        return short if self.short else full

    def clip(self, scene: SceneFile) -> Clip:
        """The same scene is made once."""
        folder = self.folder / f"clip-{_digest(scene.model_dump_json())}"
        if not folder.exists():
            make_clip(scene, folder, self._checked, truth_pictures=False)
        return Clip(folder, scene)

    def model(self, name: str) -> str:
        """Path of one of the models beside this module, for settings: {"model": {"file":
        work.model("cube"), "fit": "12cm"}}
        """
        return str(MODELS / f"{name}.glb")

    def planned(self, clip: Clip, settings: Settings = DEFAULTS) -> Job:
        """The job analysed and planned, nothing rendered."""
        key = f"plan-{_digest(str(clip.folder), settings)}"
        if key not in self._planned:
            folder = JobFolder(self.folder / key)
            folder.open(resume=False)
            config = _config(clip.folder, settings, self.folder / "out.mkv")
            options = Options(
                overwrite=True, progress=self.progress, notice=self.notice
            )
            self._planned[key] = plan_job(open_inputs(config), folder, options)
        return self._planned[key]

    def shot(self, clip: Clip, settings: Settings = DEFAULTS, index: int = 0) -> Shot:
        """One frame of the clip under these settings, in which the object is seen."""
        job = self.planned(clip, settings)
        frame = open_frames(job, [index])[index]
        levels = {s.stage: s.level for s in frame.plan.steps}
        return Shot(job, frame, frame.chain(levels))

    def timed(self, clip: Clip, settings: Settings) -> Timed:
        """The whole job in a process of its own, so that its memory is its own; in the
        short form in this.
        """
        own = clip.folder, clip.scene.clip.fps, settings
        if self.short:
            return timed_job(*own)
        timed: Timed = self.apart(timed_job, *own)
        return timed

    def apart(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a module's function returns in a new process; arguments and result can be
        pickled. Raises RenderError where the process dies."""
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor
        from concurrent.futures.process import BrokenProcessPool

        with ProcessPoolExecutor(
            1, multiprocessing.get_context("spawn"), interrupt.in_worker
        ) as pool:
            with interrupt.starting_workers():
                running = pool.submit(function, *arguments)
            try:
                return running.result()
            except BrokenProcessPool:
                raise RenderError(
                    "a process that measures was killed (out of memory?)",
                    "give it more memory",
                ) from None

    def _checked(self, phase: str, done: int, total: int | None) -> None:
        interrupt.check()
        self.progress(phase, done, total)


def scene_named(name: str, **parts: Any) -> SceneFile:
    """One of the scenes beside this module. parts : that it names in braces"""
    text = (SCENES / f"{name}.toml").read_text(encoding="utf-8")
    return parse_scene(text.format(**parts), name)


def median_s(work: Callable[[], Any], repeats: int = 5) -> float:
    """Median wall-clock time of `repeats` runs, after one that is not counted; less what
    numba compiles.
    """
    work()
    return float(np.median([WALL.of(work) for _ in range(repeats)]))


def timed_job(folder: Path, fps: float, settings: Settings) -> Timed:
    """Runs the job of a clip's folder in the process that it is called in. The clip's first
    frames are processed once before, so that nothing is imported, compiled or loaded while
    time is taken. fps : of the clip"""
    start_mb = peak_mb()
    report = dict[str, Any]()
    for more in ({"input": {"end": f"{(WARM_FRAMES - 0.5) / fps}s"}}, {}):
        config = _config(folder, merge(settings, more), folder.parent / "timed.mkv")
        report = process(
            config, Options(overwrite=True, workers=1, notice=lambda message: None)
        )
        interrupt.resume()
    spent = report["timing"]
    frames = report["output"]["frames"]
    phases = ("decode", "analyse", "render", "encode")
    seconds = sum(spent[f"{phase}_s"] for phase in phases)
    stages = {
        s["name"]: s["measured_s"] / frames
        for s in report["stages"]
        if s["frames_run"]
    }
    return Timed(frames / seconds, stages, peak_mb(), start_mb)


def _config(folder: Path, settings: Settings, output: Path) -> JobConfig:
    lossless = {"output": {"path": str(output), "codec": "ffv1"}}
    return load(folder / "job.toml", merge(settings, lossless), parameters())


def _digest(*parts: Any) -> str:
    text = json.dumps(parts, default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
