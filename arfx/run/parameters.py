"""Which settings exist, and the stages of a job made from them."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from arfx.analyse.job import Analysis
from arfx.analyse.params import AnalyseParams, LightParams
from arfx.config.load import suggestion
from arfx.config.sections import JobConfig
from arfx.core.settings import converted
from arfx.core.stage import Stage, blamed
from arfx.errors import ConfigError
from arfx.papers import CORRECTED, FORMULAS, PAPER
from arfx.stages import ALWAYS, ON_DEPTH, STAGES, stages_with


def parameters() -> Mapping[str, Mapping[str, Any]]:
    """Section name -> formula -> model of its settings, for every stage, the analysis and the
    light that it reads; the usual formula first."""
    light = {f: method.Params for f, method in _printed("light").items()}
    analysis: dict[str, dict[str, Any]] = {
        "analyse": {CORRECTED: AnalyseParams},
        "light": {CORRECTED: LightParams, **light},
    }
    return analysis | {
        name: {f: stage.Params for f, stage in _stages(name).items()}
        for name in STAGES
    }


def _printed(name: str) -> dict[str, Any]:
    """Of a stage or the light, as papers print it: its class by formula."""
    return {f: table[name] for f, table in FORMULAS.items() if name in table}


def _stages(name: str) -> dict[str, type[Stage]]:
    """A stage's class by formula."""
    return {CORRECTED: STAGES[name], **_printed(name)}


def stage_of(name: str, params: Any) -> Stage:
    """The stage with these settings, under their formula."""
    formula = getattr(params, "formula", CORRECTED)
    kind = _printed(name).get(formula, STAGES[name])
    with blamed(kind, "while it is made"):
        stage: Stage = kind(params)
    return stage


def under_other_formula(name: str, params: Any) -> Stage | None:
    """The stage under the formula that these settings do not choose, with those that both
    have; None = it has one formula.
    """
    for formula, stage in _stages(name).items():
        if formula != getattr(params, "formula", CORRECTED):
            return stage(converted(params, stage.Params))
    return None


def pipeline(config: JobConfig) -> tuple[str, ...]:
    """Names of the stages that a job may run, in running order.

    Raises ConfigError for unknown or misordered effects.
    """
    deep = config.input.depth is not None
    if config.pipeline.stages == "auto":
        params = (
            config.params
        )  # defaults are of the same formula: that alone is no setting
        asked = [
            n
            for n in STAGES
            if n in params
            and params[n] != type(params[n])()
            and (deep or n not in ON_DEPTH)
        ]
    else:
        asked = list(config.pipeline.stages)
    for name in asked:
        if name not in STAGES:
            effects = [n for n in STAGES if n not in ALWAYS]
            raise ConfigError(
                f"there is no effect {name!r}; effects in this version:"
                f" {', '.join(effects)}",
                suggestion(name, list(STAGES)),
            )
        if name in ON_DEPTH and not deep:
            raise ConfigError(
                f"{name} needs depth", f"give --depth, or leave {name} out"
            )
    ordered = [name for name in STAGES if name in asked]
    if asked != ordered:
        raise ConfigError(
            f"effects run in the order {','.join(ordered)}, not {','.join(asked)}",
            "write them in that order, once each",
        )
    return stages_with(asked, deep)


def make_stages(config: JobConfig) -> dict[str, Stage]:
    """One instance per stage of a job, in running order."""
    return stages_of(config.params, pipeline(config))


def stages_of(params: Mapping[str, Any], names: Collection[str]) -> dict[str, Stage]:
    """One instance of each of these stages, with these settings."""
    stages: dict[str, Any] = {name: stage_of(name, params[name]) for name in names}
    if "gi" in names and "lightmap" in names:
        stages["lightmap"].soft = False  # gi gives all light without a direction
    return stages


def with_machine_settings(config: JobConfig) -> JobConfig:
    """The job with what its settings come to here (`Stage.settled`): a job resumed on
    another machine mixes nothing.
    """
    settled = {
        name: STAGES[name].settled(config.params[name]) for name in pipeline(config)
    }
    return config.model_copy(update=settled)


def quality_notices(quality: str, stages: Mapping[str, Stage]) -> list[str]:
    """What a quality by name comes to where stages of the job have no such level."""
    without = [name for name, stage in stages.items() if quality not in stage.levels]
    printed = ", ".join(
        n for n in without if getattr(stages[n].params, "formula", "") == PAPER
    )
    notices = []
    if printed:
        notices.append(
            f"--quality {quality}: {printed} as printed, which has one level, standard"
        )
    if quality == "high" and len(without) == len(stages):
        notices.append(
            "quality high is standard: no effect of this job has a level between standard"
            " and reference"
        )
    return notices


def light_method(config: JobConfig) -> Callable[..., Analysis] | None:
    """A published method's light in place of the corrected one; None = the corrected."""
    table = FORMULAS.get(config.params["light"].formula)
    return None if table is None else table["light"].with_light


def required_facts(config: JobConfig) -> frozenset[str]:
    """What the job needs of the analysis, by name: what its stages read, and what every job has."""
    stages = make_stages(config).values()
    wanted = {"pose", "light", "object"}.union(*(stage.facts for stage in stages))
    if config.input.depth is None:
        return frozenset(wanted - {"depth"})
    return frozenset(wanted | {"depth", "planes"})
