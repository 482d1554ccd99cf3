"""The short form of every paper: its rows are complete, and their verdicts are those
recorded in verdicts/.

`python -m tests.unit.reproduce.test_papers s1` records those of a paper anew; look at every
one that changes. A verdict that depends on the machine (a rate, memory) is recorded as
"measured"."""

from __future__ import annotations

import json
import math
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import pytest

from arfx.reproduce import PAPERS
from arfx.reproduce.rows import HOLDS, statements
from arfx.reproduce.work import Work

RECORDED = Path(__file__).with_name("verdicts")
MEASURED = "measured"


def verdicts(paper: str, folder: Path) -> dict[str, str]:
    """Of rows that are complete."""
    rows = [*import_module(f"arfx.reproduce.{paper}").rows(Work(folder, short=True))]
    assert sorted(r.item for r in rows) == sorted(statements(paper))
    for r in rows:
        assert r.verdict == HOLDS or r.reason.strip(), r.item
        assert bool(r.pictures) <= bool(r.title), r.item
        for value in (r.printed, r.paper_formula, r.corrected):
            assert not isinstance(value, float) or math.isfinite(value), r.item
    return {r.item: r.verdict for r in rows}


def recorded(paper: str) -> dict[str, str]:
    read: dict[str, str] = json.loads(
        (RECORDED / f"{paper}.json").read_text(encoding="utf-8")
    )
    return read


@pytest.mark.parametrize("paper", list(PAPERS))
def test_every_item_has_its_row_and_verdict(paper: str, tmp_path: Path) -> None:
    found, expected = verdicts(paper, tmp_path), recorded(paper)
    assert list(found) == list(expected)
    assert {k: v for k, v in found.items() if expected[k] != MEASURED} == {
        k: v for k, v in expected.items() if v != MEASURED
    }


if __name__ == "__main__":
    for name in sys.argv[1:]:
        with tempfile.TemporaryDirectory() as scratch:
            now = verdicts(name, Path(scratch))
        kept = recorded(name) if (RECORDED / f"{name}.json").exists() else {}
        lines = {
            item: MEASURED if kept.get(item) == MEASURED else verdict
            for item, verdict in now.items()
        }
        (RECORDED / f"{name}.json").write_text(
            json.dumps(lines, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )
