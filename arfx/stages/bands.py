"""Rows of a picture in bands, each on a thread of its own where a core is free. Kernels release the GIL.

The bands depend on the picture alone, never on the machine, so that sums over bands are the same everywhere.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")
BANDS = 4
_SMALL = 64  # rows: below it threads cost more than they save


@cache
def _pool(pid: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(_threads() - 1, 1), "bands")


def _threads() -> int:
    return max(min(os.cpu_count() or 1, BANDS), 1)


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
