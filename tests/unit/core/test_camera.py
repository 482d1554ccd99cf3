"""Projection against cv2 as the outside reference, its inverse, and the fold of strong
distortion.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.errors import InputError

K = np.array([[1764.6, 0, 989.15], [0, 1760.2, 544.9], [0, 0, 1]])
D = np.array(
    [
        0.39,
        -2.55,
        -0.0011,
        0.0017,
        5.66,
        0.047,
        0.118,
        -0.225,
        0.001,
        0.002,
        -0.001,
        0.001,
        0.01,
        -0.02,
    ]
)


def points(n: int = 300) -> np.ndarray:
    rng = np.random.default_rng(0)
    z = rng.uniform(0.2, 5, n)
    return np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)) * z[:, None], z])


@pytest.mark.parametrize("n", [0, 4, 5, 8, 12, 14])
def test_project_is_cv2_project_points(n: int) -> None:
    camera = Camera(1920, 1080, K, D[:n])
    p = points()
    reference = cv2.projectPoints(p, np.zeros(3), np.zeros(3), K, D[:n])[0][:, 0]
    np.testing.assert_allclose(camera.project(p), reference, atol=1e-8)
    np.testing.assert_allclose(
        camera.normalised(reference), p[:, :2] / p[:, 2:], atol=1e-9
    )


def test_fisheye_is_cv2_fisheye() -> None:
    d = np.array([0.04, -0.02, 0.01, -0.003])
    camera = Camera(1920, 1080, K, d, FISHEYE)
    p = points()
    reference = cv2.fisheye.projectPoints(p[:, None], np.zeros(3), np.zeros(3), K, d)[
        0
    ][:, 0]
    np.testing.assert_allclose(camera.project(p), reference, atol=1e-8)
    np.testing.assert_allclose(
        camera.normalised(reference), p[:, :2] / p[:, 2:], atol=1e-9
    )


@pytest.mark.parametrize("tilt_deg", [10.0, 70.0, 80.0, 89.0])
def test_a_fisheye_has_directions_up_to_its_side(tilt_deg: float) -> None:
    camera = Camera(1920, 1080, K, np.array([0.04, -0.02, 0.01, -0.003]), FISHEYE)
    r = np.tan(np.radians(tilt_deg))
    ideal = r * np.array([[1, 0], [0.6, -0.8], [0, 1]])
    pixels = camera.project(np.column_stack([ideal, np.ones(3)]))
    np.testing.assert_allclose(camera.normalised(pixels), ideal, rtol=1e-8, atol=1e-8)


def test_fisheye_without_coefficients_holds_the_four_zeros_that_opencv_wants() -> (
    None
):
    bare = Camera(1920, 1080, K, np.zeros(0), FISHEYE)
    ideal = cv2.fisheye.undistortPoints(
        bare.project(points())[:, None], bare.matrix, bare.distortion
    )[:, 0]
    np.testing.assert_allclose(
        ideal, bare.normalised(bare.project(points())), atol=1e-6
    )


def test_points_behind_or_beyond_the_fold_are_not_projected_into_the_picture() -> (
    None
):
    camera = Camera(
        640,
        480,
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        np.array([-0.3, 0, 0, 0]),
    )
    assert np.isfinite(camera.max_radius)
    beyond = np.array(
        [[camera.max_radius * 1.05, 0, 1.0], [camera.max_radius * 3, 0, 1]]
    )
    assert np.isnan(camera.project(beyond)).all(), (
        "the polynomial folds back: these would reappear inside"
    )
    assert np.isnan(
        camera.project(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, np.nan]]))
    ).all()
    far = camera.normalised(np.array([[5000.0, 240]]))
    assert np.isnan(far).all(), "no direction maps to that pixel"


@pytest.mark.parametrize(
    ("distortion", "model"),
    [((-0.3, 0, 0, 0), BROWN), ((-0.1, 0.02, 0.0, 0.0), FISHEYE)],
)
def test_a_pixels_direction_is_the_same_bits_whatever_pixels_are_beside_it(
    distortion: tuple[float, ...], model: str
) -> None:
    """Near the axis one step is enough, near the fold and beyond it the last one is not."""
    k = np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]])
    camera = Camera(640, 480, k, np.array(distortion), model)
    pixels = np.stack(
        np.meshgrid(np.arange(-200, 840, 40.0), np.arange(-200, 680, 40.0)), -1
    )
    together = camera.normalised(pixels)
    assert np.isnan(together).any() and np.isfinite(together).any()
    alone = np.array([[camera.normalised(p) for p in row] for row in pixels])
    np.testing.assert_array_equal(alone, together)
    assert (
        camera.normalised(pixels[:0]).shape == (0, 26, 2)
        and np.isnan(camera.normalised(np.array([np.nan, 1.0]))).all()
    )


def test_scaling_keeps_the_direction_of_every_relative_position() -> None:
    camera = Camera(1920, 1080, K, D[:5])
    half = camera.scaled_to(960, 540)
    edge = np.array([[-0.5, -0.5], [1919.5, 1079.5], [700.0, 300.0]])
    np.testing.assert_allclose(
        half.normalised((edge + 0.5) / 2 - 0.5), camera.normalised(edge), atol=1e-9
    )
    with pytest.raises(InputError, match="1920x1080"):
        camera.scaled_to(640, 480)


@pytest.mark.parametrize("bad", ["matrix", "distortion", "focal", "count"])
def test_impossible_calibrations_are_refused_with_their_source(bad: str) -> None:
    m, d = K.copy(), D[:5].copy()
    if bad == "matrix":
        m[0, 2] = np.nan
    elif bad == "distortion":
        d[1] = np.inf
    elif bad == "focal":
        m[0, 0] = 0
    else:
        d = D[:7]
    with pytest.raises(InputError, match=r"cam\.yaml"):
        Camera(1920, 1080, m, d, source="cam.yaml")


def test_json_round_trip_is_exact() -> None:
    camera = Camera(1920, 1080, K, D, source="x")
    back = Camera.from_json(camera.to_json())
    assert np.array_equal(back.matrix, camera.matrix) and np.array_equal(
        back.distortion, camera.distortion
    )
