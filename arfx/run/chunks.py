"""How a clip is cut into chunks. The borders depend on the job alone, never on who renders them."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from arfx.run.folder import content_digest

T = TypeVar("T")

SHORTEST, LONGEST, WANTED = 30, 120, 8


@dataclass(frozen=True, slots=True)
class Chunk:
    """Frames first … last, inclusive; key : digest of everything that its pixels depend on."""

    first: int
    last: int
    key: str

    @property
    def name(self) -> str:
        """Its file's, up to the digest of what is in it (`arfx.run.folder.content_digest`) and the extension."""
        return f"{self.first:06d}-{self.last:06d}.{self.key}"

    def find(self, folder: Path, suffix: str) -> Path | None:
        """Its file, if there is one that is as it was written."""
        for path in folder.glob(f"{self.name}.*{suffix}"):
            with contextlib.suppress(OSError):
                if path.name == f"{self.name}.{content_digest(path)}{suffix}":
                    return path
        return None

    @property
    def frames(self) -> int:
        return self.last - self.first + 1


def borders(frames: int) -> list[tuple[int, int]]:
    """(first, last) of each chunk: about WANTED of them, between SHORTEST and LONGEST frames each."""
    length = min(max(-(-frames // WANTED), SHORTEST), LONGEST)
    return [(a, min(a + length, frames) - 1) for a in range(0, frames, length)]


def stretches(chunks: Sequence[T], workers: int) -> list[deque[T]]:
    """Consecutive chunks for each worker, so that it reads on from one to the next."""
    size = max(-(-len(chunks) // workers), 1)
    return [deque(chunks[i : i + size]) for i in range(0, len(chunks), size)]


def taken(own: deque[T], every: Sequence[deque[T]]) -> T | None:
    """The next chunk of a worker: of its own stretch, then from the end of the longest that is left; None = all are taken."""
    longest = max(every, key=len, default=own)
    if not longest:
        return None
    return own.popleft() if own else longest.pop()
