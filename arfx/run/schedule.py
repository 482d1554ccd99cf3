"""How a clip is cut into chunks, which worker renders which, and how long that takes.

Chunk borders depend on the job alone, never on who renders them. Each worker has
consecutive chunks (run/executors.py): one that does not read on from its last chunk decodes
from the key frame before."""

import contextlib
import heapq
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
    """Frames first … last, inclusive; key : of the job."""

    first: int
    last: int
    key: str

    @property
    def name(self) -> str:
        """Its file's, up to the digest of its content (`arfx.run.folder.content_digest`)
        and the extension.
        """
        return f"{self.first:06d}-{self.last:06d}.{self.key}"

    @property
    def frames(self) -> int:
        return self.last - self.first + 1


def find_chunk(folder: Path, name: str, suffix: str) -> Path | None:
    """The file of the chunk with this name (`Chunk.name`), if there is one that is as it
    was written.
    """
    for path in folder.glob(f"{name}.*{suffix}"):
        with contextlib.suppress(OSError):
            if path.name == f"{name}.{content_digest(path)}{suffix}":
                return path
    return None


def borders(frames: int) -> list[tuple[int, int]]:
    """(first, last) of each chunk: about WANTED of them, between SHORTEST and LONGEST
    frames each.
    """
    length = min(max(-(-frames // WANTED), SHORTEST), LONGEST)
    return [(a, min(a + length, frames) - 1) for a in range(0, frames, length)]


def work_queues(chunks: Sequence[T], workers: int) -> list[deque[T]]:
    """Consecutive chunks for each worker, so that it reads on from one to the next."""
    size = max(-(-len(chunks) // workers), 1)
    return [deque(chunks[i : i + size]) for i in range(0, len(chunks), size)]


def next_task(own: deque[T], queues: Sequence[deque[T]]) -> T:
    """A worker's next chunk, of those that are left: of its own queue, then from the end of
    the longest one.
    """
    return own.popleft() if own else max(queues, key=len).pop()


def elapsed(seconds: Sequence[float], workers: int, alone: float = 1.0) -> float:
    """Seconds until the last worker is through with chunks that take so long each, while
    all are busy.

    alone : time of one worker that is alone, as a fraction of its time beside others
    """
    ends = [0.0] * max(min(workers, len(seconds)), 1)
    for s in sorted(seconds, reverse=True):
        heapq.heapreplace(ends, ends[0] + s)
    busy = min(ends) if len(ends) > 1 else 0.0
    return busy + (max(ends) - busy) * alone
