"""What batches have made in a folder: `.arfx-batch.jsonl`, a line for each output that was whole, of which the last counts."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from arfx.core.guard import TIMES, fingerprint
from arfx.media.output import image_names, names_sequence
from arfx.run.folder import digest, disk_error
from arfx.run.place import default_folder

NAME = ".arfx-batch.jsonl"


@dataclass(frozen=True)
class Made:
    """key : of the job;  files : digest of the output's fingerprints;  seconds, frames : that it took, and has"""

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
        """What is known of an output that is as it was made; None = nothing, or it has changed since."""
        made = self._rows.get(place(output).name)
        return made if made is not None and made.files == _files(output) else None

    def files(self) -> frozenset[Path]:
        """Files in the folder that are as a batch made them."""
        paths = ((self.folder / name, made) for name, made in self._rows.items())
        return frozenset(path for path, made in paths if path.is_file() and made.files == _files(path))

    def note(self, output: Path, key: str, seconds: float, frames: int) -> None:
        """Raises RenderError where it cannot be written."""
        row = {"output": place(output).name, "key": key, "files": _files(output), "seconds": seconds, "frames": frames}
        try:
            with self._path.open("ab+") as f:
                end = f.seek(0, os.SEEK_END)
                f.seek(max(end - 1, 0))
                whole = f.read(1) in (b"", b"\n")  # a kill, or a full disk, may have cut the last line short
                f.write(f"{'' if whole else chr(10)}{json.dumps(row)}\n".encode())
        except OSError as e:
            raise disk_error(e, self._path) from None

    @cached_property
    def _rows(self) -> Mapping[str, Made]:
        out: dict[str, Made] = {}
        if not self._path.is_file():
            return out
        with self._path.open(encoding="utf-8", errors="replace") as f:
            for line in f:
                try:
                    row: dict[str, Any] = json.loads(line)
                    made = Made(str(row["key"]), str(row["files"]), float(row["seconds"]), int(row["frames"]))
                    out[str(row["output"])] = made
                except (ValueError, KeyError, TypeError, RecursionError):
                    continue
        return out


def place(output: Path) -> Path:
    """The file, or the folder of images, that an output is. Raises ConfigError."""
    folder = default_folder(output)
    return folder.with_name(folder.name.removesuffix(".job"))


def files_of(output: Path) -> list[Path]:
    """Files of an output that are there."""
    if not names_sequence(output):
        return [output] if os.path.lexists(output) else []
    named, folder = image_names(output.name), place(output)
    return sorted(p for p in folder.iterdir() if named(p.name) or p.name == TIMES) if folder.is_dir() else []


def _files(output: Path) -> str:
    return digest([fingerprint(path) for path in files_of(output)])
