from __future__ import annotations

import pytest

from arfx.reproduce.rows import (
    DIFFERS,
    HOLDS,
    UNDERIVED,
    Row,
    half_digit,
    row,
)


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
    assert half_digit(printed) == pytest.approx(half)


def test_a_verdict_follows_from_the_values() -> None:
    assert row("a", "58.7", (58.7428, 58.6512)).verdict == HOLDS
    assert row("a", "58.7", 58.7428, reason="of no use").reason == ""
    assert row("a", "58.7", (58.7428, 54.1451), reason="why").verdict == DIFFERS
    assert row("a", "58.7", 58.76, reason="why").verdict == DIFFERS
    assert (
        row(
            "a", "126.746", (None, 120.38), reason="its inputs are not stated"
        ).verdict
        == UNDERIVED
    )
    assert row("a", "14", 16.0, reason="why", tolerance=2).verdict == HOLDS
    assert row("a", "left", ("left", "left")).verdict == HOLDS
    assert row("a", "left", ("left", "right"), reason="why").verdict == DIFFERS


def test_a_row_that_does_not_hold_says_why() -> None:
    with pytest.raises(ValueError, match="no reason"):
        row("a", "58.7", (58.7428, 54.1451))
    with pytest.raises(ValueError, match="no reason"):
        row("a", "126.746", None, reason=" ")
    with pytest.raises(ValueError, match="not finite"):
        Row("a", 1.0, float("inf"), 1.0, verdict=HOLDS)
