"""Which settings exist, and the stages of a job made from them."""

from __future__ import annotations

from collections.abc import Mapping

from arfx.analyse.analyser import AnalyseParams
from arfx.config.load import near
from arfx.config.sections import JobConfig
from arfx.core.stage import Stage
from arfx.errors import ConfigError
from arfx.stages import ASKED_FOR, EFFECTS, IMPLICIT, STAGES


def parameters() -> Mapping[str, type]:
    """Section name -> frozen dataclass, for every stage and for the analysis."""
    return {"analyse": AnalyseParams, **{name: STAGES[name].Params for name in STAGES}}


def pipeline(config: JobConfig) -> tuple[str, ...]:
    """Names of the stages that a job may run, in running order. Raises ConfigError for unknown or misordered effects."""
    if config.pipeline.stages == "auto":
        asked = [n for n in EFFECTS if n not in ASKED_FOR or config.params.get(n) != STAGES[n].Params()]
    else:
        asked = list(config.pipeline.stages)
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
    return tuple(name for name in STAGES if name in IMPLICIT or name in asked)


def make_stages(config: JobConfig) -> dict[str, Stage]:
    """One instance per stage, in running order."""
    return {name: STAGES[name](config.params[name]) for name in pipeline(config)}
