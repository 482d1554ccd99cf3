"""Many poses at once: projection, Jacobians and robust least squares over marker corners;
and both planar poses of a sighting.

Corners are ideal normalised coordinates with the lens's local scale (2 x 2), so residuals
are picture pixels, to first order. Poses are pairs rotation (n, 3, 3), translation (n, 3);
perturbations multiply from the left in the camera frame, [rotation rad, translation m].
Source: docs/methods/pose.md#planar."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M, divide, normalise
from arfx.core.pose import rotation_from_rotvec, skew

# two minima closer than this are one (a frontal marker): below any tilt noise seen
_SAME_RAD = 5e-3
HUBER_SIGMA = 3.0  # residuals beyond it count linearly
_AT_ONCE = 2000  # poses that are refined in one go
_CONVERGED = 1e-9  # change of the cost, relative to 1 + cost


class Observed(NamedTuple):
    """Corners seen in n frames, at most p in each.

    points_m : (n, p, 3) world (or marker) coordinates;  ideal : (n, p, 2) normalised;
    px_per_ideal : (n, p, 2, 2)
    weight : (n, p) 1 / sigma_px^2, 0 = no corner"""

    points_m: ndarray
    ideal: ndarray
    px_per_ideal: ndarray
    weight: ndarray

    def take(self, index: Any) -> Observed:
        return Observed(*(a[index] for a in self))


class PlanarPoses(NamedTuple):
    """Poses of n prints, in the end both, best first. rotation : (n, k, 3, 3);  translation :
    (n, k, 3);  error_px : (n, k) rms over the four corners, infinite where there is none"""

    rotation: ndarray
    translation: ndarray
    error_px: ndarray

    def take(self, index: Any) -> PlanarPoses:
        return PlanarPoses(*(a[index] for a in self))

    @property
    def known(self) -> ndarray:
        """(n, k) bool"""
        return np.isfinite(self.error_px)


def lens_scale(camera: Camera, ideal: ndarray) -> ndarray:
    """(..., 2, 2) px per unit of ideal normalised coordinates, at ideal (..., 2)."""
    return camera.stretch(ideal) * np.array([[camera.fx], [camera.fy]])


def _in_camera(rotation: ndarray, translation: ndarray, seen: Observed) -> ndarray:
    """(n, p, 3) the corners in camera coordinates."""
    return seen.points_m @ np.swapaxes(rotation, 1, 2) + translation[:, None]


def residuals(rotation: ndarray, translation: ndarray, seen: Observed) -> ndarray:
    """(n, p, 2) px, predicted minus seen.

    Points behind the camera count as straight on its plane (EPS_DEPTH_M).
    """
    q = _in_camera(rotation, translation, seen)
    z = np.maximum(q[..., 2:], EPS_DEPTH_M)
    return np.einsum("npij,npj->npi", seen.px_per_ideal, q[..., :2] / z - seen.ideal)


def jacobian(rotation: ndarray, translation: ndarray, seen: Observed) -> ndarray:
    """(n, p, 2, 6) px per left perturbation of the pose."""
    q = _in_camera(rotation, translation, seen)
    z = np.maximum(q[..., 2], EPS_DEPTH_M)
    view = np.zeros((*q.shape[:-1], 2, 3))  # of (x/z, y/z), by the point
    view[..., 0, 0] = view[..., 1, 1] = 1 / z
    view[..., 2] = -q[..., :2] / (z**2)[..., None]
    return seen.px_per_ideal @ view @ lever(q)


def lever(points: ndarray) -> ndarray:
    """(..., 3, 6) how points (..., 3) move, by a left perturbation in their axes."""
    straight = np.broadcast_to(np.eye(3), (*points.shape, 3))
    return np.concatenate([-skew(points), straight], -1)


def huber_cost(r: ndarray, weight: ndarray) -> tuple[ndarray, ndarray]:
    """Cost per frame (n,) and factor (n, p) on the weights of corners whose residual
    exceeds HUBER_SIGMA.
    """
    d2 = (r * r).sum(-1) * weight
    factor = HUBER_SIGMA / np.maximum(np.sqrt(d2), HUBER_SIGMA)
    return 0.5 * (d2 * factor * (2 - factor)).sum(-1), factor


def refine_poses(
    rotation: ndarray,
    translation: ndarray,
    seen: Observed,
    iterations: int = 12,
) -> tuple[ndarray, ndarray, ndarray]:
    """Levenberg-Marquardt on every frame separately, Huber loss: (rotation, translation,
    cost (n,)). Many are refined in turns: memory hardly grows with them.
    """
    rotation, translation = np.array(rotation, float), np.array(translation, float)
    cost, _ = huber_cost(residuals(rotation, translation, seen), seen.weight)
    damping, settled = np.full(len(cost), 1e-4), np.zeros(len(cost), int)
    every = np.flatnonzero(np.isfinite(cost))
    for at in np.split(every, range(_AT_ONCE, len(every), _AT_ONCE)):
        for _ in range(iterations):
            part, pose = seen.take(at), (rotation[at], translation[at])
            missed, j = residuals(*pose, part), jacobian(*pose, part)
            factor = huber_cost(missed, part.weight)[1]
            weighted = j * (part.weight * factor)[..., None, None]
            normal = _products(weighted, j)
            diagonal = np.einsum("nii->ni", normal)
            diagonal += diagonal * damping[at, None] + 1e-12
            step = -np.linalg.solve(normal, _products(weighted, missed[..., None]))
            turned, moved = apply_step(*pose, step[..., 0])
            now, _ = huber_cost(residuals(turned, moved, part), part.weight)
            # settled twice in a row: a refused step may by chance cost the same as the
            # place it came from
            still = np.abs(cost[at] - now) < _CONVERGED * (1 + cost[at])
            settled[at] = np.where(still, settled[at] + 1, 0)
            better = now < cost[at]
            damping[at] = np.clip(
                damping[at] * np.where(better, 0.2, 10.0), 1e-9, 1e6
            )
            taken = at[better]
            rotation[taken], translation[taken] = turned[better], moved[better]
            cost[taken] = now[better]
            at = at[settled[at] < 2]
            if not len(at):
                break
    return rotation, translation, cost


def information(rotation: ndarray, translation: ndarray, seen: Observed) -> ndarray:
    """(n, 6, 6) Fisher information of each pose from its corners."""
    j = jacobian(rotation, translation, seen)
    return _products(j * seen.weight[..., None, None], j)


def _products(a: ndarray, b: ndarray) -> ndarray:
    """(n, i, j) sums over corners and coordinates of a (n, p, 2, i) times b (n, p, 2, j)."""
    a, b = (v.reshape(len(v), 2 * v.shape[1], v.shape[-1]) for v in (a, b))
    return np.swapaxes(a, 1, 2) @ b


def best_of_each(owner: ndarray, cost: ndarray) -> ndarray:
    """(g,) which row costs least, of each owner's, in their order. owner, cost : (n,)"""
    order = np.lexsort((cost, owner))
    return order[np.unique(owner[order], return_index=True)[1]]


