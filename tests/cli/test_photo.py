"""A photo is a clip of one frame: what is beside the object stays, and so do its colour
profile and its EXIF.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms, ImageOps

from tests.cli.conftest import Material, Result
from tests.clips import clip_camera, picture, pose_at

PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
MAKER, ORIENTATION, EXPOSURE = 0x010F, 0x0112, 0x829A


def photo(path: Path, turned: bool = False) -> Path:
    """turned : stored on its side, as EXIF says"""
    image = Image.fromarray(picture(pose_at(0, 2), clip_camera()))
    exif = image.getexif()
    exif[MAKER] = "maker"
    exif.get_ifd(0x8769)[EXPOSURE] = 0.25
    if turned:
        exif[ORIENTATION] = 6
        image = image.transpose(Image.Transpose.ROTATE_90)
    image.save(path, exif=exif, icc_profile=PROFILE)
    return path


@pytest.mark.parametrize(
    ("source", "turned"),
    [("a.png", False), ("a.jpg", True), ("a.tif", False), ("a.webp", False)],
)
@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_photo_keeps_all_but_the_object(
    arfx: Callable[..., Result],
    material: Material,
    tmp_path: Path,
    source: str,
    turned: bool,
    suffix: str,
) -> None:
    path, out = photo(tmp_path / source, turned), tmp_path / f"out{suffix}"
    result = arfx(*material.arguments("-o", str(out), clip=path))
    assert result.code == 0, result.err
    assert "1 frame to" in result.err and not re.search(
        r"(?<![\d.])1 frames", result.err
    )
    with Image.open(path) as before, Image.open(out) as after:
        change = np.abs(
            np.subtract(
                ImageOps.exif_transpose(before).convert("RGB"), after, dtype=int
            )
        ).max(-1)
        same = change == 0 if suffix == ".png" else change < 40
        assert after.info["icc_profile"] == PROFILE
        exif = after.getexif()
    assert 0.5 < same.mean() < 0.99
    assert exif[MAKER] == "maker" and exif.get(ORIENTATION, 1) == 1
    assert 0x0111 not in exif, "where a TIFF has its pixels"
    if source != "a.tif":  # in which Pillow writes none
        assert exif.get_ifd(0x8769)[EXPOSURE] == 0.25


def test_a_photo_of_16_bits_stays_one(
    arfx: Callable[..., Result], material: Material, tmp_path: Path
) -> None:
    deep = picture(pose_at(0, 2), clip_camera())[..., ::-1].astype(np.uint16) * 257
    cv2.imwrite(str(tmp_path / "a.png"), deep)
    result = arfx(
        *material.arguments("-o", str(tmp_path / "out.png"), clip=tmp_path / "a.png")
    )
    assert result.code == 0, result.err
    after = cv2.imread(str(tmp_path / "out.png"), cv2.IMREAD_UNCHANGED)
    assert after.dtype == np.uint16 and (after == deep).all(-1).mean() > 0.5


def test_a_clip_is_no_single_picture(
    arfx: Callable[..., Result], material: Material, tmp_path: Path
) -> None:
    result = arfx(*material.arguments("-o", str(tmp_path / "out.jpg")))
    assert (
        result.code == 2
        and "is one picture" in result.err
        and "frames/%06d.png" in result.err
    )


def test_inspect_names_an_output_for_a_photo(
    arfx: Callable[..., Result], tmp_path: Path
) -> None:
    document = arfx("inspect", str(photo(tmp_path / "a.jpg", True)), "--json").json
    assert document["clip"]["frames"] == 1 and (
        document["clip"]["width"],
        document["clip"]["height"],
    ) == (320, 240)
    assert document["suggestion"].endswith("-o out.png")
