"""What batches have made in a folder: `.arfx-batch.jsonl`, a line for each output that was
whole, of which the last counts.
"""

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from arfx.core.guard import TIMES, fingerprint
from arfx.errors import ConfigError
from arfx.media.output import image_names, names_sequence
from arfx.run.folder import append_line, digest, disk_error, read_lines
from arfx.run.place import place

NAME = ".arfx-batch.jsonl"


@dataclass(frozen=True)
class Made:
    """key : of the job;  files : digest of the output's fingerprints;  seconds, frames :
    that it took, and has
    """

    key: str
    files: str
    seconds: float
    frames: int


@dataclass(frozen=True)
class OutputsMade:
    """Of one folder."""

    folder: Path
    _path = property(lambda self: self.folder / NAME)

    def of(self, output: Path) -> Made | None:
        """What is known of an output that is as it was made; None = nothing, or it has
        changed since.
        """
        made = self._rows.get(place(output).name)
        return made if made is not None and made.files == _files(output) else None

    def files(self) -> frozenset[Path]:
        """Files in the folder that are as a batch made them."""
        paths = ((self.folder / name, made) for name, made in self._rows.items())
        return frozenset(
            path
            for path, made in paths
            if path.is_file() and made.files == _files(path)
        )

    def note(self, output: Path, key: str, seconds: float, frames: int) -> None:
        """Raises RenderError where it cannot be written."""
        row = {
            "output": place(output).name,
            "key": key,
            "files": _files(output),
            "seconds": seconds,
            "frames": frames,
        }
        self._check_link()
        try:
            append_line(self._path, row)
        except OSError as e:
            raise disk_error(e, self._path) from None

    def _check_link(self) -> None:
        """What was made is never written to, nor read from, a file elsewhere."""
        if self._path.is_symlink():
            raise ConfigError(
                f"{self._path} is a link",
                "remove it: batches keep there what they have made",
            )

    @cached_property
    def _rows(self) -> Mapping[str, Made]:
        self._check_link()
        out: dict[str, Made] = {}
        for row in read_lines(self._path):
            with contextlib.suppress(ValueError, KeyError, TypeError, OverflowError):
                made = Made(
                    str(row["key"]),
                    str(row["files"]),
                    float(row["seconds"]),
                    int(row["frames"]),
                )
                out[str(row["output"])] = made
        return out


def files_of(output: Path) -> list[Path]:
    """Files of an output that are there."""
    if not names_sequence(output):
        return [output] if os.path.lexists(output) else []
    named, folder = image_names(output.name), place(output)
    return (
        sorted(p for p in folder.iterdir() if named(p.name) or p.name == TIMES)
        if folder.is_dir()
        else []
    )


def _files(output: Path) -> str:
    return digest([fingerprint(path) for path in files_of(output)])
