"""`arfx stages`: the list of all settings, for people and for programs."""

from __future__ import annotations

import pytest

from arfx.config.sections import section_models
from arfx.run.parameters import parameters
from arfx.stages import STAGES
from tests.cli.conftest import Run


def test_every_stage_has_its_line_in_running_order(arfx: Run) -> None:
    r = arfx("stages")
    assert r.code == 0 and not r.err
    places = [r.out.index(f"| `{name}` |") for name in STAGES]
    assert places == sorted(places) and "`output`" in r.out


def test_every_setting_is_in_the_data_with_its_text(arfx: Run) -> None:
    document = arfx("stages", "--json").json
    found = {
        (d["name"], s["name"]): s
        for d in document["stages"] + document["sections"]
        for s in d["settings"]
    }
    kinds = (
        (name, kind)
        for name, formulas in parameters().items()
        for kind in formulas.values()
    )
    of_stages = {(name, key) for name, kind in kinds for key in kind.model_fields}
    assert set(found) == of_stages | {
        (name, key)
        for name, model in section_models().items()
        for key in model.model_fields
    }
    assert [key for key, s in found.items() if not (s["text"] and s["type"])] == []
    assert (
        found["dof", "coc_mm"]["formula"] == "paper"
        and "formula" not in found["dof", "blades"]
    )
    assert (
        found["dof", "fnumber"]["default"] == 2.8
        and found["model", "fit"]["type"] == "length"
    )


def test_a_stage_says_what_it_reads_and_what_its_levels_cost(arfx: Run) -> None:
    d = arfx("stages", "gi", "--json").json
    assert (
        d["writes"] == ["shadow", "virtual"]
        and "environment" in d["facts"]
        and not d["always"]
    )
    assert [e["level"] for e in d["levels"]] == list(STAGES["gi"].levels)
    assert all(
        e["price_ms"] and all(ms > 0 for ms in e["price_ms"].values())
        for e in d["levels"]
    )
    said = arfx("stages", "gi").out
    assert d["about"] in said and "gi.strength = 1.0" in said and "Prices: " in said


@pytest.mark.parametrize(
    ("name", "near"), [("doff", "'dof'"), ("outputs", "'output'")]
)
def test_an_unknown_name_gets_the_nearest(arfx: Run, name: str, near: str) -> None:
    r = arfx("stages", name)
    assert r.code == 2 and near in r.err and not r.out
