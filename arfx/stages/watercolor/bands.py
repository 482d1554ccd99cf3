"""Rows of a picture in bands, each on a thread of its own where a core is free. Kernels release the GIL.

The bands depend on the picture alone, never on the machine, so that sums over bands are the same everywhere.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

T = TypeVar("T")
BANDS = 4
_SMALL = 64  # rows: below it threads cost more than they save


@cache
def _pool(pid: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(min(os.cpu_count() or 1, BANDS), 1), "watercolor")


def by_bands(work: Callable[[int, int], T], height: int, unit: int = 1, least: int = _SMALL) -> list[T]:
    """work(first row, row behind the last) of each band, in order of rows.

    unit : bands begin at multiples of it;  least : fewer rows are done one band after the other
    """
    step = -(-height // (BANDS * unit)) * unit
    spans = [(y, min(y + step, height)) for y in range(0, height, step)] if height else []
    if height < least or (os.cpu_count() or 1) < 2:
        return [work(*span) for span in spans]
    return list(_pool(os.getpid()).map(lambda span: work(*span), spans))
