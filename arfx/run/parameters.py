"""Which settings exist, and the stages of a job made from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from arfx.analyse.analyser import AnalyseParams, LightParams
from arfx.config.load import near
from arfx.config.sections import JobConfig
from arfx.core.stage import Stage
from arfx.errors import ConfigError
from arfx.stages import ASKED_FOR, EFFECTS, STAGES, TAKES_OVER, stages_with


def parameters() -> Mapping[str, type]:
    """Section name -> frozen dataclass, for every stage, the analysis and the light that it reads."""
    return {"analyse": AnalyseParams, "light": LightParams, **{name: STAGES[name].Params for name in STAGES}}


def pipeline(config: JobConfig) -> tuple[str, ...]:
    """Names of the stages that a job may run, in running order. Raises ConfigError for unknown or misordered effects."""
    automatic = [name for name in EFFECTS if name not in ASKED_FOR]
    asked = automatic if config.pipeline.stages == "auto" else list(config.pipeline.stages)
    for name in asked:
        if name not in EFFECTS:
            have = f"effects in this version: {', '.join(EFFECTS)}" if EFFECTS else "this version has no optional effects yet"
            hint = near(name, EFFECTS) if EFFECTS else "leave --pipeline out for the plain composite"
            raise ConfigError(f"there is no effect {name!r}; {have}", hint)
    ordered = [name for name in EFFECTS if name in asked]
    if asked != ordered:
        raise ConfigError(
            f"effects run in the order {','.join(ordered)}, not {','.join(asked)}", "write them in that order, once each"
        )
    return stages_with(asked)


def make_stages(config: JobConfig) -> dict[str, Stage]:
    """One instance per stage, in running order."""
    names = pipeline(config)
    settings = dict(config.params)
    for effect in names:
        for name, changes in TAKES_OVER.get(effect, {}).items():
            settings[name] = replace(settings[name], **changes)
    return {name: STAGES[name](settings[name]) for name in names}


def light_wanted(config: JobConfig) -> LightParams | None:
    """How the analysis reads the light, or None where no stage of the job asks for it."""
    params: LightParams = config.params["light"]
    return params if any("light" in STAGES[name].needs_facts for name in pipeline(config)) else None
