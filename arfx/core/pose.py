"""Rigid transforms and rotations.

`dest_from_source` poses map source coordinates to destination ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from arfx.core.codec import Plain

_CROSS = np.cross(np.eye(3), np.eye(3)[:, None])  # [k, i] = e_i x e_k


def skew(v: ndarray) -> ndarray:
    """(..., 3) -> (..., 3, 3) with skew(a) @ b = a x b."""
    return np.tensordot(np.asarray(v, float), _CROSS, 1)


def rotation_from_rotvec(rotvec: ndarray) -> ndarray:
    """Rotation vector (..., 3), radians, to matrix (..., 3, 3); exact near zero."""
    return np.asarray(Rotation.from_rotvec(rotvec).as_matrix())


def rotvec_from_rotation(rotation: ndarray) -> ndarray:
    """Matrix (..., 3, 3) to rotation vector of length <= pi: stable at 0 and pi."""
    return np.asarray(Rotation.from_matrix(rotation, assume_valid=True).as_rotvec())


def rotation_from_quaternion(q: ndarray) -> ndarray:
    """(..., 3, 3) of unit quaternions (..., 4), scalar first."""
    k = skew(q[..., 1:])
    return np.asarray(np.eye(3) + 2 * (q[..., :1, None] * k + k @ k))


def rotation_from_euler_deg(x: float, y: float, z: float) -> ndarray:
    """Rotation about x, then y, then z (fixed axes), degrees."""
    return np.asarray(Rotation.from_euler("xyz", (x, y, z), degrees=True).as_matrix())


@dataclass(frozen=True, slots=True)
class Pose(Plain):
    """A rigid transform: p_dest = rotation @ p_source + translation_m.
    rotation : (3, 3) float64, orthonormal, det +1
    translation_m : (3,) float64, metres"""

    rotation: ndarray
    translation_m: ndarray

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(
            self.rotation @ other.rotation,
            self.rotation @ other.translation_m + self.translation_m,
        )

    def inverse(self) -> Pose:
        return Pose(self.rotation.T, -self.rotation.T @ self.translation_m)

    def towards(self, other: Pose, share: float) -> Pose:
        """Between this pose (0) and another (1): the shortest rotation, and the straight line."""
        turn = share * rotvec_from_rotation(self.rotation.T @ other.rotation)
        moved = (1 - share) * self.translation_m + share * other.translation_m
        return Pose(self.rotation @ rotation_from_rotvec(turn), moved)

    def apply(self, points: ndarray) -> ndarray:
        """Points (..., 3) of the source in destination coordinates."""
        return np.asarray(points, float) @ self.rotation.T + self.translation_m

    @property
    def rotvec(self) -> ndarray:
        return rotvec_from_rotation(self.rotation)

    @property
    def matrix(self) -> ndarray:
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.rotation, self.translation_m
        return m

    @staticmethod
    def identity() -> Pose:
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_rotvec(rotvec: ndarray, translation_m: ndarray) -> Pose:
        return Pose(
            rotation_from_rotvec(np.asarray(rotvec, float).reshape(3)),
            np.asarray(translation_m, float).reshape(3),
        )

    def to_json(self) -> list[float]:
        """[rx, ry, rz, tx, ty, tz]: rotation vector in radians, metres. Exact to float64
        round trip of the log.
        """
        return [*map(float, self.rotvec), *map(float, self.translation_m)]

    @staticmethod
    def from_json(v: list[float]) -> Pose:
        return Pose.from_rotvec(np.array(v[:3]), np.array(v[3:6]))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pose) and np.array_equal(self.matrix, other.matrix)

    __hash__ = None  # type: ignore[assignment]  # arrays inside; compare by value only


def rotation_angle_rad(a: Pose, b: Pose) -> float:
    """Angle of the rotation between two poses, radians, 0..pi."""
    return float(np.linalg.norm(rotvec_from_rotation(a.rotation.T @ b.rotation)))