def apply_step(
    rotation: ndarray, translation: ndarray, step: ndarray
) -> tuple[ndarray, ndarray]:
    """Left-multiply by a small motion (n, 6): rotation about the camera's centre, then
    translation.
    """
    turn = rotation_from_rotvec(step[:, :3])
    return turn @ rotation, np.einsum("nij,nj->ni", turn, translation) + step[:, 3:]


def rms_px(r: ndarray, weight: ndarray) -> ndarray:
    """(n,) root mean square over the corners present of the residual's length, px; 0 where
    there is none.
    """
    on = weight > 0
    total = ((r * r).sum(-1) * on).sum(-1)
    return np.sqrt(total / np.maximum(on.sum(-1), 1))


def both_poses(corners_m: ndarray, ideal: ndarray) -> ndarray:
    """(k, 2, 3) rotation vector and translation of IPPE's one or two solutions, best first,
    wherever they lie; k = 0 for corners that no direction leads to.

    corners_m : (4, 3) of a rectangle, order of MarkerSpec.corners_m;  ideal : (4, 2)
    normalised, without lens distortion
    """
    if not np.isfinite(ideal).all():
        return np.zeros((0, 2, 3))
    square = corners_m[1, 0] == corners_m[1, 1]
    method = cv2.SOLVEPNP_IPPE_SQUARE if square else cv2.SOLVEPNP_IPPE
    solved = cv2.solvePnPGeneric(corners_m, ideal, np.eye(3), None, flags=method)
    return np.stack(solved[1:3], 1).reshape(-1, 2, 3)


