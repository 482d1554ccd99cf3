"""Both planar poses of each marker sighting.

A square seen from far looks nearly the same tilted one way or the other: IPPE (Collins & Bartoli, 2014) gives both
solutions in closed form; each is then refined to its own least-squares minimum in picture pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from arfx.analyse.geometry import Observed, refine_poses, residuals, rms_px, stack
from arfx.core.facts import Hypothesis
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose

_SAME_RAD = 5e-3  # two minima closer than this are one (a frontal marker): below any tilt noise seen


def both_poses(corners_m: np.ndarray, ideal: np.ndarray) -> list[Pose]:
    """IPPE's one or two solutions, best first.

    corners_m : (4, 3) of a square, order of MarkerSpec.corners_m;  ideal : (4, 2) normalised, without lens distortion
    """
    if not np.isfinite(ideal).all():
        return []
    count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
        np.ascontiguousarray(corners_m), np.ascontiguousarray(ideal)[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    poses = [Pose.from_rotvec(rvecs[k], tvecs[k]) for k in range(count)]
    return [p for p in poses if _in_sight(p.rotation, p.translation_m)]


def frontal_poses(corners_m: np.ndarray, ideal: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (n, 3, 3) and translation (n, 3) of markers that face against a direction, at the place, distance and roll
    of their pictures.

    corners_m : (n, 4, 3);  ideal : (n, 4, 2);  towards : (n, 3) camera coordinates, for instance the rays through their middles
    """
    side = corners_m[:, 1, 0] - corners_m[:, 0, 0]
    ray = np.concatenate([ideal.mean(1), np.ones((len(ideal), 1))], 1)
    across = (ideal[:, 1] - ideal[:, 0] + ideal[:, 2] - ideal[:, 3]) / 2
    out_of_print = -normalise(towards)
    right = np.concatenate([across, np.zeros((len(ideal), 1))], 1)
    right = normalise(right - out_of_print * (out_of_print * right).sum(1, keepdims=True))
    extent = np.linalg.norm(ideal - ideal[:, [1, 2, 3, 0]], axis=2).mean(1)
    rotation = np.stack([right, np.cross(out_of_print, right), out_of_print], -1)
    return rotation, ray * divide(side, extent, where_zero=1.0)[:, None]


def _in_sight(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(...) In front of the camera, printed side towards it."""
    towards = (rotation[..., 2] * translation).sum(-1)
    return np.isfinite(translation).all(-1) & (translation[..., 2] > 0) & (towards < 0)


def hypotheses(
    corners_m: Sequence[np.ndarray], ideal: np.ndarray, px_per_ideal: np.ndarray, sigma_px: np.ndarray
) -> list[tuple[Hypothesis, ...]]:
    """Refined hypotheses of n sightings, best first; none where no direction leads to a corner.

    corners_m : n times (4, 3);  ideal : (n, 4, 2);  px_per_ideal : (n, 4, 2, 2);  sigma_px : (n,)
    """
    out: list[tuple[Hypothesis, ...]] = [()] * len(corners_m)
    at = np.flatnonzero(np.isfinite(ideal).all((1, 2)))
    if not len(at):
        return out
    points, ideal, px_per_ideal = np.stack(corners_m)[at], ideal[at], px_per_ideal[at]
    owner, rotation, translation = _starts(points, ideal)
    seen = Observed(points[owner], ideal[owner], px_per_ideal[owner], np.repeat(sigma_px[at][owner, None] ** -2.0, 4, 1))
    rotation, translation, _ = refine_poses(rotation, translation, seen, iterations=80)
    error = rms_px(residuals(rotation, translation, seen), seen.weight)
    error[~(_in_sight(rotation, translation) & np.isfinite(error))] = np.inf
    apart = 8 * np.sin(_SAME_RAD / 2) ** 2  # squared distance of two rotation matrices by that angle
    order = np.lexsort((error, owner))
    for mine in np.split(order, np.flatnonzero(np.diff(owner[order])) + 1):
        found: list[int] = []
        for i in mine[np.isfinite(error[mine])]:
            if len(found) < 2 and all(((rotation[i] - rotation[f]) ** 2).sum() > apart for f in found):
                found.append(int(i))
        out[at[owner[mine[0]]]] = tuple(Hypothesis(Pose(rotation[i], translation[i]), float(error[i])) for i in found)
    return out


def _starts(points: np.ndarray, ideal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(owner (k,), rotation (k, 3, 3), translation (k, 3)) of poses to start from, points (n, 4, 3) and ideal (n, 4, 2)."""
    n = len(points)
    every = [(i, p) for i in range(n) for p in both_poses(points[i], ideal[i])]
    # IPPE returns rubbish for a marker that faces the camera, or is parallel to the picture, exactly: starts of their own
    ray = np.concatenate([ideal.mean(1), np.ones((n, 1))], 1)
    facing, parallel = (frontal_poses(points, ideal, d) for d in (ray, np.broadcast_to([0.0, 0.0, 1.0], (n, 3))))
    owner = np.concatenate([np.array([i for i, _ in every], int), np.arange(n), np.arange(n)])
    r, t = stack([p for _, p in every])
    return owner, np.concatenate([r, facing[0], parallel[0]]), np.concatenate([t, facing[1], parallel[1]])
