"""Printed targets: the right pattern, true to scale, in all three kinds of file."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from arfx.calibrate.board import BoardSpec
from arfx.calibrate.corners import find_view
from arfx.calibrate.print_layout import (
    lay_out,
    outlines,
    parse_targets,
    write_sheet,
)
from arfx.core.marker_codes import dictionary, marker_cells
from arfx.errors import ConfigError

SVG = "{http://www.w3.org/2000/svg}"


def png(
    tmp_path: Path, specs: list[str], page: str = "a4", dpi: float = 254
) -> np.ndarray:
    path = tmp_path / "t.png"
    write_sheet(lay_out(parse_targets(specs), page), path, dpi)
    with Image.open(path) as image:
        assert image.info["dpi"] == pytest.approx((dpi, dpi), abs=0.1)
        return np.array(image.convert("L"))


def markers(picture: np.ndarray, family: str) -> dict[int, np.ndarray]:
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary(family)).detectMarkers(
        picture
    )
    return (
        {}
        if ids is None
        else {
            int(i): c.reshape(4, 2) for i, c in zip(ids.ravel(), corners, strict=True)
        }
    )


def test_a_marker_of_165_mm_fits_on_a4_and_is_165_mm(tmp_path: Path) -> None:
    seen = markers(png(tmp_path, ["36h11:3:165mm"]), "36h11")
    assert list(seen) == [3]
    sides = (
        np.linalg.norm(np.roll(seen[3], -1, 0) - seen[3], axis=1) + 1
    )  # from first to last black pixel
    np.testing.assert_allclose(sides / 10, 165, atol=0.11)


def test_a_sheet_holds_all_its_markers_at_their_sizes(tmp_path: Path) -> None:
    picture = png(tmp_path, ["4X4_50:0-5:40mm", "4X4_50:9:20mm"])
    seen = markers(picture, "4X4_50")
    assert sorted(seen) == [0, 1, 2, 3, 4, 5, 9]
    for number, corners in seen.items():
        size = 20 if number == 9 else 40
        assert (np.linalg.norm(corners[1] - corners[0]) + 1) / 10 == pytest.approx(
            size, abs=0.15
        )
        # a module of white all round
        x0, y0 = np.floor(corners.min(0)).astype(int)
        x1, y1 = np.ceil(corners.max(0)).astype(int)
        white = int(size * 10 / 6) - 3
        ring = picture[y0 - white : y1 + white, x0 - white : x1 + white].copy()
        ring[white - 2 : -white + 2, white - 2 : -white + 2] = 255
        assert ring.min() == 255


@pytest.mark.parametrize(
    "text",
    [
        "chessboard:9x6:25mm", "charuco:12x8:18mm:14mm:5X5_100", "charuco:8x6:25mm:18mm:4X4_50:legacy",
        "charuco:7x5:25mm:18mm:4X4_50:legacy", "charuco:6x5:30mm:22mm:36h11",
    ],
)  # fmt: skip
def test_a_board_is_found_with_the_spec_it_was_printed_from(
    tmp_path: Path, text: str
) -> None:
    spec = BoardSpec.parse(text)
    picture = cv2.GaussianBlur(png(tmp_path, [text], dpi=254), (0, 0), 1.5)
    view = find_view(picture, spec, "")
    assert view is not None
    assert len(view.ids) == len(spec.corners_m)
    scale = np.linalg.norm(view.pixels[-1] - view.pixels[0]) / np.linalg.norm(
        spec.corners_m[-1] - spec.corners_m[0]
    )
    assert scale == pytest.approx(
        10000, rel=1e-3
    )  # edges are rounded to pixels of .1 mm
    if spec.kind == "charuco" and spec.rows % 2 == 0:
        assert find_view(picture, replace(spec, legacy=not spec.legacy), "") is None


def filled(
    points: list[np.ndarray], size: tuple[float, float], scale: float
) -> np.ndarray:
    """Even-odd fill of outlines, each pixel by its middle."""
    out = np.zeros((round(size[1] * scale), round(size[0] * scale)), np.uint8)
    for p in points:
        one = np.zeros_like(out)
        low = np.floor(p.min(0) * scale).astype(int)
        ys, xs = np.mgrid[
            low[1] : int(np.ceil(p[:, 1].max() * scale)),
            low[0] : int(np.ceil(p[:, 0].max() * scale)),
        ]
        centres = np.stack([(xs + 0.5) / scale, (ys + 0.5) / scale], -1)
        inside = np.zeros(xs.shape, bool)
        for a, b in zip(p, np.roll(p, -1, 0), strict=True):
            if a[0] == b[0]:  # only the upright edges matter for a ray along x
                crosses = (
                    (centres[..., 1] >= min(a[1], b[1]))
                    & (centres[..., 1] < max(a[1], b[1]))
                    & (centres[..., 0] < a[0])
                )
                inside ^= crosses
        one[ys, xs] = inside
        out ^= one
    return out


@pytest.mark.parametrize(
    "bits",
    [
        ~marker_cells("36h11", 3),
        ~marker_cells("4X4_50", 17),
        np.eye(3) > 0,
        np.ones((2, 2)) > 0,
    ],
)
def test_outlines_enclose_exactly_the_black(bits: np.ndarray) -> None:
    paths = list(outlines(bits, 2.0, (5.0, 7.0)))
    picture = filled(paths, (40, 40), 2)
    expected = np.zeros_like(picture)
    expected[14 : 14 + 4 * len(bits), 10 : 10 + 4 * len(bits)] = np.kron(
        bits, np.ones((4, 4))
    )
    np.testing.assert_array_equal(picture, expected)


def test_the_svg_is_in_points_and_its_paths_show_the_marker(tmp_path: Path) -> None:
    path = tmp_path / "t.svg"
    write_sheet(lay_out(parse_targets(["36h11:3:100mm"]), "letter"), path)
    root, point_mm = ET.parse(path).getroot(), 25.4 / 72
    size_pt = [
        float((root.get(k) or "").removesuffix("pt")) for k in ("width", "height")
    ]
    np.testing.assert_allclose(
        np.array(size_pt) * point_mm, (215.9, 279.4), atol=1e-3
    )
    drawn = [
        [
            np.array(re.findall(r"([\d.]+) ([\d.]+)", part), float) * point_mm
            for part in re.split("[zZ]", p.get("d") or "")
        ]
        for p in root.iter(f"{SVG}path")
    ]
    shapes = [s for s in max(drawn, key=len) if len(s)]
    np.testing.assert_allclose(np.ptp(np.concatenate(shapes), axis=0), 100, atol=1e-3)
    seen = markers(
        255 - 255 * filled([s[:4].round(4) for s in shapes], (215.9, 279.4), 4),
        "36h11",
    )
    assert list(seen) == [3]
    texts = [t.text for t in root.iter(f"{SVG}text")]
    assert "36h11:3:100mm" in texts
    assert any("measure this line" in (t or "") for t in texts)
    assert any(
        np.allclose(np.ptp(s, axis=0), (100, 0), atol=1e-3)
        for p in drawn
        for s in p
        if len(s) == 2
    ), "the ruler"


def test_the_pdf_is_in_points(tmp_path: Path) -> None:
    path = tmp_path / "t.pdf"
    write_sheet(lay_out(parse_targets(["36h11:3:165mm"])), path)
    data = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?([\d. ]+)\]", data)
    assert box is not None
    np.testing.assert_allclose(
        [float(v) for v in box[1].split()],
        [0, 0, 210 / 25.4 * 72, 297 / 25.4 * 72],
        atol=1e-3,
    )
    page = next(s for s in _streams(data) if b" Tf" in s)  # the others are letters
    # the marker is the largest filled path: lines of "x y m" and "x y l"
    shapes = [
        np.array(re.findall(rb"([-\d.]+) ([-\d.]+) [ml]\b", part), float)
        for part in re.split(rb"\bf\*?\s", page)
    ]
    sides = [np.ptp(s, axis=0) for s in shapes if len(s) > 20]
    assert sides
    np.testing.assert_allclose(
        max(sides, key=lambda s: float(s[0])), 165 / 25.4 * 72, atol=0.01
    )
    again = tmp_path / "u.pdf"
    write_sheet(lay_out(parse_targets(["36h11:3:165mm"])), again)
    assert again.read_bytes() == data, "the same sheet gives the same bytes"


def _streams(data: bytes) -> list[bytes]:
    out = []
    for m in re.finditer(rb"stream\r?\n", data):
        try:
            out.append(zlib.decompressobj().decompress(data[m.end() :]))
        except zlib.error:
            continue
    return out


@pytest.mark.parametrize(
    ("specs", "page", "says"),
    [
        (["36h11:3:200mm"], "a4", "1 of 200 x 200 mm, 25 mm white"),
        (["4X4_50:0-20:60mm"], "a4", "21 of 60 x 60 mm, 10 mm white"),
        (["chessboard:9x6:40mm"], "a4", "400 x 280 mm"),
        (["36h11:3:10mm"], "a9", "unknown page"),
        (["chessboard:9x6:10mm", "36h11:3:10mm"], "a4", "its own sheet"),
        (["4X4_50:5-2:10mm"], "a4", "backwards"),
        (["4X4_50:0-50:10mm"], "a4", "ids 0 to 49"),
    ],
)
def test_what_cannot_be_printed(specs: list[str], page: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as e:
        lay_out(parse_targets(specs), page)
    assert e.value.hint or "ids 0 to" in e.value.message


def test_a_board_too_wide_upright_goes_across() -> None:
    sheet = lay_out(parse_targets(["chessboard:9x6:25mm"]), "a4")
    assert (sheet.width_mm, sheet.height_mm) == (297, 210)
    assert (
        lay_out(parse_targets(["chessboard:9x6:40mm"]), "500mmx400mm").width_mm == 500
    )


def test_file_names_and_resolutions(tmp_path: Path) -> None:
    sheet = lay_out(parse_targets(["36h11:3:50mm"]))
    with pytest.raises(ConfigError, match="cannot write"):
        write_sheet(sheet, tmp_path / "a.gif")
    with pytest.raises(ConfigError, match="dpi"):
        write_sheet(sheet, tmp_path / "a.png", 4000)
    assert not list(tmp_path.iterdir())
