"""Rigid transforms and rotations.

`dest_from_source` poses map source coordinates to destination ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from arfx.core.numerics import EPS_ANGLE, normalise


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with skew(a) @ b = a x b."""
    v = np.asarray(v, float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def rotation_from_rotvec(rotvec: np.ndarray) -> np.ndarray:
    """Rodrigues: rotation vector (..., 3), radians, to matrix (..., 3, 3); series near zero."""
    r = np.asarray(rotvec, float)
    t2 = (r * r).sum(-1)[..., None, None]
    t = np.sqrt(t2)
    small = t < EPS_ANGLE
    ts = np.where(small, 1.0, t)
    a = np.where(small, 1 - t2 / 6, np.sin(ts) / ts)
    b = np.where(small, 0.5 - t2 / 24, (1 - np.cos(ts)) / (ts * ts))
    k = skew(r)
    return np.eye(3) + a * k + b * (k @ k)


def rotvec_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Matrix (..., 3, 3) to rotation vector of length <= pi, through a quaternion: stable
    at 0 and pi.
    """
    q = quaternion_from_rotation(rotation)
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2 * np.arctan2(s, q[..., 0])
    factor = np.where(
        s < EPS_ANGLE, 2.0 + s * s / 3, angle / np.where(s < EPS_ANGLE, 1.0, s)
    )
    return q[..., 1:] * factor[..., None]


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """(..., 3, 3) to unit quaternion (..., 4), scalar first (Shepperd: the largest element
    is the pivot).
    """
    m = np.asarray(rotation, float)
    transposed = m.swapaxes(-1, -2)
    trace = m.trace(axis1=-2, axis2=-1)[..., None]
    products = np.empty((*m.shape[:-2], 4, 4))  # 4 q_i q_j
    products[..., 0, 0] = 1 + trace[..., 0]
    products[..., 1:, 1:] = m + transposed + (1 - trace[..., None]) * np.eye(3)
    turn = (m - transposed)[..., [2, 0, 1], [1, 2, 0]]
    products[..., 0, 1:] = products[..., 1:, 0] = turn
    pick = products.diagonal(axis1=-2, axis2=-1).argmax(-1)[..., None, None]
    return normalise(np.take_along_axis(products, pick, -2)[..., 0, :])


def rotation_from_quaternion(w: float, x: float, y: float, z: float) -> np.ndarray:
    """(3, 3) of a unit quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_from_euler_deg(x: float, y: float, z: float) -> np.ndarray:
    """Rotation about x, then y, then z (fixed axes), degrees."""
    rx, ry, rz = (
        rotation_from_rotvec(np.radians(a) * np.eye(3)[i]) for i, a in enumerate((x, y, z))
    )
    return rz @ ry @ rx


@dataclass(frozen=True)
class Pose:
    """A rigid transform: p_dest = rotation @ p_source + translation_m.
    rotation : (3, 3) float64, orthonormal, det +1
    translation_m : (3,) float64, metres"""

    rotation: np.ndarray
    translation_m: np.ndarray

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

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the source in destination coordinates."""
        return np.asarray(points, float) @ self.rotation.T + self.translation_m

    @cached_property
    def rotvec(self) -> np.ndarray:
        return rotvec_from_rotation(self.rotation)

    @property
    def matrix(self) -> np.ndarray:
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.rotation, self.translation_m
        return m

    @staticmethod
    def identity() -> Pose:
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_rotvec(rotvec: np.ndarray, translation_m: np.ndarray) -> Pose:
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
        return isinstance(other, Pose) and bool(
            np.array_equal(self.rotation, other.rotation)
            and np.array_equal(self.translation_m, other.translation_m)
        )

    __hash__ = None  # type: ignore[assignment]  # arrays inside; compare by value only


def rotation_angle_rad(a: Pose, b: Pose) -> float:
    """Angle of the rotation between two poses, radians, 0..pi."""
    return float(np.linalg.norm(rotvec_from_rotation(a.rotation.T @ b.rotation)))
