"""What the price list is fitted to: the clock, and the runs that it timed."""

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
class Watch:
    """Seconds of work, less those in which numba compiled for it: later work is spared them.

    processor : count those of the processor, which other programs disturb least, not those of the wall;
    shared by the threads that work at once both are the same on a machine that does nothing else
    pool, crowd : so many of its threads do the same work at once, as in a job
    """

    processor: bool = False
    pool: ThreadPoolExecutor | None = None
    crowd: int = 1

    def of(self, work: Callable[[], Any]) -> float:
        clock, compiling = time.process_time if self.processor else time.perf_counter, [0.0]
        start = clock()
        with install_timer("numba:compile", compiling.append):
            work()
        return max(clock() - start - sum(compiling), 0.0)

    def of_each(self, work: Callable[[], Any]) -> float:
        """Of one run in the crowd."""
        assert self.pool is not None
        if self.processor:
            pool = self.pool
            return self.of(lambda: list(pool.map(lambda _: work(), range(self.crowd)))) / self.crowd
        return float(np.mean(list(self.pool.map(lambda _: self.of(work), range(self.crowd)))))


WALL = Watch()
