"""Tables hold whatever the names and reasons in them hold."""

from __future__ import annotations

from typing import Any

import pytest

from arfx.run.pages import render
from arfx_cli.console import print_table
from tests.cli.conftest import Run


def row(**more: Any) -> dict[str, Any]:
    usual = {
        "name": "mist",
        "levels": ["standard"],
        "frames_run": 0,
        "area_fraction": 0.0,
        "predicted_s": None,
        "predicted_between_s": None,
        "reasons": {},
    }
    return {**usual, **more}


def test_reasons_with_line_ends_tabs_and_brackets(
    capsys: pytest.CaptureFixture[str],
) -> None:
    reasons = {"no mist:\nclear\tsky": 3, "[/b] and [bold]": 2}
    rows = [row(reasons=reasons), row(name="[/red]")]
    print_table("plan/plan_table.jinja", words=2, rows=rows, frames=5)
    out = " ".join(capsys.readouterr().out.split())
    assert "[/b]" in out and "[bold]" in out and "[/red]" in out
    assert "clear" in out and "sky" in out


def test_a_length_with_a_line_end_is_shown_in_one_line(arfx: Run) -> None:
    given = ["--focal", "50mm\n", "--fnumber", "8", "--distance", "2m"]
    r = arfx("lens", *given, "--coc", "0.03mm")
    assert r.code == 0, r.err
    assert "50mm  f/8" in r.out or "50mm f/8" in r.out


def test_names_of_stages_are_escaped_in_a_page() -> None:
    level = {
        "level": "draft",
        "formula": "corrected",
        "levels": {"a<b>&c": "draft"},
        "between_s": (0.1, 0.1),
        "seconds_per_frame": 0.1,
        "ssim": 1.0,
    }
    effect = {"name": "a<b>&c", **level}
    page = render(
        "measure/tradeoff.html",
        clip="clip.mp4",
        document={
            "pipelines": [level],
            "effects": [effect],
            "frames": [{"frame": 1}],
        },
        effects=[effect],
        pipelines=[level],
        error_plot=lambda rows, title: b"",
    )
    assert "a<b>" not in page and "a&lt;b&gt;&amp;c" in page
