"""How a clip is cut into chunks. The borders depend on the job alone, never on who renders them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

SHORTEST, LONGEST, WANTED = 30, 120, 8


@dataclass(frozen=True, slots=True)
class Chunk:
    """Frames first … last, inclusive; key : digest of everything that its pixels depend on."""

    first: int
    last: int
    key: str

    def path(self, folder: Path, suffix: str) -> Path:
        return folder / f"{self.first:06d}-{self.last:06d}.{self.key}{suffix}"

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
