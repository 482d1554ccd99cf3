"""The one table of stages. To add an effect: write its module, add its line here, add a scene folder.

Modules are imported on first use of `stage_class`, so that help and configuration stay quick.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from importlib import import_module
from typing import Any


class _Table(Mapping[str, type]):
    """name -> stage class, imported when looked up."""

    def __init__(self, places: dict[str, str]) -> None:
        self._places = places

    def __getitem__(self, name: str) -> Any:
        module, _, cls = self._places[name].rpartition(".")
        return getattr(import_module(module), cls)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


# In the order in which they run. Configuration can leave effects out, never reorder them.
STAGES: Mapping[str, Any] = _Table(
    {
        "raster": "arfx.stages.raster.Raster",
        "lightmap": "arfx.stages.lightmap.Lightmap",
        "holdout": "arfx.stages.holdout.Holdout",
        "gi": "arfx.stages.gi.Gi",
        "hide": "arfx.stages.hide.Hide",
        "composite": "arfx.stages.composite.Composite",
        "dof": "arfx.stages.dof.Dof",
        "watercolor": "arfx.stages.watercolor.Watercolor",
    }
)
# Stages that every job has; the others are effects that a pipeline names.
IMPLICIT = ("raster", "lightmap", "holdout", "hide", "composite")
# Those that a pipeline may name; that `lightmap` is always there is no reason to refuse its name.
EFFECTS = ("lightmap", *(name for name in STAGES if name not in IMPLICIT))
# Those of them that only a job with measured depth of the real scene has.
WITH_DEPTH = ("holdout", "hide")
# Effects that `auto` takes only where a job sets something of theirs: they change the whole real picture, or are dear.
ASKED_FOR = ("gi", "dof", "watercolor")
# Settings of other stages that an effect takes over: gi gives all light without a direction, lightmap the rest.
TAKES_OVER: Mapping[str, Mapping[str, Mapping[str, Any]]] = {"gi": {"lightmap": {"ambient": False}}}


def stages_with(effects: Collection[str], depth: bool = False) -> tuple[str, ...]:
    """Names of the stages of a job with these effects, in running order. depth : of the real scene is given"""
    left_out = () if depth else WITH_DEPTH
    return tuple(name for name in STAGES if (name in IMPLICIT and name not in left_out) or name in effects)
