"""The short form of every paper: its rows are complete, and their verdicts are those
recorded in verdicts/.

`python -m tests.unit.reproduce.test_papers s1` records those of a paper anew; look at every
one that changes. A verdict that depends on the machine (a rate, memory) is recorded as
"measured"."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import pytest

from arfx.reproduce import PAPERS
from arfx.reproduce.document import items_of
from arfx.reproduce.rows import Row
from arfx.reproduce.work import Work

RECORDED = Path(__file__).with_name("verdicts")
MEASURED = "measured"


def verdicts(paper: str, folder: Path) -> dict[str, str]:
    return {
        i.item: i.verdict
        for i in items_of(paper, Work(folder, short=True))
        if isinstance(i, Row)
    }


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
