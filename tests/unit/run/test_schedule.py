"""How long workers take over chunks: what is known by hand."""

from __future__ import annotations

import pytest

from arfx.run.schedule import Load, elapsed


def loads(*seconds: float) -> list[Load]:
    return [Load(10 * k, 10 * k + 9, s) for k, s in enumerate(seconds)]


def test_work_is_shared_as_far_as_chunks_allow() -> None:
    assert elapsed(loads(1, 1, 1, 1), 2) == (2.0, 0.0)
    assert elapsed(loads(1, 1, 1), 2)[0] == 2.0, "the third chunk has no counterpart"
    assert elapsed(loads(3, 1, 1, 1), 2)[0] == 3.0, (
        "who is through takes from the end of the other's stretch"
    )
    assert elapsed(loads(6, 0, 0, 0), 2)[0] == 6.0, "all the work in one chunk helps nobody"
    assert elapsed(loads(1, 2, 3), 1) == (6.0, 0.0)
    assert elapsed([], 2) == (0.0, 0.0)


def test_one_that_is_alone_is_faster_than_among_others() -> None:
    assert elapsed(loads(6, 2), 2, alone=0.5)[0] == pytest.approx(2 + 4 * 0.5)
    assert elapsed(loads(4), 1, alone=0.5)[0] == pytest.approx(2.0)


def test_a_worker_that_begins_in_the_middle_decodes_from_the_key_frame_before() -> None:
    wall_s, lead_s = elapsed(loads(1, 1, 1, 1), 2, keys=(0, 15), decode_s=0.1)
    assert lead_s == pytest.approx(0.5), "frame 20 stands five behind the key frame 15"
    assert wall_s == pytest.approx(2.5)
    assert elapsed(loads(1, 1), 2, keys=(0, 10), decode_s=0.1) == (1.0, 0.0)
