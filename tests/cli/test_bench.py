"""`arfx bench` as a process."""

from __future__ import annotations

from arfx.stages import STAGES
from tests.cli.conftest import Run


def test_every_stage_has_its_row(arfx: Run) -> None:
    r = arfx("bench", "--level", "standard", "--size", "160x120", "--json")
    assert r.code == 0, r.err
    rows = r.json
    assert {row["stage"] for row in rows} == set(STAGES), (
        "those that need measured depth too"
    )
    assert {"stage", "level", "size", "ms", "yardstick_ms", "ratio", "error"} <= set(
        rows[0]
    )
    assert next(row["error"] for row in rows if row["stage"] == "lightmap") > 0
    assert all(
        row["ms"] > 0 and row["ratio"] > 0 and row["size"] == "160x120"
        for row in rows
    )


def test_the_table_is_for_people(arfx: Run) -> None:
    r = arfx("bench", "--stage", "composite", "--size", "160x120")
    assert (
        r.code == 0
        and "composite" in r.out
        and "ratio" in r.out
        and "error" in r.out
        and "raster" not in r.out
    )


def test_what_is_unknown_is_a_usage_error(arfx: Run) -> None:
    for words, said in (
        (("--stage", "rastr"), "'raster'"),
        (("--size", "big"), "1280x720"),
        (("--size", "0x0"), "from 64 to 8192 px"),
        (("--level", "hgh"), "'high'"),
    ):
        r = arfx("bench", *words)
        assert (
            r.code == 2 and said in r.err and "Traceback" not in r.err and not r.out
        )
