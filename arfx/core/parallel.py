"""Work on several threads: items of a list, rows of a picture in bands. Kernels release the
GIL.

What is computed never depends on the number of threads: bands depend on the picture alone,
so that sums over bands are the same everywhere."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from threading import current_thread
from typing import TypeVar

from arfx.core.machine import usable_cores

S = TypeVar("S")
T = TypeVar("T")
# the environment of one of several processes: one thread for its kernels, its matrices and
# its software rendering each
ONE_THREAD = dict.fromkeys(
    (
        "LP_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
    ),
    "1",
)
BANDS = 4
_NAME = "parallel"
_SMALL = 64  # rows: below it threads cost more than they save


@cache
def _pool(pid: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_threads(), _NAME)


@cache
def _threads() -> int:
    """As many as compiled code may use here."""
    return max(
        min(
            usable_cores(), int(os.environ.get("NUMBA_NUM_THREADS") or usable_cores())
        ),
        1,
    )


def parallel_map(work: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """work(item) of each, in their order. Called by `work` itself it starts no threads."""
    every = list(items)
    if min(_threads(), len(every)) < 2 or current_thread().name.startswith(_NAME):
        return [work(item) for item in every]
    return list(_pool(os.getpid()).map(work, every))


def parallel_rows(
    work: Callable[[int, int], T], height: int, unit: int = 1, least: int = _SMALL
) -> list[T]:
    """work(first row, row behind the last) of each band, in order of rows.
    unit : bands begin at multiples of it;  least : fewer rows are done one band after the other
    """
    step = -(-height // (BANDS * unit)) * unit
    spans = (
        [(y, min(y + step, height)) for y in range(0, height, step)] if height else []
    )
    return (
        [work(*span) for span in spans]
        if height < least
        else parallel_map(lambda span: work(*span), spans)
    )
