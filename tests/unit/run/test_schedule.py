"""How long workers take over chunks: what is known by hand."""

from __future__ import annotations

import pytest

from arfx.run.schedule import elapsed


def test_work_is_shared_as_far_as_chunks_allow() -> None:
    assert elapsed([1, 1, 1, 1], 2) == 2.0
    assert elapsed([1, 1, 1], 2) == 2.0, "the third chunk has no counterpart"
    assert elapsed([3, 1, 1, 1], 2) == 3.0, (
        "who is through takes from the other's end"
    )
    assert elapsed([6, 0, 0, 0], 2) == 6.0, "all the work in one chunk helps nobody"
    assert elapsed([1, 2, 3], 1) == 6.0
    assert elapsed([], 2) == 0.0


def test_one_that_is_alone_is_faster_than_among_others() -> None:
    assert elapsed([6, 2], 2, alone=0.5) == pytest.approx(2 + 4 * 0.5)
    assert elapsed([4], 1, alone=0.5) == pytest.approx(2.0)
