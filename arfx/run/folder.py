"""The job folder: what is written where, atomically, and which key says that a piece is still good.

job.toml (frozen) · inputs.json · frames.json · facts.jsonl · plan.jsonl · plan_summary.json ·
chunks/ · timings.jsonl · previews/ · report.json
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import arfx
from arfx.errors import ConfigError, RenderError

_MARK = "job.toml"
_OURS = {
    _MARK, "inputs.json", "frames.json", "facts.jsonl", "plan.jsonl", "chunks", "timings.jsonl", "previews",
    "report.json", "plan_summary.json", "analysis.checkpoint", "analysis.checkpoint.json",  # as it once was
}  # fmt: skip


@dataclass(frozen=True)
class JobFolder:
    path: Path

    job = property(lambda self: self.path / _MARK)
    inputs = property(lambda self: self.path / "inputs.json")
    frames = property(lambda self: self.path / "frames.json")
    facts = property(lambda self: self.path / "facts.jsonl")
    plan = property(lambda self: self.path / "plan.jsonl")
    plan_summary = property(lambda self: self.path / "plan_summary.json")
    chunks = property(lambda self: self.path / "chunks")
    timings = property(lambda self: self.path / "timings.jsonl")
    previews = property(lambda self: self.path / "previews")
    report = property(lambda self: self.path / "report.json")
    checkpoint = property(lambda self: self.path / "analysis.checkpoint")

    def open(self, resume: bool, overwrite: bool) -> None:
        """Make the folder, or keep what an earlier job left in it (resume), or clear that (overwrite).

        Raises ConfigError if the path holds something that is not a job, or a job and neither is asked for;
        RenderError if it cannot be made.
        """
        if self.path.exists() and not self.path.is_dir():
            raise ConfigError(f"job folder {self.path} is a file", "name another with --job")
        if self.path.is_dir():
            strangers = [p.name for p in self.path.iterdir() if p.name not in _OURS and not p.name.endswith(".part")]
            if not self.job.exists():  # nothing was rendered here, so these folders hold nothing of ours
                strangers += [
                    f"{p.parent.name}/{p.name}" for d in (self.chunks, self.previews) if d.is_dir() for p in d.iterdir()
                ]
            if strangers:
                raise ConfigError(f"{self.path} holds {strangers[0]!r}, it is not a job folder", "name an empty one with --job")
            if not resume:
                if self.job.exists() and not overwrite:
                    state = "a finished" if self.report.exists() else "an unfinished"
                    raise ConfigError(f"{self.path} holds {state} job", "--resume goes on with it, --overwrite starts afresh")
                self.remove()
        try:
            self.chunks.mkdir(parents=True, exist_ok=True)
            self.previews.mkdir(exist_ok=True)
        except OSError as e:
            raise RenderError(f"job folder {self.path} cannot be made: {e.strerror}", "name another with --job") from None

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)

    def remove_chunks(self) -> None:
        shutil.rmtree(self.chunks, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write aside, then rename: the file is whole or absent. Raises RenderError."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """As `write_text`."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data)
        aside.replace(path)
    except OSError as e:
        aside.unlink(missing_ok=True)
        raise disk_error(e, path) from None


def disk_error(e: OSError, path: Path) -> RenderError:
    """One clear message for a full disk, a read-only place and the like."""
    return RenderError(f"cannot write {path}: {e.strerror or e}", "free space or name another place; --resume goes on from there")


def write_lines(path: Path, documents: Iterable[Any]) -> None:
    write_text(path, "".join(json.dumps(d) + "\n" for d in documents))


def read_lines(path: Path, first: int = 0, last: int | None = None) -> Iterator[Any]:
    """The JSON documents on lines first … last (inclusive, from 0)."""
    with path.open(encoding="utf-8") as f:
        for number, line in enumerate(f):
            if number >= first and (last is None or number <= last):
                yield json.loads(line)
            elif last is not None and number > last:
                return


def digest(*parts: Any) -> str:
    """16 hex digits over JSON-able parts."""
    h = hashlib.blake2b(digest_size=8)
    for part in parts:
        h.update(json.dumps(part, sort_keys=True, default=str).encode())
        h.update(b"\0")
    return h.hexdigest()


def file_digest(path: Path, whole_up_to: int = 256 << 20) -> str:
    """Content digest of a file; of a larger one its size, time and three samples, so that an hour of 4K costs nothing."""
    stat = path.stat()
    h = hashlib.blake2b(digest_size=16)
    h.update(str(stat.st_size).encode())
    with path.open("rb") as f:
        if stat.st_size <= whole_up_to:
            while block := f.read(1 << 22):
                h.update(block)
        else:
            h.update(str(stat.st_mtime_ns).encode())
            for at in (0, stat.st_size // 2, stat.st_size - (4 << 20)):
                f.seek(at)
                h.update(f.read(4 << 20))
    return h.hexdigest()


@cache
def code_digest() -> str:
    """Digest of arfx's own source: a chunk made by other code is made again."""
    h = hashlib.blake2b(arfx.__version__.encode(), digest_size=8)
    root = Path(arfx.__file__).parent
    for path in sorted(root.rglob("*.py")):
        h.update(str(path.relative_to(root)).encode())
        h.update(path.read_bytes())
    return h.hexdigest()
