"""Clocks, and what they told run by run."""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from numba.core.event import install_timer


@dataclass
class Runs:
    """What was timed for one entry of the price list: terms and seconds, run by run."""

    terms: list[Mapping[str, float]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, terms: Mapping[str, float], seconds: float) -> None:
        self.terms.append(terms)
        self.seconds.append(max(seconds, 1e-7))


@dataclass(frozen=True)
class Stopwatch:
    """Seconds of work, less those in which numba compiled for it: later work is spared them.

    processor : processor time, which other programs disturb least, not wall-clock time;
    divided by the threads that work at
    once, both are the same on a machine that does nothing else
    pool, concurrency : so many of its threads do the same work at once, as in a job"""

    processor: bool = False
    pool: ThreadPoolExecutor | None = None
    concurrency: int = 1

    def of(self, work: Callable[[], Any]) -> float:
        clock = time.process_time if self.processor else time.perf_counter
        start, compiling = clock(), [0.0]
        with install_timer("numba:compile", compiling.append):
            work()
        return max(clock() - start - sum(compiling), 0.0)

    def of_concurrent(self, work: Callable[[], Any]) -> float:
        """Of one run, as many at once as `concurrency`."""
        pool, count = self.pool, self.concurrency
        assert pool is not None
        if self.processor:
            return (
                self.of(lambda: [*pool.map(lambda _: work(), range(count))]) / count
            )
        return sum(pool.map(lambda _: self.of(work), range(count))) / count


WALL = Stopwatch()
PROCESSOR = Stopwatch(processor=True)
