"""Work on several threads: the same results in the same order, errors raised where they are
asked for, nothing kept.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from arfx.core.parallel import parallel_map, parallel_rows


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


def test_a_map_keeps_the_order_of_its_items(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores in (1, 3):
        monkeypatch.setattr("arfx.core.parallel._threads", lambda cores=cores: cores)
        assert parallel_map(lambda n: n * n, range(100)) == [
            n * n for n in range(100)
        ]


def test_a_map_within_a_map_waits_for_no_thread() -> None:
    def inner(n: int) -> list[int]:
        return parallel_map(lambda m: m + n, range(50))

    assert parallel_map(inner, range(40))[7] == list(range(7, 57))
