"""Board specifications."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.calibrate.board import BoardSpec, charuco_board
from arfx.errors import ConfigError


@pytest.mark.parametrize(
    "text",
    [
        "chessboard:9x6:25mm",
        "charuco:12x8:18mm:14mm:5X5_100",
        "charuco:7x5:0.03m:20mm:36h11:legacy",
    ],
)
def test_a_spec_survives_being_written(text: str) -> None:
    spec = BoardSpec.parse(text)
    assert BoardSpec.parse(str(spec)) == spec


def test_corners_are_those_of_opencv() -> None:
    spec = BoardSpec.parse("charuco:12x8:18mm:14mm:DICT_5X5_100")
    corners = np.asarray(charuco_board(spec).getChessboardCorners())
    # the same grid; OpenCV counts from the board's edge, one square before the first corner
    np.testing.assert_allclose(
        spec.corners_m + np.array([spec.square_m, spec.square_m, 0]),
        corners,
        atol=1e-7,
    )
    chess = BoardSpec.parse("chessboard:9x6:25mm")
    assert chess.corners_m.shape == (54, 3)
    assert tuple(chess.corners_m[10]) == (0.025, 0.025, 0.0)


def test_which_boards_look_the_same_after_half_a_turn() -> None:
    assert BoardSpec.parse("chessboard:9x7:25mm").turn_is_ambiguous
    assert BoardSpec.parse("chessboard:8x6:25mm").turn_is_ambiguous
    assert not BoardSpec.parse("chessboard:9x6:25mm").turn_is_ambiguous
    assert not BoardSpec.parse("charuco:9x7:25mm:18mm:4X4_50").turn_is_ambiguous


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("chess:9x6:25mm", "not understood"),
        ("chessboard:9x6", "not understood"),
        ("chessboard:9x6:25mm:legacy", "not understood"),
        ("chessboard:9:25mm", "not understood"),
        ("chessboard:2x6:25mm", "too small"),
        ("chessboard:9x6:25", "not a length"),
        ("chessboard:9x6:-5mm", "larger than 0"),
        ("charuco:9x6:25mm:25mm:4X4_50", "smaller than its square"),
        ("charuco:20x20:25mm:15mm:4X4_50", "needs 200 markers"),
        ("charuco:9x6:25mm:15mm:9X9_50", "unknown marker family"),
    ],
)
def test_wrong_specs(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        BoardSpec.parse(text)
