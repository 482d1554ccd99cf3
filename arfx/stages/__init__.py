"""The one table of stages. To add an effect: write its module, add its line here, add a
scene folder.

Other distributions add theirs by entry points of the group `arfx.stages`: `name = "module:Class"`.
Modules are imported when a stage is looked up, so that help stays quick."""

from __future__ import annotations

import contextlib
import inspect
import sys
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

    Raises ConfigError, with the distribution, for a plug-in whose name is taken, and when
    one is looked up that cannot be loaded or placed: jobs that do not name it are done
    without it."""

    def __getitem__(self, name: str) -> Any:
        if name in self._paths:
            return super().__getitem__(name)
        point = self.plugins[name]
        if name in self.broken:
            raise self.broken[name]
        return self._loaded(name, point)

    def __iter__(self) -> Iterator[str]:
        return iter(self._order)

    @cached_property
    def plugins(self) -> Mapping[str, EntryPoint]:
        """Stages of other distributions, by name."""
        from importlib.metadata import entry_points

        entries: dict[str, EntryPoint] = {}
        for point in entry_points(group=GROUP):
            if point.name in self._paths or point.name in entries:
                first = (
                    _distribution(entries[point.name])
                    if point.name in entries
                    else "arfx itself"
                )
                raise ConfigError(
                    f"stage {point.name!r} is in {first} and in {_distribution(point)}",
                    "uninstall one of them",
                )
            entries[point.name] = point
        return entries

    def source(self, name: str) -> tuple[Path, str]:
        """The module, or the folder of the outermost package, that a plug-in comes from,
        and its distribution's version.
        """
        path, dist = Path(inspect.getfile(self[name])), self.plugins[name].dist
        while (path.parent / "__init__.py").is_file():
            path = path.parent
        return path, "" if dist is None else dist.version

    @property
    def broken(self) -> Mapping[str, ConfigError]:
        """Plug-ins that cannot be loaded or placed, with what is wrong."""
        return self._placed[1]

    @property
    def _order(self) -> tuple[str, ...]:
        return self._placed[0]

    @cached_property
    def _placed(self) -> tuple[tuple[str, ...], Mapping[str, ConfigError]]:
        order, waiting, broken = list(self._paths), [], {}
        loaded: dict[str, Any] = {}
        for name, point in sorted(self.plugins.items()):
            try:
                loaded[name] = self._loaded(name, point)
                waiting.append(name)
            except ConfigError as e:
                broken[name] = e
        while waiting:
            ready = [n for n in waiting if not loaded[n].after or loaded[n].after in order]
            if not ready:
                name = waiting.pop(0)
                after = loaded[name].after
                broken[name] = ConfigError(
                    f"stage {name!r} of {_distribution(self.plugins[name])} is to run after"
                    f" {after!r}, which there is not",
                    f"one of {', '.join(order)}",
                )
                continue
            name = ready[0]
            waiting.remove(name)
            stage = loaded[name]
            known = {
                n: loaded[n] if n in loaded else Classes.__getitem__(self, n) for n in order
            }
            before = (
                [stage.after]
                if stage.after
                else [n for n in order if known[n].writes & stage.reads]
            )
            order.insert(order.index(before[-1]) + 1 if before else 0, name)
        return tuple(order), broken

    def _loaded(self, name: str, point: EntryPoint) -> Any:
        from arfx.core.stage import Stage

        try:
            with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
                stage = point.load()
        except (Exception, SystemExit) as e:  # whatever another's module raises
            raise ConfigError(
                f"stage {name!r} of {_distribution(point)} cannot be loaded:"
                f" {type(e).__name__}: {e}",
                "uninstall it, or install a version that fits this arfx",
            ) from e
        if not (
            isinstance(stage, type) and issubclass(stage, Stage) and stage.name == name
        ):
            raise ConfigError(
                f"{point.value} of {_distribution(point)} is not a Stage named {name!r}",
                "uninstall it",
            )
        stage.distribution = _distribution(point)
        return stage


def _distribution(point: EntryPoint) -> str:
    return (
        "a distribution without a name"
        if point.dist is None
        else f"{point.dist.name} {point.dist.version}"
    )


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
    """Names of the stages of a job with these effects, in running order.

    inputs : that the job has and a stage may require
    """
    inputs = set(inputs)
    return tuple(
        name
        for name, stage in STAGES.items()
        if (stage.always or name in effects) and stage.requires <= inputs
    )
