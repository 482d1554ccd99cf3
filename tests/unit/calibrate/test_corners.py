"""Corners of rendered boards against where they truly are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.calibrate import corners
from arfx.calibrate.board import BoardSpec
from arfx.calibrate.corners import find_view
from tests.unit.calibrate.boards import CHESS, poses, projected, render, rms

CHARUCO = BoardSpec.parse("charuco:10x7:25mm:18mm:5X5_100")


@pytest.mark.parametrize("index", [0, 1, 2, 5])
def test_chessboard_corners_are_where_they_are(index: int) -> None:
    pose = poses(8)[index]
    found = find_view(render(CHESS, pose), CHESS, "a")
    assert found is not None
    assert rms(found.pixels, projected(CHESS, pose)) < 0.06
    # the mean must be better still: a shift of all corners together is what biases the
    # principal point
    assert np.abs((found.pixels - projected(CHESS, pose)).mean(0)).max() < 0.015


def test_a_window_that_reaches_the_next_corner_is_worse(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the rule on the window's size is for."""
    pose = poses(3, tilt_deg=(60, 60))[1]
    picture, truth = render(CHESS, pose), projected(CHESS, pose)
    own = find_view(picture, CHESS, "a")
    monkeypatch.setattr(corners, "REFINE_FRACTION", 0.8)
    wide = find_view(picture, CHESS, "a")
    assert own is not None
    assert wide is not None
    assert rms(own.pixels, truth) < 0.1
    assert rms(wide.pixels, truth) > 1.0


def test_nor_may_it_reach_the_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    pose = poses(8)[4]
    picture = render(CHARUCO, pose)
    own = find_view(picture, CHARUCO, "a")
    monkeypatch.setattr(corners, "CLEAR_FRACTION", 2.0)
    wide = find_view(picture, CHARUCO, "a")
    assert own is not None
    assert wide is not None
    assert rms(own.pixels, projected(CHARUCO, pose)[own.ids]) < 0.05
    assert rms(wide.pixels, projected(CHARUCO, pose)[wide.ids]) > 0.15


def test_a_board_upside_down_keeps_its_numbers() -> None:
    rvec, _ = poses(8)[2]
    r = cv2.Rodrigues(rvec)[0] @ np.diag([-1.0, -1, 1])
    pose = (
        cv2.Rodrigues(r)[0].ravel(),
        np.array([0, 0, 0.45]) - r @ CHESS.corners_m.mean(0),
    )
    found = find_view(render(CHESS, pose), CHESS, "a")
    assert found is not None
    assert rms(found.pixels, projected(CHESS, pose)) < 0.06


def test_charuco_corners_also_where_the_board_leaves_the_picture() -> None:
    pose = poses(8)[0]
    whole = find_view(render(CHARUCO, pose), CHARUCO, "a")
    assert whole is not None
    assert rms(whole.pixels, projected(CHARUCO, pose)[whole.ids]) < 0.08
    shifted = (pose[0], np.asarray(pose[1]) + np.array([0.12, 0, 0]))
    part = find_view(render(CHARUCO, shifted), CHARUCO, "a")
    assert part is not None
    assert 8 <= len(part.ids) < len(whole.ids)
    assert rms(part.pixels, projected(CHARUCO, shifted)[part.ids]) < 0.08


def test_nothing_is_found_where_nothing_is() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320)).astype(np.uint8)
    assert find_view(noise, CHESS, "a") is None
    assert find_view(noise, CHARUCO, "a") is None


def test_sharpness_falls_with_blur() -> None:
    found = [
        find_view(render(CHESS, poses(8)[0], blur_px=b), CHESS, "a")
        for b in (0.6, 1.5, 3.0)
    ]
    sharpness = [v.sharpness for v in found if v is not None]
    assert len(sharpness) == 3
    assert sharpness[0] > 1.3 * sharpness[1] > 1.6 * sharpness[2]
