from __future__ import annotations

from typing import Any

import pytest

from arfx.reproduce.rows import DIFFERS, HOLDS, UNDERIVED, Row, range_of, row


@pytest.mark.parametrize(
    ("printed", "half"),
    [
        ("58.7", 0.05),
        ("2.4413", 0.00005),
        ("60", 0.5),
        ("5.4e-3", 0.05e-3),
        ("1", 0.5),
        ("0.035", 0.0005),
    ],
)
def test_digits_printed_give_the_tolerance(printed: str, half: float) -> None:
    middle = float(printed)
    assert range_of(printed) == pytest.approx((middle - half, middle + half))


def test_a_range_is_what_lies_in_it_and_words_are_none() -> None:
    assert range_of("9–13") == (9, 13)
    assert range_of("60", 2) == pytest.approx((58, 62))
    assert range_of("left – right") is None


def beside(printed: str, values: Any, holds: Any = None, **stated: Any) -> Row:
    return row({"a": {"printed": printed, **stated}}, "a", values, holds)


def test_a_verdict_follows_from_the_values() -> None:
    assert beside("58.7", (58.7428, 58.6512)).verdict == HOLDS
    assert beside("58.7", 58.7428, reason="of no use").reason == ""
    differs = beside("58.7", (58.7428, 54.1451), reason="why")
    assert (differs.verdict, differs.reason, differs.printed) == (
        DIFFERS,
        "why",
        58.7,
    )
    assert beside("58.7", 58.76).verdict == DIFFERS
    assert beside("126.746", (None, 120.38)).verdict == UNDERIVED
    assert beside("14", 16.0, tolerance=2).verdict == HOLDS
    assert beside("left", ("left", "left")).verdict == HOLDS
    assert beside("left", ("left", "right")).verdict == DIFFERS
    assert beside("9–13", (9.5, 12)).verdict == HOLDS
    assert beside("9–13", (9.5, 14)).verdict == DIFFERS
    assert beside("alike", (0.1, 0.3), below=0.2).verdict == DIFFERS
    assert beside("8", (9.5, 12), True).printed == "8"


def test_texts_name_what_goes_with_the_values() -> None:
    stated = {"a": {"printed": "{n}", "reason": "{why} alone", "unit": "of {n}"}}
    found = row(stated, "a", 5, n=4, why="noise")
    assert (found.printed, found.unit, found.reason) == (4, "of 4", "noise alone")
