"""`arfx target` as a user runs it."""

from __future__ import annotations

from pathlib import Path

import cv2
from PIL import Image

from tests.cli.conftest import Run


def test_marker_as_png(arfx: Run, tmp_path: Path) -> None:
    out = tmp_path / "m.png"
    result = arfx("target", "36h11:3:100mm", "-o", str(out), "--dpi", "127", "--json")
    assert result.code == 0, result.err
    assert result.json == {
        "output": str(out),
        "page_mm": [210.0, 297.0],
        "targets": ["36h11:3:100mm"],
    }
    picture = cv2.imread(str(out), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    _, ids, _ = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    ).detectMarkers(picture)
    assert ids is not None
    assert ids.ravel().tolist() == [3]
    with Image.open(out) as image:
        assert round(image.info["dpi"][0]) == 127


def test_existing_files_are_kept(arfx: Run, tmp_path: Path) -> None:
    out = tmp_path / "m.svg"
    out.write_text("mine")
    result = arfx("target", "36h11:3:100mm", "-o", str(out))
    assert result.code == 2
    assert "--overwrite" in result.err
    assert out.read_text() == "mine"
    assert arfx("target", "36h11:3:100mm", "-o", str(out), "--overwrite").code == 0
    assert "<svg" in out.read_text()


def test_what_does_not_fit_is_one_message(arfx: Run, tmp_path: Path) -> None:
    result = arfx("target", "chessboard:9x6:40mm", "-o", str(tmp_path / "b.pdf"))
    assert result.code == 2
    assert "400 x 280 mm" in result.err
    assert "larger --page" in result.err
    assert not list(tmp_path.iterdir())
