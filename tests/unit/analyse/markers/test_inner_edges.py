"""Corners that contradict the cells between them."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.markers.corners import linear_table
from arfx.analyse.markers.inner_edges import misplaced_px
from arfx.core.marker import MarkerSpec
from tests.unit.analyse.synthetic import background, camera, picture, tilted

_CAMERA, _PRINT, _TABLE = (
    camera(320, 240, 500.0),
    MarkerSpec("36h11", 3, 0.1),
    linear_table(),
)
_POSE = tilted((0.5, 0.2, 0.1), (0.0, 0.0, 0.6))
_CORNERS = _CAMERA.project(_POSE.apply(_PRINT.corners_m))


def _misplaced(corners_px: np.ndarray, inverted: bool = False, **how: float) -> float:
    luma = picture(
        _CAMERA, [(_PRINT, _POSE)], background(320, 240), inverted=inverted, **how
    )  # type: ignore[arg-type]
    return misplaced_px(luma, corners_px, "36h11", 3, _TABLE)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("how", [{}, {"blur_px": 2.0}, {"noise": 8.0}])
def test_right_corners_agree_with_the_cells(
    how: dict[str, float], inverted: bool
) -> None:
    assert _misplaced(_CORNERS, inverted, **how) == 0.0


def test_noise_alone_is_no_contradiction() -> None:
    """Held against a twentieth of a cell alone, 32 of these 40 were told to be off; against
    the lines' scatter too, 4.
    """
    assert (
        sum(_misplaced(_CORNERS, noise=30.0, seed=seed) > 0 for seed in range(40))
        <= 8
    )


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize(
    "moved", [(0, (3.0, 2.0)), (2, (-4.0, 0.0)), (3, (0.0, -3.0))]
)
def test_a_moved_corner_is_noticed_and_its_size_told(
    moved: tuple[int, tuple[float, float]], inverted: bool
) -> None:
    corners = _CORNERS.copy()
    corners[moved[0]] += moved[1]
    told = _misplaced(corners, inverted)
    assert told == pytest.approx(
        float(np.linalg.norm(moved[1])) / np.sqrt(8), rel=0.5
    )


def test_what_cannot_be_compared_is_not_held_against_it() -> None:
    flat = np.full((240, 320), 90, np.uint8)
    assert misplaced_px(flat, _CORNERS, "36h11", 3, _TABLE) == 0.0
    assert misplaced_px(flat, np.full((4, 2), np.nan), "36h11", 3, _TABLE) == 0.0
