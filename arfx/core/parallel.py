"""Work on several threads: items of a list, rows of a picture in bands, whole tasks in the
background. Kernels release the GIL.

What is computed never depends on the number of threads: bands depend on the picture alone,
so that sums over bands are the same everywhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from threading import Lock
from typing import Any, Generic, TypeVar

from arfx.core.machine import usable_cores

S = TypeVar("S")
T = TypeVar("T")
# the environment of one of several processes: one thread for its kernels, its matrices and
# its software rendering each
ONE_THREAD = dict.fromkeys(
    ("LP_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"
)
BANDS = 4
_SMALL = 64  # rows: below it threads cost more than they save


@cache
def _pool(pid: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(_threads() - 1, 1), "parallel")


@cache
def _threads() -> int:
    """As many as compiled code may use here."""
    return max(
        min(usable_cores(), int(os.environ.get("NUMBA_NUM_THREADS") or usable_cores())), 1
    )


def parallel_map(work: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """work(item) of each, in their order.
    The caller works too and waits for no thread that has not begun: where cores are busy it
    does all the work itself."""
    every = list(items)
    others = min(_threads(), len(every)) - 1
    if others < 1:
        return [work(item) for item in every]
    shared = [(work, every, iter(range(len(every))))]
    out: dict[int, T] = {}
    begun = [_pool(os.getpid()).submit(_do_pending, shared, out) for _ in range(others)]
    try:
        _do_pending(shared, out)
    finally:
        for other in begun:
            if not other.cancel():
                other.result()
        # one that never began may stay in the queue for a while: it holds no picture
        shared.clear()
    results = [out[k] for k in range(len(every))]
    out.clear()
    return results


def _do_pending(shared: list[Any], out: dict[int, Any]) -> None:
    """Do the items that nobody has begun."""
    for work, items, todo in tuple(shared):
        for k in todo:
            out[k] = work(items[k])


def parallel_rows(
    work: Callable[[int, int], T], height: int, unit: int = 1, least: int = _SMALL
) -> list[T]:
    """work(first row, row behind the last) of each band, in order of rows.
    unit : bands begin at multiples of it;  least : fewer rows are done one band after the other
    """
    step = -(-height // (BANDS * unit)) * unit
    spans = [(y, min(y + step, height)) for y in range(0, height, step)] if height else []
    return (
        [work(*span) for span in spans]
        if height < least
        else parallel_map(lambda span: work(*span), spans)
    )


class BackgroundTask(Generic[T]):
    """Something that is made on another thread if a core is free before it is asked for,
    else by the one who asks first.
    """

    def __init__(self, work: Callable[[], T]) -> None:
        self._work: Callable[[], T] | None = work
        self._lock, self._out, self._offered = Lock(), Future[T](), [self]
        self._begun = (
            _pool(os.getpid()).submit(_make_offered, self._offered)
            if _threads() > 1
            else None
        )

    def make(self) -> None:
        with self._lock:
            work, self._work = self._work, None
            if work is None:
                return
            try:
                self._out.set_result(work())
            except BaseException as why:
                self._out.set_exception(why)

    def __call__(self) -> T:
        """Raises what the work raises."""
        if self._begun is None or self._begun.cancel():
            self.make()
        out = self._out.result()
        # what never began may stay in the queue for a while: it holds no picture
        self._offered.clear()
        return out


def _make_offered(offered: list[BackgroundTask[Any]]) -> None:
    for one in tuple(offered):
        one.make()
