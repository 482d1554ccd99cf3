"""`arfx lens` as a user runs it."""

from __future__ import annotations

import pytest

from tests.cli.conftest import Run

EXAMPLE = (
    "lens",
    "--focal",
    "200mm",
    "--fnumber",
    "11",
    "--distance",
    "2500mm",
    "--coc",
    "0.035mm",
)


def test_limits_of_both_formulas(arfx: Run) -> None:
    r = arfx(*EXAMPLE, "--json")
    assert r.code == 0, r.err
    paper, corrected = r.json["paper"], r.json["corrected"]
    want = {
        "front_mm": 58.74275,
        "back_mm": 61.63945,
        "total_mm": 120.3125,
        "hyperfocal_mm": 103896.1039,
    }
    assert {k: paper[k] for k in want} == pytest.approx(want, abs=1e-4)
    want = {
        "front_mm": 54.14511,
        "back_mm": 56.59666,
        "total_mm": 110.74177,
        "hyperfocal_mm": 104096.1039,
    }
    assert {k: corrected[k] for k in want} == pytest.approx(want, abs=1e-4)
    assert (
        paper["coc_at_infinity_mm"]
        == corrected["coc_at_infinity_mm"]
        == pytest.approx(1.58103, abs=1e-5)
    )
    assert not corrected["back_is_infinite"]


def test_beyond_the_hyperfocal_distance(arfx: Run) -> None:
    r = arfx(
        "lens", "--focal", "24mm", "--fnumber", "8", "--distance", "5m", "--json"
    )
    assert (
        r.json["corrected"]["back_mm"] is None
        and r.json["corrected"]["back_is_infinite"]
    )
    assert (
        "infinite"
        in arfx("lens", "--focal", "24mm", "--fnumber", "8", "--distance", "5m").out
    )


def test_focus_within_the_focal_length_is_one_message(arfx: Run) -> None:
    r = arfx("lens", "--focal", "200mm", "--fnumber", "11", "--distance", "20cm")
    assert r.code == 3 and "cannot be focused at 200 mm" in r.err and not r.out
    assert (
        arfx("lens", "--focal", "200", "--fnumber", "11", "--distance", "1m").code
        == 2
    )
