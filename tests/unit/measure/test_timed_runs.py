"""The clock of the price list."""

from __future__ import annotations

import time

import numba
import pytest

from arfx.measure.timing import Stopwatch


@pytest.mark.parametrize("processor", [False, True])
def test_compiling_is_no_part_of_what_work_takes(processor: bool) -> None:
    @numba.njit
    def fresh(x):
        return [x + i for i in range(3)]

    clock = time.process_time if processor else time.perf_counter
    start = clock()
    seconds = Stopwatch(processor).of(lambda: fresh(1.0))
    assert seconds < (clock() - start) / 2
