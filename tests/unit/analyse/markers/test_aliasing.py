"""Edges as sharp as the pixels: the corners' error is what is said of it, and no pose is
mirrored for it.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.corners import linear_table, refine_corners, shared_px
from arfx.core.colour import Transfer
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_angle_rad, rotation_from_rotvec
from tests.observed import Observed
from tests.unit.analyse.synthetic import FACING, background, camera, picture

TABLE = linear_table()
CELLS = np.array([8])


def dark_quad(
    quad: np.ndarray, size: int, point: bool, blur_px: float = 0.0
) -> np.ndarray:
    """(size, size) uint8: a dark quad on white, exact area of each pixel covered, or what
    lies under the pixel's centre.

    blur_px : of the light before the pixels take it, Gaussian
    """
    y, x = np.mgrid[:size, :size].astype(float)
    # a Gaussian lens over a square pixel, as the mean of shifted pictures: exact enough with 9 x 9
    t = np.linspace(-2.4, 2.4, 9) * blur_px if blur_px else np.zeros(1)
    share = np.exp(-0.5 * (np.linspace(-2.4, 2.4, 9)) ** 2) if blur_px else np.ones(1)
    covered = np.zeros((size, size))
    for dx, wx in zip(t, share, strict=True):
        for dy, wy in zip(t, share, strict=True):
            inside = np.zeros((size, size))
            for a, b in zip(quad, np.roll(quad, -1, 0), strict=True):
                n = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
                inside += _half_plane(
                    (x + dx - a[0]) * n[0] + (y + dy - a[1]) * n[1], np.abs(n), point
                )
            covered += wx * wy * np.clip(inside - 3, 0, 1)
    covered /= share.sum() ** 2
    return (
        np.clip(Transfer("srgb").encode(0.85 - 0.8 * covered) * 255, 0, 255)
        .round()
        .astype(np.uint8)
    )


def _half_plane(d: np.ndarray, n: np.ndarray, point: bool) -> np.ndarray:
    """Share of a unit pixel on the inner side of a line at signed distance d with normal
    components n.
    """
    high, low = float(n.max()), float(n.min())
    if point:
        return (d >= 0).astype(float)
    if low < 1e-6:
        return np.clip(d / high + 0.5, 0, 1)
    s, t = (high + low) / 2, (high - low) / 2
    return sum(
        k * np.maximum(d + o, 0) ** 2 / 2
        for k, o in ((1, s), (-1, t), (-1, -t), (1, -s))
    ) / (high * low)  # type: ignore[no-any-return]


def scatter(
    side_px: float, angle_deg: float, point: bool, blur_px: float = 0.0
) -> tuple[float, float]:
    """(rms error of a corner coordinate, rms of what is predicted) over places between the
    pixels.
    """
    rng = np.random.default_rng(3)
    size, s, a = int(1.5 * side_px + 24), side_px / 2, np.radians(angle_deg)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    error, said = [], []
    for _ in range(20):
        quad = (
            np.array([[-s, -s], [s, -s], [s, s], [-s, s]]) @ turn.T
            + size / 2
            + rng.uniform(-0.5, 0.5, 2)
        )
        r = refine_corners(
            dark_quad(quad, size, point, blur_px),
            quad[None] + rng.uniform(-0.8, 0.8, 2),
            CELLS,
            TABLE,
        )
        assert r.refined[0]
        error.append(r.corners_px[0] - quad)
        said.append(
            np.hypot(r.sigma_px[0], shared_px(r.corners_px, r.blur_px, CELLS)[0])
        )
    return float(np.sqrt(np.mean(np.square(error)))), float(
        np.sqrt(np.mean(np.square(said)))
    )


ANGLES = (0.0, 0.7, 1.5, 3.0, 10.0, 26.565, 45.0)


@pytest.mark.parametrize("angle_deg", ANGLES)
@pytest.mark.parametrize("side_px, limit_px", [(24.0, 0.12), (40.0, 0.05)])
def test_predicted_error_covers_the_true_one_in_pixels_that_integrate(
    side_px: float, limit_px: float, angle_deg: float
) -> None:
    error, said = scatter(side_px, angle_deg, point=False)
    assert error < limit_px and error < 1.3 * said
    if angle_deg == 10.0:
        assert (
            said < 0.04
        )  # a slanted side averages the steps away, and that is known


@pytest.mark.parametrize("angle_deg", ANGLES)
def test_predicted_error_covers_the_true_one_with_one_sample_per_pixel(
    angle_deg: float,
) -> None:
    error, said = scatter(40.0, angle_deg, point=True)
    assert error / 1.3 < said < 0.5


@pytest.mark.parametrize("angle_deg", [0.0, 1.0, 10.0])
def test_a_lens_spreads_the_steps(angle_deg: float) -> None:
    error, said = scatter(40.0, angle_deg, point=False, blur_px=0.6)
    assert error < 0.01 and error < said < 0.05


def test_an_unrefined_corner_has_no_steps() -> None:
    quad = np.array([[[10.0, 10], [50, 10], [50, 50], [10, 50]]])
    assert shared_px(quad, np.array([np.nan]), CELLS)[0] == 0.0
    wide, sharp = (shared_px(2 * quad, np.array([b]), CELLS)[0] for b in (1.5, 0.3))
    assert 0 < wide < 0.03 < sharp < 0.5


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_frontal_40_px_print_without_any_blur_is_never_mirrored(seed: int) -> None:
    """Rolls through upright, where all samples of a side see the same step: corners were
    off by .15 px, poses by 5 deg.
    """
    m, cam = MarkerSpec("36h11", 3, 0.06), camera(320, 240, 433.0)
    back, phase = background(320, 240), np.random.default_rng(seed).uniform(0, 6, 4)
    analyser, truth = Observed(AnalysisJob((m,), cam)), []
    for k in range(40):
        a = k / 24
        roll = np.radians(8) * np.sin(2.2 * a + phase[0])
        tilt = np.array(
            [
                0.045 + 0.004 * np.sin(3 * a + phase[1]),
                0.02 + 0.004 * np.sin(2.5 * a + phase[2]),
                0,
            ]
        )
        place = np.array(
            [
                0.004 + 0.003 * np.sin(2 * a + phase[3]),
                -0.01,
                433 * 0.06 / 40 * (1 - 0.03 * a),
            ]
        )
        pose = Pose(
            rotation_from_rotvec(tilt)
            @ rotation_from_rotvec(np.array([0, 0, roll]))
            @ FACING,
            place,
        )
        analyser.step(
            AnalysisFrame(
                k, a, picture(cam, [(m, pose)], back, noise=0.5, blur_px=0, seed=k)
            )
        )
        truth.append(pose)
    facts = analyser.finish().facts
    for smoothed, limit_deg in ((False, 4.0), (True, 1.0)):
        for f, pose in zip(facts, truth, strict=True):
            got = f.camera_from_world if smoothed else f.raw_camera_from_world
            assert (
                got is not None
                and np.degrees(rotation_angle_rad(got, pose)) < limit_deg
            )


def test_blur_brings_the_next_cells_near_the_edge() -> None:
    quad = np.array([[[10.0, 10], [90, 10], [90, 90], [10, 90]]])
    little, some, much = (
        shared_px(quad, np.array([b]), CELLS)[0] for b in (1.4, 2.5, 3.2)
    )
    assert (
        little < 0.02 and 0.04 < some < 0.06 and 0.15 < much < 0.4
    )  # measured on drawn prints: tests/hard/pixels.py


def test_a_print_turned_away_is_as_narrow_as_it_looks() -> None:
    """The window keeps off the inner cells of the narrow direction."""
    square, turned = (
        np.array([[[10.0, 10], [90, 10], [90, 10 + h], [10, 10 + h]]])
        for h in (80.0, 20.0)
    )
    assert (
        shared_px(turned, np.array([0.6]), CELLS)[0]
        > 2 * shared_px(square, np.array([0.6]), CELLS)[0]
    )
