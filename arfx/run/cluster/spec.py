"""`--executor`: which cluster renders; `--map-path HERE=THERE`: where its workers see what
lies at a path of this machine.

Nothing here starts or connects, and nothing imports Dask before it is asked for.
"""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import quote

from arfx.core.machine import usable_cores
from arfx.core.opener import parse_toml, read_text
from arfx.errors import ConfigError

LOCAL, ADDRESS, SLURM = "local", "address", "slurm"
FORMS = "local, local:4, tcp://HOST:8786, tls://HOST:8786, or slurm:FILE"


@dataclass(frozen=True)
class ClusterSpec:
    """kind : LOCAL (a cluster on this machine), ADDRESS (one that runs) or SLURM (workers
    are jobs of Slurm)

    address : of the scheduler;  workers : how many there are to be, 0 = only the cluster knows
    settings : of dask_jobqueue's SLURMCluster"""

    kind: str
    address: str = ""
    workers: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def parse(text: str) -> ClusterSpec:
        """Raises ConfigError for what is no such name, or a file of settings that is wrong;
        InputError if it cannot be read.
        """
        if match := re.fullmatch(r"local(?::(\d{1,4}))?", text):
            workers = usable_cores() if match[1] is None else int(match[1])
            if workers:
                return ClusterSpec(LOCAL, workers=workers)
        elif re.fullmatch(
            r"(?:tcp|tls)://(?:\[[0-9A-Fa-f:.%]+\]|[^\s:/?#@\[\]]+):\d{1,5}", text
        ):
            return ClusterSpec(ADDRESS, text)
        elif text.startswith("slurm:") and len(text) > 6:
            return _slurm(Path(text[6:]))
        raise ConfigError(f"--executor {text} is no cluster", FORMS)


def _slurm(path: Path) -> ClusterSpec:
    try:
        settings = parse_toml(read_text(path, "job file"))
    except ValueError as e:
        raise ConfigError(f"{path}: not valid TOML: {e}") from None
    for key in ("cores", "processes", "jobs"):
        count = settings.get(key, 1)
        if type(count) is not int or not 1 <= count <= 10_000:
            raise ConfigError(f"{path}: {key} is {count!r}", "a whole number above 0")
    if missing := [key for key in ("cores", "memory") if key not in settings]:
        raise ConfigError(
            f"{path}: {missing[0]} is not said",
            'of one Slurm job: cores = 8, memory = "32GB"',
        )
    # of a job's processes each has one thread, unless the file says otherwise
    settings = {"jobs": 1, "processes": settings["cores"], **settings}
    threads = max(settings["cores"] // settings["processes"], 1)
    return ClusterSpec(
        SLURM,
        workers=settings["jobs"] * settings["processes"] * threads,
        settings=settings,
    )


def library(name: str) -> ModuleType:
    """A module of the extra `cluster`. Raises ConfigError where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as e:
        if e.name is None or e.name.partition(".")[0] != name.partition(".")[0]:
            raise
        raise ConfigError(
            f"--executor needs {name}, which is not installed",
            "pip install 'arfx[cluster]'",
        ) from None


_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://|[a-z]+::")


@dataclass(frozen=True)
class PathMap:
    """here : a folder or file of this machine, absolute;  there : the same for a worker, a
    path or a URL of fsspec
    """

    here: Path
    there: str

    @staticmethod
    def parse(text: str) -> PathMap:
        here, equals, there = text.partition("=")
        if not (here and equals and there):
            raise ConfigError(
                f"--map-path {text} does not name two places",
                "--map-path /here=/there, or /here=s3://bucket/there",
            )
        if not is_url(there) and not Path(there).is_absolute():
            raise ConfigError(
                f"--map-path {text}: {there} is not absolute",
                "a whole path, or a URL: file://, s3://, http://",
            )
        return PathMap(Path(os.path.abspath(here)), there)  # noqa: PTH100  (links stay as they are named)

    def of(self, path: Path) -> str | None:
        """Where `path` (absolute) is for the worker; None where it does not lie under `here`."""
        if not path.is_relative_to(self.here):
            return None
        rest = path.relative_to(self.here).as_posix()
        rest = quote(rest) if self.there.startswith(("http:", "https:")) else rest
        return self.there if rest == "." else f"{self.there.rstrip('/')}/{rest}"


def is_url(place: str) -> bool:
    return _URL.match(place) is not None


def places(path: Path, maps: Sequence[PathMap]) -> tuple[str, ...]:
    """Where a worker is to look for `path` (absolute): paths first, the longest match
    before others, then URLs.
    """
    found = [
        there
        for m in sorted(maps, key=lambda m: -len(m.here.parts))
        if (there := m.of(path)) is not None
    ]
    return tuple(sorted([*found, str(path)], key=is_url))
