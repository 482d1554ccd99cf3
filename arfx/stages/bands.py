"""Rows of a picture in bands, each on a thread of its own where a core is free; and whole tasks beside each other. Kernels
release the GIL.

The bands depend on the picture alone, never on the machine, so that sums over bands are the same everywhere.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from threading import Lock
from typing import Any, Generic, TypeVar

from arfx.core.machine import usable_cores

T = TypeVar("T")
BANDS = 4
_SMALL = 64  # rows: below it threads cost more than they save


@cache
def _pool(pid: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(_threads() - 1, 1), "bands")


def _threads() -> int:
    return max(min(usable_cores(), BANDS), 1)


def by_bands(work: Callable[[int, int], T], height: int, unit: int = 1, least: int = _SMALL) -> list[T]:
    """work(first row, row behind the last) of each band, in order of rows.

    unit : bands begin at multiples of it;  least : fewer rows are done one band after the other
    The caller works too and waits for none that has not begun: where cores are busy it does all the bands itself.
    """
    step = -(-height // (BANDS * unit)) * unit
    spans = [(y, min(y + step, height)) for y in range(0, height, step)] if height else []
    others = min(_threads(), len(spans)) - 1
    if height < least or others < 1:
        return [work(*span) for span in spans]
    shared = [(work, spans, iter(range(len(spans))))]
    out: dict[int, T] = {}
    begun = [_pool(os.getpid()).submit(_take, shared, out) for _ in range(others)]
    try:
        _take(shared, out)
    finally:
        for other in begun:
            if not other.cancel():
                other.result()
        shared.clear()  # one that never began may stay in the queue for a while: it holds no picture
    made = [out[k] for k in range(len(spans))]
    out.clear()
    return made


def _take(shared: list[Any], out: dict[int, Any]) -> None:
    """Do the bands that nobody has begun."""
    for work, spans, todo in tuple(shared):
        for k in todo:
            out[k] = work(*spans[k])


class Beside(Generic[T]):
    """Something that is made on another thread if a core is free before it is asked for, else by the one who asks first."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work: Callable[[], T] | None = work
        self._lock, self._out, self._offered = Lock(), Future[T](), [self]
        self._begun = _pool(os.getpid()).submit(_make_offered, self._offered) if _threads() > 1 else None

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
        self._offered.clear()  # what never began may stay in the queue for a while: it holds no picture
        return out


def _make_offered(offered: list[Beside[Any]]) -> None:
    for one in tuple(offered):
        one.make()
