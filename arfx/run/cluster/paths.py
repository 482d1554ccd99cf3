"""`--map-path HERE=THERE`: where workers see what lies at a path of this machine."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from arfx.errors import ConfigError

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
