"""The document and the pages."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from arfx.reproduce import PAPERS, Paper
from arfx.reproduce.document import reproduce
from arfx.reproduce.rows import Row, row
from arfx.reproduce.work import Work

GREY = np.full((24, 32, 3), 90, np.uint8)


@pytest.fixture
def items(monkeypatch: pytest.MonkeyPatch) -> list[Row]:
    """What the module of s1 yields."""
    found: list[Row] = []

    module = import_module("arfx.reproduce.s1")
    monkeypatch.setattr(module, "rows", lambda work: iter(found))
    monkeypatch.setitem(PAPERS, "s1", Paper("Some <One> 2009", "A title"))
    return found


def test_a_page_holds_rows_pictures_and_error_maps(
    items: list[Row], tmp_path: Path
) -> None:
    stated = {
        "figure 1": {"printed": "a & b", "title": "lights"},
        "table 1, apple": {
            "printed": "9–13",
            "unit": "fps",
            "reason": "another machine <here>",
        },
    }
    pictures = {
        "before": GREY,
        "printed": GREY,
        "corrected": GREY + 8,
        "reference": GREY + 9,
    }
    items += [
        row(stated, "figure 1", "a & b", None, pictures),
        row(stated, "table 1, apple", 4.25),
    ]
    document = reproduce(["s1"], tmp_path / "new", Work(tmp_path))
    assert [r["item"] for r in document["rows"]] == ["figure 1", "table 1, apple"]
    assert set(document["rows"][1]) == {
        "paper", "item", "printed", "paper_formula", "corrected", "unit", "verdict", "reason",
    }  # fmt: skip
    html = (tmp_path / "new" / "s1.html").read_text(encoding="utf-8")
    assert (
        "another machine &lt;here&gt;" in html
        and "Some &lt;One&gt; 2009" in html
        and "a &amp; b" in html
    )
    assert html.count("data:image/jpeg") == 6
    assert (
        "printed: 9.00 grey levels from reference" in html
        and "corrected: 1.00 grey levels" in html
    )
    assert "<link" not in html and "src=" in html and "http" not in html
