"""How long workers take over the chunks of a job: who renders which, who waits, and how much faster one is that is alone.

As in run/executors.py: threads each have a stretch of the clip, processes take the next chunk there is. A worker that does not
read on from its last chunk decodes from the key frame before, which may lie many frames back.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from arfx.run.chunks import stretches, taken


@dataclass(frozen=True)
class Load:
    """first, last : frames of a chunk;  seconds : of its work, while all workers are busy"""

    first: int
    last: int
    seconds: float


@dataclass
class _Worker:
    lane: deque[Load]
    left_s: float = 0.0
    at: int = 0  # the frame that it would read on with


def elapsed(
    loads: Sequence[Load], workers: int, lanes: bool, keys: Sequence[int] = (), decode_s: float = 0.0, alone: float = 1.0
) -> tuple[float, float]:
    """(seconds until the last worker is through, seconds of decoding that no frame of its own chunk needs).

    lanes : workers are threads with a stretch each;  keys : frames that decoding can begin at;  decode_s : of a frame
    alone : time of one worker that is alone, as a share of its time beside others that are busy
    """
    workers = max(min(workers, len(loads)), 1)
    every = stretches(loads, workers if lanes else 1) or [deque()]
    crew = [_Worker(every[k] if lanes and k < len(every) else every[0]) for k in range(workers)]
    now = lead = 0.0
    while True:
        for w in crew:
            while w.left_s <= 0 and (load := taken(w.lane, every)) is not None:
                extra = 0.0 if load.first == w.at else decode_s * (load.first - _key(keys, load.first))
                w.left_s, w.at, lead = load.seconds + extra, load.last + 1, lead + extra
        busy = [w for w in crew if w.left_s > 0]
        if not busy:
            return now, lead
        # beside all others a worker takes its own time, alone the share `alone` of it; linear between these
        slowness = 1.0 if len(busy) >= max(workers, 2) else alone + (1 - alone) * (len(busy) - 1) / max(workers - 1, 1)
        speed = 1 / slowness
        step = min(w.left_s for w in busy) / speed
        now += step
        for w in busy:
            w.left_s -= step * speed
            if w.left_s < 1e-12:
                w.left_s = 0.0


def _key(keys: Sequence[int], frame: int) -> int:
    """The last key frame up to `frame`; the clip's first one where none is known."""
    at = bisect_right(keys, frame)
    return keys[at - 1] if at else 0
