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


def stages_with(effects: Collection[str], inputs: Collection[str] = ()) -> tuple[str, ...]:
    """Names of the stages of a job with these effects, in running order. inputs : that the job has and a stage may require"""
    inputs = set(inputs)
    return tuple(name for name, stage in STAGES.items() if (stage.always or name in effects) and stage.requires <= inputs)
