"""The HTML reports in a real browser: the slider moves, every picture shows, no error, no
network, at most 5 MB.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx.measure.report import write_report
from arfx.measure.tradeoff_html import write_tradeoff
from tests.unit.measure.browser import WHY, browser, opened
from tests.unit.measure.test_report import REPORT, camera, pictures, six
from tests.unit.measure.test_tradeoff import found, told

pytestmark = pytest.mark.skipif(browser() is None, reason=WHY)

SHOWN = """const images = [...document.images].filter(i => i.src);
  return { images: images.length, broken: images.filter(i => !i.naturalWidth).length,
           wide: document.documentElement.scrollWidth > innerWidth, %s };"""
SLIDE = """above: (() => { const r = document.querySelector(".slider input"), a = document.querySelector(".slider .above");
    r.value = 20; r.dispatchEvent(new Event("input")); return a.style.clipPath; })(),
  other: (() => { const f = document.querySelectorAll(".sheet figure"), a = document.querySelector(".slider .above");
    f[0].click(); const first = a.src; f[1].click(); return [first === a.src, f[1].classList.contains("on")]; })()"""


def test_the_slider_moves_and_another_frame_can_be_chosen(tmp_path: Path) -> None:
    before, after = (np.full((48, 64, 3), v, np.uint8) for v in (40, 200))
    pairs = [*pictures()[:1], (5, before, after)]
    page = write_report(
        tmp_path / "report",
        REPORT,
        six(),
        pairs,
        camera(),
        np.array([[0.0, 0, 0], [0.1, 0, 0]]),
    )
    got = opened(page, tmp_path, SHOWN % SLIDE)
    assert (
        got["errors"] == []
        and got["broken"] == 0
        and got["images"] >= 6
        and not got["wide"]
    )
    assert "20%" in got["above"], (
        "the input event moves the edge between the pictures"
    )
    assert got["other"] == [False, True]
    assert page.stat().st_size <= 5_000_000


def test_a_broken_page_is_caught(tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        "<html><head></head><body><img"
        ' src="http://example.org/x.png"><script>nothing.here()</script></body></html>'
    )
    got = opened(page, tmp_path, SHOWN % "x: 1")
    assert got["broken"] == 1 and any("nothing" in e for e in got["errors"])


def test_the_tradeoff_shows_plots_and_pictures(tmp_path: Path) -> None:
    rows = found()
    page = write_tradeoff(tmp_path, rows, told(rows))
    got = opened(
        page, tmp_path, SHOWN % "plots: document.querySelectorAll('img.plot').length"
    )
    assert (
        got["errors"] == []
        and got["broken"] == 0
        and got["plots"] == 2
        and not got["wide"]
    )
    assert page.stat().st_size <= 5_000_000
