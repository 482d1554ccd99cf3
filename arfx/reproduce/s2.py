"""Rows of Zhao et al. 2012: depth of field from luminance and depth.

To add an item, yield it from `rows`; `compared` decides a row's verdict from the values, `Figure` and `Plot` go with a row of
the same item."""

from __future__ import annotations

from collections.abc import Iterator

from arfx.core.lens import Lens, depth_of_field
from arfx.papers.s2_dof import printed_limits
from arfx.reproduce.rows import Item, compared
from arfx.reproduce.work import Work

LENS, COC_MM = Lens(200.0, 11.0, 2500.0), 0.035  # of the paper's example


def rows(work: Work) -> Iterator[Item]:
    printed, corrected = printed_limits(LENS, COC_MM), depth_of_field(LENS, COC_MM)
    why = "equations (4) and (5) have the distance L where the blur circle (3) implies L - F"
    yield compared("s2", "front depth of field, equation (4)", "58.7", printed.front_mm, corrected.front_mm, "mm", why)
    yield compared("s2", "back depth of field, equation (5)", "61.6", printed.back_mm, corrected.back_mm, "mm", why)
