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
    """Stages in running order: arfx's own, then those of other distributions by name.

    Raises ConfigError, with the distribution, for a plug-in whose name is taken, and when
    one is looked up that cannot be loaded: jobs that do not name it are done without it."""

    def __getitem__(self, name: str) -> Any:
        if name in self._paths:
            return super().__getitem__(name)
        return _loaded(name, self.plugins[name])

    def __iter__(self) -> Iterator[str]:
        return iter(
            [*self._paths, *(n for n in self.plugins if n not in self.broken)]
        )

    @cached_property
    def plugins(self) -> Mapping[str, EntryPoint]:
        """Stages of other distributions, by name."""
        from importlib.metadata import entry_points

        entries: dict[str, EntryPoint] = {}
        for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
            if point.name in self._paths or point.name in entries:
                taken = entries.get(point.name)
                first = "arfx itself" if taken is None else _distribution(taken)
                raise ConfigError(
                    f"stage {point.name!r} is in {first} and in {_distribution(point)}",
                    "uninstall one of them",
                )
            entries[point.name] = point
        return entries

    @cached_property
    def broken(self) -> Mapping[str, ConfigError]:
        """Plug-ins that cannot be loaded, with what is wrong."""
        wrong: dict[str, ConfigError] = {}
        for name, point in self.plugins.items():
            try:
                _loaded(name, point)
            except ConfigError as e:
                wrong[name] = e
        return wrong

    def source(self, name: str) -> tuple[Path, str]:
        """The module, or the folder of the outermost package, that a plug-in comes from,
        and its distribution's version.
        """
        path, dist = Path(inspect.getfile(self[name])), self.plugins[name].dist
        while (path.parent / "__init__.py").is_file():
            path = path.parent
        return path, "" if dist is None else dist.version


def _loaded(name: str, point: EntryPoint) -> Any:
    """The class of a plug-in."""
    from arfx.core.stage import Stage

    try:
        with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
            stage = point.load()
            right = isinstance(stage, type) and issubclass(stage, Stage)
            if right:
                stage.Params()  # every setting has a default
    except (Exception, SystemExit) as e:  # whatever another's module raises
        raise ConfigError(
            f"stage {name!r} of {_distribution(point)} cannot be loaded:"
            f" {type(e).__name__}: {e}",
            "uninstall it, or install a version that fits this arfx",
        ) from e
    if not right or stage.name != name:
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
# Parts of the renderer: they make the composite; what comes after them works on the picture.
RENDERER = frozenset({"raster", "lightmap", "holdout", "gi", "hide", "composite"})
# Parts of every job, and those of them that need measured depth.
ALWAYS = RENDERER - {"gi"}
ON_DEPTH = frozenset({"holdout", "hide"})


def stages_with(effects: Collection[str], depth: bool = False) -> tuple[str, ...]:
    """Names of the stages of a job with these effects, in running order.

    depth : whether the job has measured depth
    """
    wanted = ALWAYS | set(effects)
    return tuple(n for n in STAGES if n in wanted and (depth or n not in ON_DEPTH))
