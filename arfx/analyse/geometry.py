"""Many poses at once: projection, Jacobians and robust least squares over marker corners, vectorised over frames.

Corners are kept as ideal normalised coordinates together with the lens's local scale (how many picture pixels one unit
of them is, a 2 x 2 matrix): residuals are then in picture pixels through the distorted camera, to first order
in the residual, without evaluating the lens again.
Poses are pairs rotation (n, 3, 3), translation (n, 3); perturbations multiply from the left in the camera frame,
[rotation rad, translation m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.analyse import pose_kernels
from arfx.analyse.pose_kernels import HUBER_SIGMA
from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.pose import Pose, rotation_from_rotvec, skew


@dataclass(frozen=True)
class Observed:
    """Corners seen in n frames, at most p in each.

    points_m : (n, p, 3) world (or marker) coordinates;  ideal : (n, p, 2) normalised;  px_per_ideal : (n, p, 2, 2)
    weight : (n, p) 1 / sigma_px^2, 0 = no corner
    """

    points_m: np.ndarray
    ideal: np.ndarray
    px_per_ideal: np.ndarray
    weight: np.ndarray

    def take(self, index: np.ndarray) -> Observed:
        return Observed(self.points_m[index], self.ideal[index], self.px_per_ideal[index], self.weight[index])


def lens_scale(camera: Camera, ideal: np.ndarray) -> np.ndarray:
    """(..., 2, 2) px per unit of ideal normalised coordinates, at ideal (..., 2): central differences."""
    h = 1e-6
    focal = np.array([camera.fx, camera.fy])
    columns = []
    for axis in np.eye(2) * h:
        columns.append((camera.distort(ideal + axis) - camera.distort(ideal - axis)) / (2 * h) * focal)
    return np.stack(columns, -1)


def residuals(rotation: np.ndarray, translation: np.ndarray, seen: Observed) -> np.ndarray:
    """(n, p, 2) px, predicted minus seen. Points behind the camera count as straight on its plane (EPS_DEPTH_M)."""
    q = np.einsum("nij,npj->npi", rotation, seen.points_m) + translation[:, None]
    z = np.maximum(q[..., 2:], EPS_DEPTH_M)
    return np.einsum("npij,npj->npi", seen.px_per_ideal, q[..., :2] / z - seen.ideal)


def jacobian(rotation: np.ndarray, translation: np.ndarray, seen: Observed) -> np.ndarray:
    """(n, p, 2, 6) px per left perturbation of the pose."""
    q = np.einsum("nij,npj->npi", rotation, seen.points_m) + translation[:, None]
    return seen.px_per_ideal @ view_jacobian(q) @ np.concatenate([-skew(q), np.broadcast_to(np.eye(3), (*q.shape, 3))], -1)


def view_jacobian(q: np.ndarray) -> np.ndarray:
    """(..., 2, 3) of (x/z, y/z) with respect to the point, camera coordinates (..., 3)."""
    z = np.maximum(q[..., 2], EPS_DEPTH_M)
    out = np.zeros((*q.shape[:-1], 2, 3))
    out[..., 0, 0] = out[..., 1, 1] = 1 / z
    out[..., 0, 2], out[..., 1, 2] = -q[..., 0] / z**2, -q[..., 1] / z**2
    return out


def huber_cost(r: np.ndarray, weight: np.ndarray, limit: float = HUBER_SIGMA) -> tuple[np.ndarray, np.ndarray]:
    """Cost per frame (n,) and factor (n, p) on the weights of corners whose residual exceeds `limit` sigma."""
    d2 = (r * r).sum(-1) * weight
    d = np.sqrt(d2)
    over = d > limit
    rho = np.where(over, 2 * limit * d - limit**2, d2)
    return 0.5 * rho.sum(-1), np.where(over, limit / np.where(over, d, 1.0), 1.0)


def refine_poses(
    rotation: np.ndarray, translation: np.ndarray, seen: Observed, iterations: int = 12
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on every frame separately, Huber loss: (rotation, translation, cost (n,))."""
    rotation, translation = np.array(rotation, float, order="C"), np.array(translation, float, order="C")
    cost = np.empty(len(rotation))
    points, ideal, scale, weight = (
        np.array(v, float, order="C") for v in (seen.points_m, seen.ideal, seen.px_per_ideal, seen.weight)
    )
    pose_kernels.refine(rotation, translation, points, ideal, scale, weight, iterations, cost)
    return rotation, translation, cost


def information(rotation: np.ndarray, translation: np.ndarray, seen: Observed) -> np.ndarray:
    """(n, 6, 6) Fisher information of each pose from its corners."""
    j = jacobian(rotation, translation, seen)
    return np.einsum("npki,npkj->nij", j * seen.weight[..., None, None], j)


def apply_step(rotation: np.ndarray, translation: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left-multiply by a small motion (n, 6): rotation about the camera's centre, then translation."""
    turn = rotation_from_rotvec(step[:, :3])
    return turn @ rotation, np.einsum("nij,nj->ni", turn, translation) + step[:, 3:]


def rms_px(r: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) root mean square over the corners present of the residual's length, px; 0 where there is none."""
    on = weight > 0
    total = ((r * r).sum(-1) * on).sum(-1)
    return np.sqrt(total / np.maximum(on.sum(-1), 1))


def stack(poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
    """Poses as arrays (n, 3, 3), (n, 3)."""
    if not poses:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    return np.stack([p.rotation for p in poses]), np.stack([p.translation_m for p in poses])
