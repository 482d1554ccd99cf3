"""Calibration on real pictures. Published figures: see the data folder's README."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.calibrate.board import BoardSpec
from arfx.calibrate.calibration import Calibration, calibrate, find_board
from arfx.calibrate.corners import STOP
from arfx.calibrate.solve import MODELS, fit, uncertainty
from arfx.media.clip import probe
from arfx.media.frames import ClipReader

DATA = Path(__file__).parents[2].parent / "shared" / "data"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"real data not found at {DATA}"),
]
OPENCV_FX, OPENCV_RMS = 535.916, 0.393


def pictures(folder: Path, pattern: str) -> list[tuple[str, np.ndarray, int]]:
    out = []
    for p in sorted(folder.glob(pattern)):
        gray = cv2.imread(str(p), cv2.IMREAD_GRAYSCALE)
        assert gray is not None
        out.append((p.name, gray, 1))
    assert out, f"{folder} holds no {pattern}"
    return out


@pytest.fixture(scope="module")
def opencv_set() -> Calibration:
    folder = DATA / "calibration" / "opencv-left-via-mvtb-data"
    return calibrate(
        find_board(
            pictures(folder, "left*.jpg"), BoardSpec.parse("chessboard:9x6:25mm")
        )
    )


def test_opencv_set_is_good_and_agrees_with_the_published_camera(
    opencv_set: Calibration,
) -> None:
    fx, sd = opencv_set.fitted.camera.fx, opencv_set.known.standard_deviations[0]
    assert opencv_set.verdict.word == "good", opencv_set.verdict.reasons
    assert abs(fx - OPENCV_FX) < 5.0
    assert sd < 2.0
    assert len(opencv_set.fitted.views) == 14


def test_our_corners_predict_unseen_views_better_than_the_published_window(
    opencv_set: Calibration,
) -> None:
    """Why fx is 533 and not 536: the sample program's fixed 11 px window reaches the
    neighbours' edges in left02.
    """
    assert opencv_set.chosen.held_out_rms_px < 0.55 * OPENCV_RMS
    folder = DATA / "calibration" / "opencv-left-via-mvtb-data"
    views = []
    for view, (_, gray, _) in zip(
        opencv_set.fitted.views, pictures(folder, "left*.jpg"), strict=True
    ):
        wide = cv2.cornerSubPix(
            gray,
            view.pixels.astype(np.float32).reshape(-1, 1, 2),
            (11, 11),
            (-1, -1),
            STOP,
        )
        views.append(
            type(view)(
                view.name,
                view.size,
                view.ids,
                view.board_m,
                wide.reshape(-1, 2).astype(float),
                "11 px",
            )
        )
    sampled = fit(views, MODELS[4])
    assert sampled.camera.fx == pytest.approx(OPENCV_FX, abs=1.0), (
        "this is how the published figure came about"
    )
    assert sampled.view_rms_px.argmax() == 1, "left02"
    assert sampled.view_rms_px.max() > 5 * np.median(sampled.view_rms_px)
    without = fit([v for i, v in enumerate(views) if i != 1], MODELS[4])
    difference = abs(without.camera.fx - opencv_set.fitted.camera.fx)
    assert difference < abs(sampled.camera.fx - opencv_set.fitted.camera.fx)
    assert difference < 3 * opencv_set.known.standard_deviations[0]


def test_the_29_picture_set() -> None:
    folder = DATA / "calibration" / "nbhr-pycalib" / "chessboard"
    result = calibrate(
        find_board(
            pictures(folder, "*.jpg")[::2], BoardSpec.parse("chessboard:10x7:25mm")
        )
    )
    fx, sd = result.fitted.camera.fx, result.known.standard_deviations[0]
    assert result.verdict.word == "usable", result.verdict.reasons
    assert abs(fx - 1341) < max(3 * sd, 5)
    assert result.fitted.rms_px < 0.4


def test_the_frontal_clip_is_poor_and_says_why() -> None:
    info = probe(
        DATA / "marker_clips" / "wpilibsuite-allwpilib" / "testcalibration.mp4"
    )

    def frames() -> Iterator[tuple[str, np.ndarray, int]]:
        with ClipReader(info) as reader:
            for f in reader.frames():
                if f.index % 10 == 0:
                    yield f"{f.time_s:.2f}", np.ascontiguousarray(f.luma()), 1

    result = calibrate(
        find_board(
            frames(), BoardSpec.parse("charuco:12x8:15.585mm:12.123mm:5X5_100")
        )
    )
    assert result.verdict.word == "poor"
    text = "; ".join(result.verdict.reasons)
    assert "focal length" in text
    assert "frontally" in text
    assert result.copies, "most frames show the same view"
    published = 1764.6
    # the stated uncertainty must cover the truth; that of OpenCV 5 for these views (±0.1
    # px) does not
    assert (
        abs(result.fitted.camera.fx - published)
        < 3 * result.known.standard_deviations[0]
    )
    assert uncertainty(result.fitted).condition > 1e5
