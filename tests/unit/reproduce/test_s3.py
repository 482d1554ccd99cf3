"""Measures behind the rows of Jia, Tang 2013."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.rect import Rect
from arfx.papers.s3_watercolor import cones, eq1_sites
from arfx.reproduce import s3_measure as measure


def test_a_corner_cut_out_of_a_cell_is_not_convex() -> None:
    labels = np.zeros((12, 20), np.int32)
    labels[:, 10:] = 1
    assert measure.convex_share(labels) == 1
    labels[:4, 6:10] = 2
    assert measure.convex_share(labels) == pytest.approx(2 / 3)
    rect = Rect.of(80, 60)
    sites = eq1_sites(rect, 6, 8, 0)
    assert measure.convex_share(cones(sites, np.ones(48), rect, 6, 8)) == 1
    assert (
        measure.convex_share(
            cones(sites, np.where(np.arange(48) % 2, 1.0, 0.4), rect, 6, 8)
        )
        < 0.9
    )


def test_shares_of_outlines_are_counted() -> None:
    thing = np.zeros((20, 20), bool)
    thing[5:15, 5:15] = True
    border, edges = measure.outline(thing), np.zeros((20, 20), bool)
    assert border.sum() == 36
    edges[3, :] = True
    assert measure.share_near(border, edges) == pytest.approx(10 / 36)


def test_the_corrected_measure_of_a_slope_is_the_printed_one_of_a_step() -> None:
    for left, right in (((0, 0, 0), (1, 1, 1)), ((1, 0, 0), (0, 1, 0))):
        printed, corrected = measure.edge_of(left, right, 0.5)
        assert corrected == pytest.approx(printed, rel=1e-3) and printed > 0.5


def test_printed_cells_of_a_plane_are_as_large_near_as_far() -> None:
    depth, areas = measure.areas_on_plane(4, 1)
    assert (np.diff(depth) < 0).all() and depth[0] > 2 * depth[-1]
    assert np.ptp(areas) < 0.05 * areas.mean()
