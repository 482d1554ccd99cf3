"""Rotations near every singularity, against scipy as an outside reference."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from arfx.core.pose import (
    Pose,
    rotation_from_euler_deg,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotvec_from_rotation,
)

AXES = np.vstack(
    [np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(20, 3))]
)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
NEAR = [
    s * d
    for d in (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1.0001e-4, 1e-2)
    for s in (1, -1)
]


@pytest.mark.parametrize("centre", [0.0, np.pi / 2, np.pi])
@pytest.mark.parametrize("delta", NEAR)
def test_rotation_round_trip_stays_accurate_near_singular_angles(
    centre: float, delta: float
) -> None:
    r = AXES * (centre + delta)
    m = rotation_from_rotvec(r)
    np.testing.assert_allclose(m, Rotation.from_rotvec(r).as_matrix(), atol=3e-15)
    back = rotation_from_rotvec(rotvec_from_rotation(m))
    np.testing.assert_allclose(back, m, atol=3e-15)
    assert np.linalg.norm(rotvec_from_rotation(m), axis=1).max() <= np.pi + 1e-12


def test_quaternions_agree_with_scipy() -> None:
    rotations = Rotation.random(200, random_state=1)
    q = rotations.as_quat(scalar_first=True)
    np.testing.assert_allclose(
        rotation_from_quaternion(q), rotations.as_matrix(), atol=1e-14
    )


def test_euler_turns_about_x_then_y_then_z() -> None:
    np.testing.assert_allclose(
        rotation_from_euler_deg(10, 20, 30),
        Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(),
        atol=1e-15,
    )


def test_pose_composition_inverse_and_json() -> None:
    rng = np.random.default_rng(2)
    a, b = (
        Pose.from_rotvec(rng.normal(size=3), rng.normal(size=3)) for _ in range(2)
    )
    p = rng.normal(size=(5, 3))
    np.testing.assert_allclose((a @ b).apply(p), a.apply(b.apply(p)), atol=1e-14)
    np.testing.assert_allclose(a.inverse().apply(a.apply(p)), p, atol=1e-14)
    np.testing.assert_allclose(
        Pose.from_json(a.to_json()).matrix, a.matrix, atol=1e-14
    )