def _facing_poses(corners_m: ndarray, ideal: ndarray) -> tuple[ndarray, ndarray]:
    """Rotation (n, 3, 3) and translation (n, 3) of markers that face the camera, at the
    place, distance and roll of their pictures.

    corners_m : (n, 4, 3);  ideal : (n, 4, 2)
    """
    size, extent = (
        np.linalg.norm(q - np.roll(q, -1, 1), axis=2).mean(1)
        for q in (corners_m, ideal)
    )
    ray = np.pad(ideal.mean(1), ((0, 0), (0, 1)), constant_values=1.0)
    across = ideal[:, 1] - ideal[:, 0] + ideal[:, 2] - ideal[:, 3]
    out = -normalise(ray)
    up = normalise(np.cross(out, np.pad(across, ((0, 0), (0, 1)))))
    rotation = np.stack([np.cross(up, out), up, out], -1)
    return rotation, ray * divide(size, extent, where_zero=1.0)[:, None]


def _in_sight(rotation: ndarray, translation: ndarray) -> ndarray:
    """(...) In front of the camera, printed side towards it."""
    towards = (rotation[..., 2] * translation).sum(-1)
    return (
        np.isfinite(translation).all(-1) & (translation[..., 2] > 0) & (towards < 0)
    )


def _mirrored(rotation: ndarray, translation: ndarray) -> ndarray:
    """(..., 3, 3) rotations of markers that, seen from afar, look the same: leaning as much,
    the other way along the ray to their middle."""
    ray = normalise(translation)
    mirror = np.eye(3) - 2 * ray[..., :, None] * ray[..., None, :]
    return mirror @ rotation @ np.diag([1.0, 1.0, -1.0])


def planar_poses(seen: Observed) -> PlanarPoses:
    """Of n sightings of four corners, refined; none where no direction leads to a corner."""
    there = np.isfinite(seen.ideal).all((1, 2))
    seen = seen._replace(
        ideal=np.where(there[:, None, None], seen.ideal, 0.0),
        weight=seen.weight * there[:, None],
    )
    solved = np.zeros((len(there), 2, 2, 3))
    for k, both in enumerate(map(both_poses, seen.points_m, seen.ideal)):
        solved[k, : len(both)] = both
    turn, shift = rotation_from_rotvec(solved[:, :, 0]), solved[:, :, 1]
    ahead = _in_sight(turn, shift)
    # IPPE returns rubbish for a marker that faces the camera exactly: a start of its own
    facing = _facing_poses(seen.points_m, seen.ideal)
    rotation, translation = (np.repeat(a[:, None], 3, 1) for a in facing)
    rotation[:, :2][ahead], translation[:, :2][ahead] = turn[ahead], shift[ahead]
    poses = _two_best(_refined(rotation, translation, seen))
    # and rubbish for one turned about an axis of its own: the best one's twin is looked for,
    # the same but for depth, mirrored in its middle
    rotation, translation, _ = poses.take((slice(None), slice(1)))
    twin = _refined(_mirrored(rotation, translation), translation, seen)
    every = (np.concatenate(parts, 1) for parts in zip(poses, twin, strict=True))
    return _two_best(PlanarPoses(*every))


def _refined(rotation: ndarray, translation: ndarray, seen: Observed) -> PlanarPoses:
    """Of n prints k poses each, with an infinite error for one out of sight."""
    n, k, _ = translation.shape
    seen = seen.take(np.repeat(np.arange(n), k))
    rotation, translation, _ = refine_poses(
        rotation.reshape(-1, 3, 3), translation.reshape(-1, 3), seen, iterations=80
    )
    error = rms_px(residuals(rotation, translation, seen), seen.weight)
    error[~(_in_sight(rotation, translation) & seen.weight.any(1))] = np.inf
    poses = rotation, translation, error
    return PlanarPoses(*(a.reshape(n, k, *a.shape[1:]) for a in poses))


def _two_best(poses: PlanarPoses) -> PlanarPoses:
    """Of each print's the best, and the best of those that differ from it."""
    row = np.arange(len(poses.error_px))[:, None]
    rotation, translation, error = poses.take((row, poses.error_px.argsort(1)))
    # squared distance of two rotation matrices by that angle
    same = 8 * np.sin(_SAME_RAD / 2) ** 2
    away = ((rotation - rotation[:, :1]) ** 2).sum((2, 3))
    error[:, 1:][away[:, 1:] <= same] = np.inf
    return PlanarPoses(rotation, translation, error).take(
        (row, error.argsort(1)[:, :2])
    )
