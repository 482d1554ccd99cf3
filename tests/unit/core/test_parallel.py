"""Work on several threads: the same results in the same order, errors raised where they are
asked for, nothing kept.
"""

from __future__ import annotations

import weakref
from concurrent.futures import ThreadPoolExecutor
from threading import Event, get_ident

import numpy as np
import pytest

from arfx.core.parallel import BackgroundTask, parallel_map, parallel_rows


def test_bands_come_in_order_whoever_does_them_and_errors_come_out() -> None:
    spans = parallel_rows(lambda a, b: (a, b), 1000, 8)
    assert [a for a, _ in spans] == [0, *(b for _, b in spans[:-1])] and spans[-1][
        1
    ] == 1000
    with ThreadPoolExecutor(4) as pool:
        assert all(
            made == spans
            for made in pool.map(
                lambda _: parallel_rows(lambda a, b: (a, b), 1000, 8), range(64)
            )
        )
    with pytest.raises(ZeroDivisionError):
        parallel_rows(lambda a, b: 1 // (a - 256), 1000, 8)


@pytest.mark.parametrize("cores", [1, 2])
def test_a_background_task_is_made_once_whoever_is_free(
    monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    monkeypatch.setattr("arfx.core.parallel._threads", lambda: cores)
    gate, made = Event(), []
    blocked = [BackgroundTask(gate.wait) for _ in range(8)]  # no thread is left
    late = BackgroundTask(lambda: made.append(get_ident()) or len(made))
    after = BackgroundTask(lambda: late() + 1)  # one may wait for another
    if cores > 1:
        assert late() == 1 and after() == 2 and made == [get_ident()]  # by the one who asks
    gate.set()
    assert all(b() for b in blocked) and (late(), late(), after(), len(made)) == (
        1,
        1,
        2,
        1,
    )
    wrong = BackgroundTask(lambda: 1 // 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            wrong()
    if cores == 1:
        holder = BackgroundTask(lambda: np.zeros(8))
        gone = weakref.ref(holder())
        del holder
        assert gone() is None  # nothing that waits in a queue holds it


def test_a_map_keeps_the_order_of_its_items(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores in (1, 3):
        monkeypatch.setattr("arfx.core.parallel._threads", lambda cores=cores: cores)
        assert parallel_map(lambda n: n * n, range(100)) == [n * n for n in range(100)]
