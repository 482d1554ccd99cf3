from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from arfx.errors import JobInterruptedError
from arfx.reproduce import PAPERS, s1
from arfx.reproduce.rows import Row, row
from arfx.reproduce.work import Work
from tests.cli.conftest import Run

STATED = {"equation (1)": {"printed": "2.0"}}


@pytest.fixture(autouse=True)
def one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """The papers' rows have tests of their own."""
    monkeypatch.setattr(
        s1,
        "rows",
        lambda work: iter([row(STATED, "equation (1)", 2.0 + 0.01 * work.short)]),
    )


def test_a_paper_is_reproduced(arfx: Run, tmp_path: Path) -> None:
    done = arfx("reproduce", "s1", "-o", "out", "--json")
    assert done.code == 0 and done.json == {
        "rows": [
            {
                "paper": "s1", "item": "equation (1)", "printed": 2.0, "paper_formula": 2.0, "corrected": None, "unit": "",
                "verdict": "holds", "reason": "",
            }
        ]
    }  # fmt: skip
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["s1.html"]
    again = arfx("reproduce", "s1", "-o", "out")
    assert (
        again.code == 2
        and "s1.html exists" in again.err
        and "--overwrite" in again.err
    )
    over = arfx("reproduce", "s1", "-o", "out", "--overwrite", "--short")
    assert (
        over.code == 0
        and "equation (1)" in over.out
        and "2.01" in over.out
        and "page: out/s1.html" in over.err
    )


def test_what_is_not_arfxs_is_not_replaced(arfx: Run, tmp_path: Path) -> None:
    (tmp_path / "s1.html").write_text("mine")
    done = arfx("reproduce", "s1", "-o", ".", "--overwrite")
    assert (
        done.code == 2
        and "was not written by arfx" in done.err
        and (tmp_path / "s1.html").read_text() == "mine"
    )


def test_what_is_interrupted_is_not_said_to_be_resumable(
    arfx: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(work: Work) -> Iterator[Row]:
        raise JobInterruptedError(
            "kept in a folder", "the same command with --resume goes on"
        )

    monkeypatch.setattr(s1, "rows", interrupted)
    done = arfx("reproduce", "s1", "-o", "out")
    assert (
        done.code == 130
        and "resume" not in done.err
        and not (tmp_path / "out").exists()
    )


def test_a_paper_that_is_not_there_is_refused(arfx: Run) -> None:
    done = arfx("reproduce", "s5", "-o", "out")
    assert (
        done.code == 2
        and "'s1', 's2', 's3', 's4', 'all'" in done.err
        and list(PAPERS) == ["s1", "s2", "s3", "s4"]
    )
