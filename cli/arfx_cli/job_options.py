"""The options that `process`, `plan` and `tradeoff` share, and how they become a job.

Those of a job file's sections are made from its fields; this module has those of stages,
and of how a job is run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from arfx.config.sections import JobConfig, Setting, settings
from arfx_cli.console import TABLE, Progress, note, parameter

if TYPE_CHECKING:
    from arfx.config.load import JobFile
    from arfx.run.job import Options


def job_options() -> list[click.Parameter]:
    """What a job is, where it goes and how it is run: the parameters of a command."""
    made = [_parameter(s) for s in settings()]
    return made + [parameter(**row) for row in TABLE["job"]["parameter"]]


def _parameter(s: Setting) -> click.Parameter:
    kind: Any = None
    if Path in s.kinds:
        kind = "path" if s.metavar == "PATH" else "file"
    elif float in s.kinds:  # the job checks its limits
        kind = click.FLOAT
    elif list[str] not in s.kinds:
        kind = next((get_args(k) for k in s.kinds if get_origin(k) is Literal), None)
    if not s.flags[0].startswith("-"):
        return parameter(s.name, kind, required=False)
    return parameter(
        " ".join(s.flags),
        kind,
        metavar=s.metavar,
        multiple=s.repeated,
        # with False, click takes the -1 of --crf -1 for an option
        is_flag=True if bool in s.kinds else None,
        help=s.help,
    )


def job_config(given: dict[str, Any], more: Sequence[JobFile] = ()) -> JobConfig:
    """The typed job from the parsed options.

    more : files over those of --config. Raises ConfigError.
    """
    from arfx.config.given import overrides, section_overrides
    from arfx.config.load import find_job_file, load
    from arfx.run.parameters import parameters, pipeline
    from arfx.stages import STAGES

    kinds, options = parameters(), [*section_overrides(given)]
    places = {
        "light": [("light", "given")],
        "environment": [("light", "environment")],
        "formula": [
            (n, "formula") for n, formulas in kinds.items() if len(formulas) > 1
        ],
    }
    for option, paths in places.items():
        if value := given[option]:
            options += [(path, value, f"--{option} {value}") for path in paths]
    tree = overrides(options, given["set"])
    files: list[Path | JobFile] = [*map(find_job_file, given["config"]), *more]
    config = load(files, tree, kinds, STAGES.broken)
    pipeline(config)
    return config


def run_options(given: dict[str, Any], progress: Progress) -> Options:
    """How the job is run, from the parsed options that say so. Raises ConfigError."""
    from arfx.errors import ConfigError
    from arfx.run.cluster.spec import ClusterSpec, PathMap
    from arfx.run.job import Options

    count, executor, maps = given["workers"], given["executor"], given["map_path"]
    if executor is not None and count is not None:
        raise ConfigError(
            f"--workers {count} and --executor {executor} both say who renders",
            "give one of them",
        )
    if maps and executor is None:
        raise ConfigError(
            "--map-path is for the workers of a cluster", "--executor says which"
        )
    return Options(
        given["job_dir"],
        given["resume"],
        given["overwrite"],
        count,
        given["report_dir"],
        executor=None if executor is None else ClusterSpec.parse(executor),
        map_path=tuple(map(PathMap.parse, maps)),
        progress=progress,
        notice=note,
    )
