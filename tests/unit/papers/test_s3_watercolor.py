"""Jia, Tang 2013 as printed: numbers of the edge measure, and cells named by a colour."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.rect import Rect
from arfx.errors import ConfigError
from arfx.papers.s3_watercolor import PrintedWatercolorParams, eq1_sites, eq4_edges, named_by_colour
from arfx.stages.watercolor.labels import label

FRAME = Rect.of(200, 150)
BLACK, WHITE, RED, GREEN = (0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 0)


def test_the_threshold_has_bounds() -> None:
    with pytest.raises(ConfigError, match="line_threshold must be between 0 and 2"):
        PrintedWatercolorParams(line_threshold=3)


@pytest.mark.parametrize(
    ("left", "right", "of_yuv", "of_rgb", "both"),
    [(BLACK, WHITE, 0.5, 1.0, 0.75), (BLACK, RED, 0.34, 0.3333, 0.3367), (RED, GREEN, 0.4619, 0.6667, 0.5643)],
)
def test_printed_numbers(left: tuple, right: tuple, of_yuv: float, of_rgb: float, both: float) -> None:
    picture = np.array([[left, right]] * 2, np.float64)
    for beta, wanted in ((1.0, of_yuv), (0.0, of_rgb), (0.5, both)):
        made = eq4_edges(picture, 0.5, beta)
        assert made[0, 0] == pytest.approx(wanted, abs=1e-4) and made[0, 1] == 0


def test_integer_labels_keep_cells_apart_that_colour_merges() -> None:
    sites = eq1_sites(FRAME, 8, 10, 1)
    found = label(sites, FRAME).first
    assert len(np.unique(found)) == len(sites)
    _, count = named_by_colour(np.full((150, 200, 3), 0.5, np.float32), found, sites, FRAME)
    assert count == 1
