"""In which order the tests run: tests/conftest.py."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.conftest import LONG, longest_first

TESTS = Path(__file__).parents[1]


def test_every_long_file_is_there() -> None:
    assert [name for name in LONG if not (TESTS / f"{name}.py").is_file()] == []
    assert [name for name, count in Counter(LONG).items() if count > 1] == []


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_each_process_gets_long_files_first_and_short_ones_to_the_end(
    processes: int,
) -> None:
    files = [f"{name}.py" for name in LONG for _ in range(3)] + [
        f"unit/short_{n}.py" for n in range(400)
    ]
    items: list[Any] = [SimpleNamespace(path=TESTS / file) for file in sorted(files)]
    ordered = longest_first(items, processes)
    assert sorted(map(id, ordered)) == sorted(map(id, items))
    done, seen = 0, list[str]()
    for k in range(processes):  # as pytest-xdist shares them out
        count = (len(items) - done) // (processes - k)
        short = ["short" in item.path.name for item in ordered[done : done + count]]
        assert (
            not short[0] and short[-100:] == [True] * 100 and short == sorted(short)
        )
        seen += dict.fromkeys(
            str(i.path)
            for i, s in zip(ordered[done : done + count], short, strict=True)
            if not s
        )
        done += count
    assert len(seen) == len(set(seen)) == len(LONG), (
        "no file is shared by two processes"
    )
