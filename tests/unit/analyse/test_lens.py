"""The footage's lens from the blur of its marker: end to end through the analysis, and
refused where it cannot be told.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.lens import lens_from_blur
from arfx.analyse.markers.corners import side_blurs
from arfx.core.colour import SRGB
from arfx.core.pose import Pose, rotation_from_euler_deg
from tests.clips import MARKER, clip_camera, picture
from tests.observed import Observed

CAMERA = clip_camera(640, 480)


def disc(radius_px: float, fine: int = 8) -> np.ndarray:
    """(n, n) float32 share of the disc in every pixel, sum 1."""
    n = int(np.ceil(radius_px)) + 1
    p = (np.arange((2 * n + 1) * fine) + 0.5) / fine - n - 0.5
    x, y = np.meshgrid(p, p)
    k = (
        (x * x + y * y <= radius_px**2)
        .reshape(2 * n + 1, fine, 2 * n + 1, fine)
        .mean((1, 3))
    )
    return (k / k.sum()).astype(np.float32)


def blurred(pose: Pose, radius_px: float, seed: int) -> np.ndarray:
    """(h, w) uint8: the marker as a lens blurs it that is as far from all of the print."""
    light = SRGB.decode(picture(pose, CAMERA)[..., 1] / 255.0).astype(np.float32)
    if radius_px > 0.3:
        light = cv2.filter2D(
            light, -1, disc(radius_px), borderType=cv2.BORDER_REPLICATE
        )
    noise = np.random.default_rng(seed).normal(size=light.shape)
    return np.clip(255 * SRGB.encode(light) + 1.5 * noise, 0, 255).astype(np.uint8)


def analysed(
    px_per_dioptre: float, focus_m: list[float], distance_m: np.ndarray
) -> Analysis:
    analyser = Observed(AnalysisJob((MARKER,), CAMERA), {"lens"})
    for k, (z, focus) in enumerate(zip(distance_m, focus_m, strict=True)):
        turn = (
            rotation_from_euler_deg(180, 0, 0)
            @ rotation_from_euler_deg(-12, 0, 0)
            @ rotation_from_euler_deg(0, 0, 17)
        )
        luma = blurred(
            Pose(turn, np.array([0, 0, z])),
            px_per_dioptre * abs(1 / z - 1 / focus),
            k,
        )
        analyser.step(AnalysisFrame(k, k / 25, luma))
    return analyser.finish()


DISTANCES = 1 / np.linspace(1 / 0.3, 1 / 0.8, 28)


def test_a_shallow_focus_is_found_and_every_frame_is_told() -> None:
    found = analysed(3.2, [0.45] * 28, DISTANCES)
    fit = found.facts[3].lens
    assert (
        fit is not None
        and fit.known
        and fit == found.facts[20].lens
        and fit.to_json() == found.summary["footage_lens"]
    )
    assert (
        fit.focus == pytest.approx(1 / 0.45, abs=0.12)
        and abs(fit.focus - 1 / 0.45) < 1.5 * fit.focus_ci95
    )
    assert fit.px_per_dioptre == pytest.approx(3.2, rel=0.12)


@pytest.mark.parametrize(
    ("px_per_dioptre", "focus_m", "words"),
    [(0.0, [0.45] * 28, "does not grow"), (3.2, [0.34] * 14 + [0.65] * 14, "")],
    ids=["all sharp", "focus pulled along"],
)
def test_refused_where_the_footage_does_not_tell(
    px_per_dioptre: float, focus_m: list[float], words: str
) -> None:
    found = analysed(px_per_dioptre, focus_m, DISTANCES)
    fit = found.summary["footage_lens"]
    assert not fit["known"] and words in fit["reason"] and fit["focus_ci95"] is None
    assert any("lens cannot be measured" in n for n in found.notices)


@pytest.mark.parametrize(
    ("radius", "tilt_deg"),
    [
        (0.0, 0.0),
        (1.5, 0.0),
        (3.0, 0.0),
        (4.5, 0.0),
        (0.0, 60.0),
        (2.0, 60.0),
        (2.0, 40.0),
    ],
)
def test_blur_of_a_disc_is_half_its_radius(radius: float, tilt_deg: float) -> None:
    """On a tilted print too, where a cell is less deep across the near and the far side
    than it is long along them.
    """
    turn = rotation_from_euler_deg(-tilt_deg, 0, 0) @ rotation_from_euler_deg(
        0, 0, 17 if tilt_deg == 0 else 0
    )
    pose = Pose(
        rotation_from_euler_deg(180, 0, 0) @ turn,
        np.array([0, 0, 0.35 if tilt_deg == 0 else 0.3]),
    )
    corners = CAMERA.project(pose.apply(MARKER.corners_m))
    table = (255 * SRGB.decode(np.arange(256) / 255)).astype(np.float32)
    seen = blurred(pose, radius, 0)
    (blur,) = side_blurs(seen, corners[None], np.array([8]), table)
    np.testing.assert_allclose(
        blur, np.sqrt(radius**2 / 4 + 0.55**2), rtol=0.08, atol=0.03
    )


def test_what_grows_faster_than_a_lens_is_refused() -> None:
    """Three sides alike and a fourth that something else blurs, from a camera at rest."""
    noise = 1 + 0.02 * np.random.default_rng(0).standard_normal(400)
    dioptre = np.tile([0.683, 0.705, 0.705, 0.729], 100) * (
        1 + 0.003 * np.random.default_rng(1).standard_normal(400)
    )
    fit = lens_from_blur(dioptre, np.tile([0.63, 0.64, 0.64, 3.05], 100) * noise, 0.1)
    assert not fit.known and "faster with distance than a lens's" in fit.reason
