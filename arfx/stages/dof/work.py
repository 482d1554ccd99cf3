"""Strips of a picture on all cores: compiled code lets other threads run. What is computed does not depend on how many."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numba

_T = TypeVar("_T")
_making = threading.Lock()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "dof")


def on_all_cores(work: Callable[[_T], object], items: Iterable[_T]) -> None:
    """work(item) for every item; as many at once as compiled code may use threads here (NUMBA_NUM_THREADS)."""
    every, threads = list(items), numba.config.NUMBA_NUM_THREADS
    if threads < 2 or len(every) < 2:
        for item in every:
            work(item)
        return
    with _making:
        pool = _pool(threads)
    for _ in pool.map(work, every):
        pass
