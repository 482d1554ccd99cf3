"""Which clips a batch has, the job of each, and what can be refused before any work."""

import glob
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from arfx.config.load import JobFile
from arfx.config.manifest import SUFFIXES, listed, read_manifest
from arfx.config.sections import JobConfig
from arfx.core.cost import load_prices
from arfx.core.guard import Guard
from arfx.core.naming import fixed_folder, named
from arfx.core.opener import folder_entries
from arfx.errors import ConfigError, InputError
from arfx.media.cameras import load_camera
from arfx.media.codecs import CLIP_SUFFIXES
from arfx.media.output import choose_format, names_sequence
from arfx.run.folder import JobFolder
from arfx.run.inputs import check_complete, job_model, output_settings
from arfx.run.outputs_made import OutputsMade, files_of
from arfx.run.parameters import make_stages, parameters
from arfx.run.place import default_folder, files_named, place
from arfx.run.predict import level_policy

Loader = Callable[[Sequence[JobFile]], JobConfig]


@dataclass(frozen=True, eq=False)
class BatchJob:
    """config : with its clip and its output;  root : the folder that all outputs of its
    pattern lie in
    """

    config: JobConfig
    clip: Path
    output: Path
    root: Path


def batch_jobs(
    inputs: Sequence[str], load_job: Loader, pattern: Path | None
) -> list[BatchJob]:
    """The jobs of manifests, folders, patterns and clips, in their order; a clip that is
    named twice beside a manifest is one.

    load_job : the job of files that are laid over those of the command line, but below its options
    pattern : of the outputs; one that a manifest names for a job comes before it, one that
    is in a job file after it
    Raises ConfigError, InputError: a manifest or a pattern that is wrong, or nothing found.
    """
    jobs: list[BatchJob] = []
    problems: list[str] = []
    clips = set[Path]()
    usual: JobConfig | None = None
    for text in inputs:
        path = Path(text)
        if path.suffix.lower() in SUFFIXES and not path.is_dir():
            for files in read_manifest(path, parameters()):
                try:
                    config = load_job(files)
                except ConfigError as e:
                    problems.append(str(e))
                    continue
                own = "path" in files[-1].document.get("output", {})
                jobs.append(
                    _job(
                        config,
                        config.input.clip,
                        config.output.path if own else pattern or config.output.path,
                    )
                )
            continue
        for clip in clips_at(text):
            if clip.absolute() not in clips:
                usual = usual or load_job([])
                jobs.append(_job(usual, clip, pattern or usual.output.path))
                clips.add(clip.absolute())
    if problems:
        raise ConfigError(listed(problems))
    if not jobs:
        raise InputError(
            f"no clip is in {', '.join(inputs)}",
            f"a file counts by its ending: {' '.join(sorted(CLIP_SUFFIXES))}",
        )
    return jobs


def _job(config: JobConfig, clip: Path | None, pattern: Path | None) -> BatchJob:
    assert clip is not None
    if pattern is None:
        raise ConfigError("no output is named", "-o 'out/{stem}.mp4'")
    output = named(pattern, clip, numbered=names_sequence(pattern))
    update = {
        "input": config.input.model_copy(update={"clip": clip}),
        "output": config.output.model_copy(update={"path": output}),
    }
    root = fixed_folder(pattern.parent if names_sequence(pattern) else pattern)
    return BatchJob(config.model_copy(update=update), clip, output, root)


def clips_at(text: str) -> list[Path]:
    """A clip; the clips in a folder, or that a pattern names: by their ending, without
    hidden ones and what batches have made. Raises InputError where a pattern or a folder
    holds nothing."""
    path = Path(text)
    if path.is_dir():
        found = folder_entries(path)
    elif glob.has_magic(text) and not os.path.lexists(path):
        found = [Path(p) for p in glob.iglob(text, recursive=True)]  # noqa: PTH207 - a pattern with a root of its own
    else:
        return [path]
    clips = [
        p
        for p in found
        if p.suffix.lower() in CLIP_SUFFIXES
        and not p.name.startswith(".")
        and p.is_file()
        and not (p.parent.name == "chunks" and JobFolder(p.parents[1]).job.exists())
    ]
    made = {
        p for folder in {p.parent for p in clips} for p in OutputsMade(folder).files()
    }
    clips = sorted(p for p in clips if p not in made)
    if path.is_dir():
        return clips
    once = {
        os.path.realpath(p): p for p in sorted(clips, key=lambda p: -len(p.parts))
    }  # links may lead round in circles
    return sorted(once.values())


def check_batch(jobs: Sequence[BatchJob], kept: bool) -> None:
    """Refuse, before any work, what would be lost or fails for all of them.

    kept : outputs that are there are not to be replaced
    Raises ConfigError, InputError."""
    prices = load_prices()
    for job in jobs:
        if "\0" in f"{job.clip}{job.output}":
            raise ConfigError(
                f"a name holds a NUL character: {str(job.clip)!r}, {str(job.output)!r}",
                "no file has such a name",
            )
        check_complete(job.config)
        choose_format(job.output, output_settings(job.config))
        level_policy(job.config, make_stages(job.config), prices)
    _check_distinct(jobs)
    guard = Guard({read for job in jobs for read in files_named(job.config)})
    for job in jobs:
        guard.check_not_read(place(job.output))
    if kept:
        _check_absent(jobs)
    first = jobs[0].config
    if all(job.config.model == first.model for job in jobs):
        job_model(first)
    if first.input.camera is not None and all(
        job.config.input.camera == first.input.camera for job in jobs
    ):
        load_camera(first.input.camera)


def _check_distinct(jobs: Sequence[BatchJob]) -> None:
    """Two jobs that write to one file, or images of two into one folder."""
    first: dict[str, BatchJob] = {}
    for job in jobs:
        real = os.path.normcase(os.path.realpath(place(job.output)))
        other = first.setdefault(real, job)
        if other is not job:
            raise ConfigError(
                f"{other.clip} and {job.clip} go to one output, {job.output}",
                "{stem} or {parent} in -o, or an output for each in the manifest, keeps"
                " them apart",
            )


def _check_absent(jobs: Sequence[BatchJob]) -> None:
    there = [job for job in jobs if files_of(job.output)]
    begun = [
        job for job in jobs if JobFolder(default_folder(job.output)).job.exists()
    ]
    if there or begun:
        what = (
            f"exist already, the first {there[0].output}"
            if there
            else f"were begun, the first {begun[0].output}"
        )
        raise ConfigError(
            f"{len(there or begun)} of {len(jobs)} outputs {what}",
            "--resume does what is missing, --overwrite does all anew",
        )


def home_of(jobs: Sequence[BatchJob]) -> Path:
    """The folder that holds all outputs. Raises ConfigError where there is none."""
    try:
        return Path(os.path.commonpath([_absolute(job.root) for job in jobs]))
    except ValueError:  # on several drives
        raise ConfigError(
            "the outputs have no folder in common",
            "--report DIR names a place for batch.json",
        ) from None


def names_of(jobs: Sequence[BatchJob]) -> Mapping[BatchJob, Path]:
    """A short relative path for each job, distinct: of its report and of its job folder,
    where folders are named for these.
    """
    home = home_of(jobs)
    places = [_absolute(place(job.output)).relative_to(home) for job in jobs]
    short = [
        p if names_sequence(job.output) else p.with_suffix("")
        for job, p in zip(jobs, places, strict=True)
    ]
    times = Counter(short)
    return {
        job: s if times[s] == 1 else p
        for job, s, p in zip(jobs, short, places, strict=True)
    }


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100 - without "..", links as they are
