"""The one table of stages. To add an effect: write its module, add its line here, add a scene folder.

Other distributions add theirs by entry points of the group `arfx.stages`: `name = "module:Class"`.
Modules are imported when a stage is looked up, so that help stays quick."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arfx.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "arfx.stages"


class Classes(Mapping[str, Any]):
    """name -> class, imported when looked up."""

    def __init__(self, paths: dict[str, str]) -> None:
        self._paths = paths

    def __getitem__(self, name: str) -> Any:
        module, _, cls = self._paths[name].rpartition(".")
        return getattr(import_module(module), cls)

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def load(self) -> None:
        """Import all, without plug-ins."""
        for name in self._paths:
            Classes.__getitem__(self, name)


class Table(Classes):
    """Stages in running order.

    Raises ConfigError, with the distribution, for a plug-in that cannot be loaded or placed, or whose name is taken."""

    def __getitem__(self, name: str) -> Any:
        return super().__getitem__(name) if name in self._paths else self._loaded(name, self.plugins[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._order)

    @cached_property
    def plugins(self) -> Mapping[str, EntryPoint]:
        """Stages of other distributions, by name."""
        from importlib.metadata import entry_points

        entries: dict[str, EntryPoint] = {}
        for point in entry_points(group=GROUP):
            if point.name in self._paths or point.name in entries:
                first = _distribution(entries[point.name]) if point.name in entries else "arfx itself"
                raise ConfigError(f"stage {point.name!r} is in {first} and in {_distribution(point)}", "uninstall one of them")
            entries[point.name] = point
        return entries

    def source(self, name: str) -> tuple[Path, str]:
        """The module, or the folder of the outermost package, that a plug-in comes from, and its distribution's version."""
        path, dist = Path(inspect.getfile(self[name])), self.plugins[name].dist
        while (path.parent / "__init__.py").is_file():
            path = path.parent
        return path, "" if dist is None else dist.version

    @cached_property
    def _order(self) -> tuple[str, ...]:
        order, waiting = list(self._paths), sorted(self.plugins)
        while waiting:
            name = next((n for n in waiting if not self[n].after or self[n].after in order), None)
            if name is None:
                name, after = waiting[0], self[waiting[0]].after
                raise ConfigError(
                    f"stage {name!r} of {_distribution(self.plugins[name])} is to run after {after!r}, which there is not",
                    f"one of {', '.join(order)}",
                )
            waiting.remove(name)
            stage = self[name]
            before = [stage.after] if stage.after else [n for n in order if self[n].writes & stage.reads]
            order.insert(order.index(before[-1]) + 1 if before else 0, name)
        return tuple(order)

    def _loaded(self, name: str, point: EntryPoint) -> Any:
        from arfx.core.stage import Stage

        try:
            stage = point.load()
        except Exception as e:  # whatever another's module raises
            raise ConfigError(
                f"stage {name!r} of {_distribution(point)} cannot be loaded: {type(e).__name__}: {e}",
                "uninstall it, or install a version that fits this arfx",
            ) from e
        if not (isinstance(stage, type) and issubclass(stage, Stage) and stage.name == name):
            raise ConfigError(f"{point.value} of {_distribution(point)} is not a Stage named {name!r}", "uninstall it")
        return stage


def _distribution(point: EntryPoint) -> str:
    return "a distribution without a name" if point.dist is None else f"{point.dist.name} {point.dist.version}"


# In the order in which they run. Configuration can leave effects out, never reorder them.
STAGES = Table(
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
