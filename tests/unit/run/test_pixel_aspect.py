"""Clips whose pixels are not square: the camera is that of the stored pixels."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from arfx.analyse.markers.detect import MarkerDetector
from arfx.config.load import load
from arfx.core.camera import Camera
from arfx.errors import InputError
from arfx.media.clip import ClipInfo, probe
from arfx.run.inputs import open_clip
from arfx.run.parameters import parameters
from tests.clips import MARKER, clip_camera, picture, pose_at, write_camera

SHOWN = (384, 216)
ASPECT = Fraction(4, 3)


def squeezed(
    path: Path, width: int, aspect: Fraction, turned: bool = False
) -> tuple[ClipInfo, np.ndarray]:
    """One frame of a scene that is 384x216 when it is displayed, and the picture that is
    stored, upright.
    """
    image = picture(pose_at(0, 2), clip_camera(*SHOWN))
    image = cv2.resize(image, (width, SHOWN[1]), interpolation=cv2.INTER_AREA)
    stored = np.ascontiguousarray(np.rot90(image) if turned else image, np.uint8)
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=24, options={"crf": "4"})
        stream.height, stream.width = stored.shape[:2]
        stream.pix_fmt = "yuv444p"
        stream.codec_context.sample_aspect_ratio = 1 / aspect if turned else aspect
        if turned:
            stream.set_display_rotation(-90)
        out.mux(stream.encode(av.VideoFrame.from_ndarray(stored)))
        out.mux(stream.encode(None))
    return probe(path), image


def opened(clip: Path, camera: Path | None) -> tuple[Camera, list[str]]:
    over = {
        "input": {"clip": str(clip), **({"camera": str(camera)} if camera else {})}
    }
    _, found, notices = open_clip(load(None, over, parameters()))
    return found, notices


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("calibrated", ["guess", "displayed", "stored"])
def test_a_squeezed_clip_has_the_camera_of_the_square_one(
    tmp_path: Path, calibrated: str, turned: bool
) -> None:
    info, _ = squeezed(tmp_path / "a.mp4", 288, ASPECT, turned)
    assert (info.width, info.height) == (
        288,
        216,
    ) and info.pixel_aspect == pytest.approx(4 / 3)
    square = Camera.guess(*SHOWN) if calibrated == "guess" else clip_camera(*SHOWN)
    wanted = square.scaled_to(288, 216, 4 / 3)
    file = None
    if calibrated != "guess":
        file = write_camera(
            tmp_path / "c.yaml", square if calibrated == "displayed" else wanted
        )
    camera, notices = opened(info.path, file)
    np.testing.assert_allclose(camera.matrix, wanted.matrix, rtol=1e-6)
    assert camera.fy == pytest.approx(camera.fx * 4 / 3)
    assert any("not square" in text for text in notices)


def test_the_marker_is_seen_in_the_same_directions_in_both(tmp_path: Path) -> None:
    file = write_camera(tmp_path / "c.yaml", clip_camera(*SHOWN))
    for width, aspect in ((384, Fraction(1)), (288, ASPECT)):
        info, image = squeezed(tmp_path / f"{width}.mp4", width, aspect)
        camera, _ = opened(info.path, file)
        (marker,) = MarkerDetector(["36h11"], 12.0).search(image[..., 1].copy())
        corners = pose_at(0, 2).apply(MARKER.corners_m)
        np.testing.assert_allclose(
            camera.normalised(marker.quad_px),
            corners[:, :2] / corners[:, 2:],
            atol=0.012,
        )  # 2 px


def test_a_calibration_of_another_shape_is_refused_still(tmp_path: Path) -> None:
    info, _ = squeezed(tmp_path / "a.mp4", 288, ASPECT)
    with pytest.raises(InputError, match="aspect ratios differ"):
        opened(info.path, write_camera(tmp_path / "c.yaml", clip_camera(640, 400)))


def test_an_impossible_aspect_is_said_and_not_used(tmp_path: Path) -> None:
    info, _ = squeezed(tmp_path / "a.mp4", 288, Fraction(200, 1))
    assert info.pixel_aspect == 1 and any(
        "not plausible" in text for text in info.notices
    )
