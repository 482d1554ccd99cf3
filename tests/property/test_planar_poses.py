"""Planar poses and their derivatives over random and nearly singular views."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from arfx.analyse.pose.planar import (
    Observed,
    apply_step,
    both_poses,
    information,
    jacobian,
    lens_scale,
    refine_poses,
    residuals,
)
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_angle_rad
from tests.planar import planar
from tests.unit.analyse.synthetic import camera, tilted

M = MarkerSpec("36h11", 0, 0.1)
LENS = Camera(
    640,
    480,
    np.array([[700.0, 0, 320], [0, 710, 240], [0, 0, 1]]),
    np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01]),
)
angle = st.floats(-1.1, 1.1)
turn = st.floats(-3.1, 3.1)
place = st.floats(-0.25, 0.25)


def seen(pose: Pose, cam: Camera) -> tuple[np.ndarray, np.ndarray]:
    ideal = cam.normalised(cam.project(pose.apply(M.corners_m)))
    return ideal, lens_scale(cam, ideal)


@settings(max_examples=60, deadline=None)
@given(angle, angle, turn, place, place, st.floats(0.3, 5.0))
@example(0.0, 0.0, 0.0, 0.25, 0.25, 2.0)  # parallel to the picture, off the axis
@example(0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
@example(0.0, 0.9375, 0.0, 0.0, 0.0, 4.0)  # turned about an axis of its own
@example(
    0.0, -1.0, 0.0, -0.25, 0.125, 3.0
)  # the same, where IPPE knows one of two alone
@example(0.0, -1.0, 0.0, -0.0625, 0.0, 4.0)  # and none
def test_truth_is_among_the_planar_poses(
    a: float, b: float, c: float, x: float, y: float, z: float
) -> None:
    pose = (
        tilted([a, b, 0], [x * z, y * z, z])
        @ tilted([0, 0, 0], [0, 0, 0]).inverse()
        @ tilted([0, 0, c], [0, 0, 0])
    )
    facing = (
        pose.rotation[:, 2] @ pose.translation_m / np.linalg.norm(pose.translation_m)
    )
    if facing > -0.15:  # seen from behind or along its plane
        return
    ideal, scale = seen(pose, LENS)
    found = planar(M.corners_m, ideal, scale, 0.1)
    assert 1 <= len(found) <= 2 and found[0][1] <= found[-1][1]
    best, error_px = min(found, key=lambda one: rotation_angle_rad(one[0], pose))
    assert rotation_angle_rad(best, pose) < 2e-3 and error_px < 1e-3
    np.testing.assert_allclose(best.translation_m, pose.translation_m, atol=1e-4 * z)


@pytest.mark.parametrize("tilt", [0.0, 1e-10, 1e-7, 1e-4, 1e-2, -1e-2, -1e-4])
def test_nearly_frontal_views_give_finite_poses(tilt: float) -> None:
    pose = tilted([tilt, tilt / 2, 0], [0, 0, 2.0])
    ideal, scale = seen(pose, camera())
    found = planar(M.corners_m, ideal, scale, 0.1)
    assert found
    for one, error_px in found:
        assert np.isfinite(one.matrix).all() and error_px < 0.05
        assert rotation_angle_rad(one, pose) < 0.05


def test_corners_that_no_direction_leads_to_give_no_pose() -> None:
    in_a_line = 0.01 * np.array([[0, 0], [1, 1], [2, 2], [3, 3.0]])
    for nowhere in (np.full((4, 2), np.nan), np.zeros((4, 2)), in_a_line):
        assert both_poses(M.corners_m, nowhere).shape == (0, 2, 3)


@settings(max_examples=30, deadline=None)
@given(angle, angle, place, st.floats(0.5, 3.0), st.integers(0, 5))
def test_jacobian_is_the_derivative(
    a: float, b: float, x: float, z: float, axis: int
) -> None:
    pose = tilted([a, b, 0.3], [x * z, 0, z])
    ideal, scale = seen(pose, LENS)
    one = Observed(M.corners_m[None], ideal[None], scale[None], np.ones((1, 4)))
    r, t = pose.rotation[None], pose.translation_m[None]
    h = 1e-6
    step = np.eye(6)[axis : axis + 1] * h
    numeric = (
        residuals(*apply_step(r, t, step), one)
        - residuals(*apply_step(r, t, -step), one)
    ) / (2 * h)
    np.testing.assert_allclose(
        jacobian(r, t, one)[0, :, :, axis], numeric[0], rtol=1e-5, atol=1e-3
    )


@settings(max_examples=20, deadline=None)
@given(angle, st.integers(0, 1000))
def test_information_predicts_the_scatter(a: float, seed: int) -> None:
    """Refined poses of noisy corners scatter as the inverse information says (Mahalanobis
    distance, 6 degrees).
    """
    pose = tilted([0.6 + 0.3 * a, 0.5, 0], [0.05, 0, 0.8])
    cam = camera()
    ideal, scale = seen(pose, cam)
    n, sigma = 64, 0.05
    noise = np.random.default_rng(seed).normal(0, sigma, (n, 4, 2))
    noisy = ideal + np.einsum("pij,npj->npi", np.linalg.inv(scale), noise)
    tile = (np.repeat(v[None], n, 0) for v in (M.corners_m, scale))
    points, scales = tile
    many = Observed(points, noisy, scales, np.full((n, 4), sigma**-2))
    r, t, _ = refine_poses(
        np.repeat(pose.rotation[None], n, 0),
        np.repeat(pose.translation_m[None], n, 0),
        many,
    )
    info = information(
        pose.rotation[None], pose.translation_m[None], many.take(np.array([0]))
    )[0]
    error = []
    for k in range(n):
        e = Pose(r[k], t[k]) @ pose.inverse()
        v = np.concatenate([e.rotvec, e.translation_m])
        error.append(float(v @ info @ v))
    assert 3.5 < np.mean(error) < 9.5
