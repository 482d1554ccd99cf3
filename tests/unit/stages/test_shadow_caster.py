"""The hulls that shadows and boxes are found by: exact where it has few corners, never the
square of the points.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from arfx.analyse.pose import visibility
from arfx.stages.light.caster import _outline

CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1.0])).reshape(3, -1).T


def arc(angle: float) -> np.ndarray:
    a = np.linspace(0, angle, 20_000)
    return np.concatenate(
        [np.column_stack([np.cos(a), np.sin(a), 0 * a]), [[0, 0, 1.0]]]
    )


@pytest.mark.parametrize(
    ("hull_of", "angle"),
    [
        (visibility._outline, 0.05),
        (visibility._outline, 2 * np.pi),
        (_outline, 2 * np.pi),
    ],
)
def test_a_hull_of_20000_points_on_a_circle_takes_no_time(
    hull_of: Callable[[np.ndarray], np.ndarray], angle: float
) -> None:
    began = time.process_time()
    points = arc(angle)
    outline = hull_of(points)
    assert time.process_time() - began < 5, "Qhull took a minute"
    ways = np.random.default_rng(3).normal(size=(3, 50))
    assert ((points @ ways).max(0) <= (outline @ ways).max(0) + 1e-6).all()


def test_a_hull_of_few_corners_is_exact() -> None:
    inside = np.random.default_rng(1).random((5000, 3))
    np.testing.assert_array_equal(
        np.unique(_outline(np.concatenate([inside, CUBE])), axis=0),
        np.unique(CUBE, axis=0),
    )
    few = inside[:30]
    assert {tuple(p) for p in _outline(few)} == {
        tuple(p) for p in few[ConvexHull(few).vertices]
    }


def test_flat_points_are_kept_or_stood_for() -> None:
    flat = np.column_stack([np.random.default_rng(2).random((500, 2)), np.zeros(500)])
    assert len(_outline(flat[:20])) == 20
    outline = _outline(flat)
    assert (outline.min(0) <= flat.min(0)).all() and (
        outline.max(0) >= flat.max(0)
    ).all()
