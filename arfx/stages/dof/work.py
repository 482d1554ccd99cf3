"""Strips of a picture on all cores: compiled code lets other threads run. What is computed does not depend on how many."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numba
import numpy as np

_T = TypeVar("_T")
_making = threading.Lock()
_own = threading.local()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "dof")


def on_all_cores(work: Callable[[_T], object], items: Iterable[_T]) -> None:
    """work(item) for every item; as many at once as compiled code may use threads here (NUMBA_NUM_THREADS)."""
    every, threads = list(items), numba.get_num_threads()
    if threads < 2 or len(every) < 2:
        for item in every:
            work(item)
        return
    with _making:
        pool = _pool(threads)
    for _ in pool.map(work, every):
        pass


def zeros(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A float32 array of zeros that this thread uses again under the same name: fresh memory costs more than clearing it."""
    size = int(np.prod(shape))
    kept: dict[str, np.ndarray] = _own.__dict__
    if name not in kept or kept[name].size < size:
        kept[name] = np.empty(size, np.float32)
    part = kept[name][:size].reshape(shape)
    part.fill(0)
    return part
