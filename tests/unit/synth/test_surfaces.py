"""Prints of every family and procedural textures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.core.colour import SRGB
from arfx.core.marker import FAMILIES, MarkerSpec
from arfx.core.marker_codes import marker_cells
from arfx.synth.description import Marker, Texture
from arfx.synth.textures import sheet_albedo, texture_albedo
from tests.unit.synth.little_scenes import from_above, little_scene, picture_of


@pytest.mark.parametrize("family", FAMILIES)
def test_prints_of_every_family_are_read_by_opencv(family: str) -> None:
    number = FAMILIES[family] // 2
    spec = MarkerSpec(family, number, 0.1)
    picture, _ = sheet_albedo(Marker(spec=spec, margin_cells=2, ink=0, paper=1))
    big = cv2.resize(
        (picture[..., 0] * 255).astype(np.uint8),
        None,
        fx=5,
        fy=5,
        interpolation=cv2.INTER_NEAREST,
    )
    if family == "ORIGINAL" or family.startswith("MIP"):
        name = f"DICT_ARUCO_{family}"
    else:
        name = f"DICT_APRILTAG_{family}" if "h" in family else f"DICT_{family}"
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    )
    corners, ids, _ = detector.detectMarkers(big)
    assert ids is not None and ids.ravel().tolist() == [number]
    cells = marker_cells(family, number).shape[0]
    np.testing.assert_allclose(
        corners[0][0][0], 2 * 20 - 0.5, atol=1.5
    )  # first corner: top left, two cells in
    assert big.shape[0] == (cells + 4) * 20


def test_sheet_has_its_stated_albedo_margin_and_wear() -> None:
    spec = MarkerSpec("36h11", 3, 0.08)
    picture, side = sheet_albedo(Marker(spec=spec))
    assert set(np.unique(picture)) == {0.05, 0.88}
    assert side == pytest.approx(0.08 * (8 + 3) / 8)
    assert (picture[:6] == 0.88).all() and (picture[6, 6:-6] == 0.05).all()
    worn, _ = sheet_albedo(Marker(spec=spec), right_ink=0.2)
    ink = worn[20, worn[20, :, 0] < 0.5, 0]
    assert (np.diff(ink) > 0).all()
    inverted, _ = sheet_albedo(Marker(spec=spec, inverted=True))
    np.testing.assert_allclose(inverted + picture, 0.93)


@pytest.mark.parametrize("kind", ["wood", "carpet", "noise", "checker", "poster"])
def test_textures_depend_on_their_seed_only_and_have_detail(kind: str) -> None:
    texture = Texture(kind=kind, feature_m=0.02)  # type: ignore[arg-type]
    a, b, c = (texture_albedo(texture, (0.8, 0.5), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert kind == "checker" or not np.array_equal(a, c)
    assert a.min() >= 0.01 and a.max() <= 0.95
    grey = (255 * SRGB.encode(a.mean(-1))).astype(np.uint8)
    assert cv2.goodFeaturesToTrack(grey, 200, 0.01, 5) is not None and grey.std() > 4


def test_edge_of_a_print_is_its_exact_area() -> None:
    """A frontal print: each pixel is the mean of ink and paper by the area that each covers."""
    marker = {"spec": "4X4_50:0:200mm", "margin_cells": 1.0, "ink": 0.1, "paper": 0.9}
    world, picture = picture_of(
        little_scene(120, 90, path=from_above(), marker=[marker]), samples=4
    )
    seen = picture.radiance(0)[..., 0]
    half_px = 0.1 * world.camera.fx  # of the black square
    left, top = world.camera.cx - half_px, world.camera.cy - half_px
    column, row = int(np.floor(left + 0.5)), round(world.camera.cy - half_px * 0.8)
    covered = left + 0.5 - column
    assert 0.05 < covered < 0.95
    assert seen[row, column] == pytest.approx(
        0.9 * covered + 0.1 * (1 - covered), abs=1e-6
    )
    line = int(np.floor(top + 0.5))
    covered = top + 0.5 - line
    assert seen[line, round(world.camera.cx - half_px * 0.8)] == pytest.approx(
        0.9 * covered + 0.1 * (1 - covered), abs=1e-6
    )
