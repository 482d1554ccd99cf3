"""Depth maps of real RGB-D recordings: read with their scale, holes filled so that what is
known stays and is plausible.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.media.depth_maps import fill_holes, open_depth

DATA = Path(__file__).parents[3] / "shared" / "data" / "rgbd" / "gaoxiang12-slambook2"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not DATA.is_dir(), reason=f"real depth maps are absent ({DATA})"
    ),
]


@pytest.mark.parametrize(
    ("name", "scale", "holes"),
    [("ch5_rgbd", 1000, (0.2, 0.45)), ("ch12_dense_RGBD", 5000, (0.0, 0.01))],
)
def test_maps_are_read_and_holes_filled_from_beside(
    name: str, scale: float, holes: tuple[float, float]
) -> None:
    maps = open_depth(DATA / name / "depth", scale)
    assert maps.count == 5 and maps.of_frames([0.0] * 5, 0, whole=True) == list(
        range(5)
    )
    for number in (0, 3):
        depth = maps.load(number, 640, 480)
        known = depth > 0
        assert (
            holes[0] <= 1 - known.mean() <= holes[1]
            and 0.5 < depth[known].min() < depth.max() < 12
        )
        guide = cv2.imread(
            str(DATA / name / "color" / f"{number + 1}.png"), cv2.IMREAD_GRAYSCALE
        )
        g = np.random.default_rng(number)
        away = (
            cv2.resize(
                (g.random((24, 32)) < 0.15).astype(np.uint8),
                (640, 480),
                interpolation=cv2.INTER_NEAREST,
            )
            > 0
        )
        out = fill_holes(np.where(away, 0, depth).astype(np.float32), guide)
        assert np.isfinite(out).all() and (out > 0).all()
        np.testing.assert_array_equal(out[known & ~away], depth[known & ~away])
        missed = np.abs(out / np.where(known, depth, 1) - 1)[
            known & away
        ]  # 20 px holes put into what was measured
        assert np.median(missed) < 0.015 and np.mean(missed) < 0.04
