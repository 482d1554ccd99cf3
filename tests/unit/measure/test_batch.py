"""The page of a batch."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arfx.measure import batch
from arfx.run.pages import jpeg


def row(
    home: Path,
    name: str,
    code: int = 0,
    message: str = "30 frames",
    picture: bool = True,
) -> dict[str, Any]:
    report = home / name / "report.html"
    if not code:
        report.parent.mkdir()
        shown = jpeg(np.full((90, 160, 3), 120, np.uint8))
        report.write_text(
            f'<img class="out" alt="frame 3" src="{shown}">' * 3
            if picture
            else "<p>The job kept no pictures.</p>"
        )
    return {
        "clip": f"in/{name}.mp4", "output": str(home / f"{name}.mp4"), "exit_code": code, "message": message, "seconds": 2.0,
        "report": None if code else str(report),
    }  # fmt: skip


def test_links_and_names_are_escaped_and_relative(tmp_path: Path) -> None:
    html = batch.page(
        [row(tmp_path, "a & b <ü> 50%"), row(tmp_path, "c", 3, "no such <file>")],
        5,
        tmp_path,
    )
    links = re.findall(r'href="([^"]*)"', html)
    assert links == [
        "a%20%26%20b%20%3C%C3%BC%3E%2050%25/report.html",
        "a%20%26%20b%20%3C%C3%BC%3E%2050%25.mp4",
    ]
    text = unescape(re.sub(r"<[^>]*>", " ", html))
    assert "a & b <ü> 50%" in text and "no such <file>" in text and "<ü>" not in html
    assert "1 of 5" in text and re.search(r"3\s+not begun", text) and "exit 3" in text


def test_thumbnails_are_thinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "THUMBNAILS", 2)
    rows = [
        row(tmp_path, "a", picture=False),
        *(row(tmp_path, name) for name in "bcd"),
    ]
    html = batch.page(rows, 4, tmp_path)
    assert html.count('class="thumbnail"') == 1, (
        "of the first two, one of which has no picture"
    )
    assert html.count("report.html") == 4
