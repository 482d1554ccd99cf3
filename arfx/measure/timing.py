"""Clocks, and what they told run by run."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
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
        clock, compiling = (
            time.process_time if self.processor else time.perf_counter,
            [0.0],
        )
        start = clock()
        with install_timer("numba:compile", compiling.append):
            work()
        return max(clock() - start - sum(compiling), 0.0)

    def of_concurrent(self, work: Callable[[], Any]) -> float:
        """Of one run, as many at once as `concurrency`."""
        assert self.pool is not None
        if self.processor:
            pool = self.pool
            return (
                self.of(lambda: list(pool.map(lambda _: work(), range(self.concurrency))))
                / self.concurrency
            )
        return float(
            np.mean(list(self.pool.map(lambda _: self.of(work), range(self.concurrency))))
        )


WALL = Stopwatch()
PROCESSOR = Stopwatch(processor=True)
