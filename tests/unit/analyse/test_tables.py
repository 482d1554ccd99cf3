"""Rows by columns, and as files: what comes back is what was kept, and nothing damaged is
believed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

from arfx.analyse.tables import from_bytes, rows_of, tables_of, to_bytes
from tests.exact import identical


@dataclass(frozen=True, eq=False)
class Inner:
    name: str
    grid: np.ndarray


class Other(NamedTuple):
    frame: int


class Row(NamedTuple):
    frame: int
    level: float
    seen: bool
    points: np.ndarray
    extra: np.ndarray | None
    inner: Inner


def row(frame: int, count: int, extra: np.ndarray | None) -> Row:
    points = np.arange(2.0 * count, dtype=np.float32).reshape(count, 2)
    return Row(frame, 0.1 * frame, frame > 1, points, extra, Inner("ß", np.eye(2)))


ROWS = [
    row(0, 3, None),
    row(2, 0, np.zeros((2, 0), np.uint8)),
    row(5, 1, np.ones(4, np.uint8)),
]


def same(a: Row, b: Row) -> bool:
    return identical(
        [*a[:5], a.inner.name, a.inner.grid], [*b[:5], b.inner.name, b.inner.grid]
    )


def test_rows_come_back_as_they_were() -> None:
    kept = from_bytes(to_bytes(tables_of([*ROWS, Other(3)])))
    again = rows_of(kept, Row)
    assert len(again) == 3 and all(map(same, again, ROWS))
    assert rows_of(kept, Other) == [Other(3)] and rows_of({}, Row, 7) == []


def test_frames_are_counted_on() -> None:
    tables = tables_of(ROWS)
    assert [r.frame for r in rows_of(tables, Row, 7)] == [7, 9, 12]
    assert [r.level for r in rows_of(tables, Row, 7)] == [r.level for r in ROWS]


def test_equal_rows_give_equal_bytes() -> None:
    assert to_bytes(tables_of(ROWS)) == to_bytes(tables_of(ROWS))


def test_every_damage_is_seen() -> None:
    good = to_bytes(tables_of(ROWS))
    bad = [good[:n] for n in (0, 1, 100, len(good) - 1)] + [good + b"\0"]
    bad += [bytes([*good[:i], good[i] ^ 1, *good[i + 1 :]]) for i in range(len(good))]
    for data in bad:
        with pytest.raises(ValueError, match="whole file"):
            from_bytes(data)


def test_objects_are_refused() -> None:
    """Nothing that is read names code to run."""
    with pytest.raises(ValueError, match="pickle"):
        from_bytes(to_bytes({"a": {"b": np.array([print], object)}}))
