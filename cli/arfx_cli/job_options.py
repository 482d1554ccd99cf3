"""The options that `process`, `plan` and `tradeoff` share, and how they become a job.

Those of a job file's sections are made from its fields; this module has those of stages, and of how a job is run."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from arfx.config.sections import Setting, settings
from arfx_cli.console import FILE, FOLDER, Progress, note

if TYPE_CHECKING:
    from arfx.config.given import Given
    from arfx.run.inputs import Inputs
    from arfx.run.planned import Job


_OTHERS = [
    click.Option(["--config"], type=FILE, multiple=True,
                 help="Job file (TOML) or preset name. Repeatable: later ones win, and the command line over all."),
    click.Option(["--light"], metavar="AZ,EL[,R,G,B]", help="A known light: azimuth from the marker's x, elevation, degrees."),
    click.Option(["--environment"], type=FILE, help="A known light: HDR panorama, its top the marker's z, its middle x."),
    click.Option(["--formula"], type=click.Choice(["paper", "corrected"]), help="Methods as printed, or corrected (default)."),
    click.Option(["--set"], multiple=True, metavar="STAGE.KEY=VALUE", help="Any setting, repeatable."),
    click.Option(["--report", "report_dir"], type=FOLDER, help="Folder for report.json and report.html."),
    click.Option(["--job", "job_dir"], type=FOLDER, help="Job folder, kept afterwards; default OUT.job."),
    click.Option(["--resume"], is_flag=True, help="Go on with an interrupted or killed job."),
    click.Option(["--workers"], type=click.IntRange(1), help="Worker processes; default: threads on up to 4 cores."),
]  # fmt: skip
# As help shows them; what is not named here comes last.
_ORDER = (
    "clip config camera marker pattern marker-map model scale fit offset rotate up pipeline no-skip quality budget fps max-error "
    "tradeoff light environment formula depth depth-scale anchor poses set start end "
    "output codec crf pixel-format report job resume workers"
)


def job_options() -> list[click.Parameter]:
    """What a job is, where it goes and how it is run: the parameters of a command."""
    places = {name: place for place, name in enumerate(_ORDER.split())}
    parameters = [*(_parameter(s) for s in settings() if s.flags), *_OTHERS]
    return sorted(parameters, key=lambda p: places.get(p.opts[-1].lstrip("-"), len(places)))


def _parameter(s: Setting) -> click.Parameter:
    kind: Any = None
    if Path in s.kinds:
        kind = click.Path(path_type=Path, dir_okay=s.metavar == "PATH")
    elif float in s.kinds:  # click checks a limit of 0, the job all other limits
        low = next((m for m in s.limits if 0 in (getattr(m, "gt", None), getattr(m, "ge", None))), None)
        kind = click.FLOAT if low is None else click.FloatRange(0, min_open=hasattr(low, "gt"))
    elif list[str] not in s.kinds:
        kind = next((click.Choice(get_args(k)) for k in s.kinds if get_origin(k) is Literal), None)
    if not s.flags[0].startswith("-"):
        return click.Argument([s.name], type=kind, required=False)
    flag = True if bool in s.kinds else None  # with False, click takes the -1 of --crf -1 for an option
    return click.Option(s.flags, type=kind, metavar=s.metavar, multiple=s.repeated, is_flag=flag, help=s.help)


def job_config(given: dict[str, Any]) -> Any:
    """The typed job from the parsed options. Raises ConfigError."""
    from arfx.config.given import overrides, section_overrides
    from arfx.config.load import find_job_file, load
    from arfx.run.parameters import parameters, pipeline

    kinds = parameters()
    formulas = [name for name, by_formula in kinds.items() if len(by_formula) > 1]
    tree = overrides(itertools.chain(section_overrides(given), _of_stages(given, formulas)), given["set"])
    config = load([find_job_file(file) for file in given["config"]], tree, kinds)
    pipeline(config)
    return config


def _of_stages(given: dict[str, Any], formulas: Sequence[str]) -> Iterator[Given]:
    if given["light"]:
        from arfx.analyse.params import parse_light

        yield ("light", "given"), parse_light(given["light"]), f"--light {given['light']}"
    if given["environment"]:
        yield ("light", "environment"), given["environment"], f"--environment {given['environment']}"
    if given["formula"]:
        for name in formulas:
            yield (name, "formula"), given["formula"], f"--formula {given['formula']}"


@contextmanager
def planned_aside(given: dict[str, Any], progress: Progress, check: Callable[[Inputs], None] | None = None) -> Iterator[Job]:
    """The job that `process` would run with these arguments, analysed and planned. Its folder is gone afterwards.

    check : called with all that was opened, before any work"""
    from arfx.run.folder import JobFolder
    from arfx.run.inputs import open_inputs
    from arfx.run.job import Options, plan_job
    from arfx.run.place import Places

    with tempfile.TemporaryDirectory(prefix="arfx-") as scratch:
        config = job_config(given)
        named = config.output.path is not None
        if not named:  # only where it would go is open; mkv holds what any clip has
            config = config.model_copy(update={"output": config.output.model_copy(update={"path": Path("out.mkv")})})
        inputs = open_inputs(config)
        if named:
            Places(inputs, None, None, overwrite=True).check_output()
        if check is not None:
            check(inputs)
        for notice in inputs.notices:
            note(notice)
        folder = JobFolder(Path(scratch) / "job")
        folder.open(resume=False)
        yield plan_job(inputs, folder, Options(progress=progress, notice=note))
