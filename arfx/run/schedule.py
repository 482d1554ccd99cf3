"""How a clip is cut into chunks, which worker renders which, and how long that takes.

Chunk borders depend on the job alone, never on who renders them. Each worker has
consecutive chunks (run/executors.py): one that does not read on from its last chunk decodes
from the key frame before."""

from __future__ import annotations

import contextlib
import itertools
from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Sequence
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
        """Its file's, up to the digest of its content (`arfx.run.folder.content_digest`)
        and the extension.
        """
        return f"{self.first:06d}-{self.last:06d}.{self.key}"

    def find(self, folder: Path, suffix: str) -> Path | None:
        """Its file, if there is one that is as it was written."""
        return find_chunk(folder, self.name, suffix)

    @property
    def frames(self) -> int:
        return self.last - self.first + 1


def find_chunk(folder: Path, name: str, suffix: str) -> Path | None:
    """The whole file of the chunk with this name (`Chunk.name`)."""
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


def steal(own: deque[T], queues: Sequence[deque[T]]) -> T | None:
    """A worker's next chunk: of its own queue, then from the end of the longest one; None =
    there is none left.
    """
    longest = max(queues, key=len, default=own)
    if not longest:
        return None
    return own.popleft() if own else longest.pop()


def next_chunk(waiting: Sequence[int], own: int, others: Collection[int]) -> int:
    """The number of the chunk that a worker is to take of those that wait, which are in
    order and at least one.

    own, others : the numbers that it, and that others would read on to. It reads on; else
    it begins the longest run of chunks, where another will come to its beginning in its
    middle."""
    if own in waiting:
        return own
    runs = [
        [chunk for _, chunk in run]
        for _, run in itertools.groupby(enumerate(waiting), lambda pair: pair[1] - pair[0])
    ]
    longest = max(runs, key=len)
    return longest[len(longest) // 2] if longest[0] in others else longest[0]


@dataclass(frozen=True)
class Load:
    """first, last : frames of a chunk;  seconds : of its work, while all workers are busy"""

    first: int
    last: int
    seconds: float


@dataclass
class _Worker:
    queue: deque[Load]
    left_s: float = 0.0
    next_frame: int = 0


def elapsed(
    loads: Sequence[Load],
    workers: int,
    keys: Sequence[int] = (),
    decode_s: float = 0.0,
    alone: float = 1.0,
) -> tuple[float, float]:
    """(seconds until the last worker is through, seconds of decoding that no frame of its
    own chunk needs).

    keys : frames that decoding can begin at;  decode_s : of a frame
    alone : time of one worker that is alone, as a fraction of its time beside others that are busy
    """
    workers = max(min(workers, len(loads)), 1)
    queues = work_queues(loads, workers) or [deque()]
    crew = [_Worker(queues[min(k, len(queues) - 1)]) for k in range(workers)]
    now = lead = 0.0
    while True:
        for w in crew:
            while w.left_s <= 0 and (load := steal(w.queue, queues)) is not None:
                before = bisect_right(keys, load.first)
                key = keys[before - 1] if before else 0
                extra = 0.0 if load.first == w.next_frame else decode_s * (load.first - key)
                w.left_s, w.next_frame, lead = (
                    load.seconds + extra,
                    load.last + 1,
                    lead + extra,
                )
        busy = [w for w in crew if w.left_s > 0]
        if not busy:
            return now, lead
        # beside all others a worker takes its own time, alone the fraction `alone` of it;
        # linear between these
        slowness = (
            1.0
            if len(busy) >= max(workers, 2)
            else alone + (1 - alone) * (len(busy) - 1) / max(workers - 1, 1)
        )
        step = min(w.left_s for w in busy)
        now += step * slowness
        for w in busy:
            w.left_s = w.left_s - step if w.left_s - step >= 1e-12 else 0.0
