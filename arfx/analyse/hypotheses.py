"""Both planar poses of each marker sighting.

A square seen from far looks nearly the same tilted one way or the other: IPPE (Collins & Bartoli, 2014) gives both
solutions in closed form; each is then refined to its own least-squares minimum in picture pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from arfx.analyse.geometry import Observed, refine_poses, residuals, rms_px
from arfx.core.facts import Hypothesis
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose, rotation_angle_rad

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
    return [p for p in poses if _in_sight(p)]


def frontal_pose(corners_m: np.ndarray, ideal: np.ndarray, towards: np.ndarray) -> Pose:
    """The marker facing against a direction, at the place, distance and roll of its picture.

    towards : (3,) camera coordinates, for instance the ray through its middle;  the rest as for both_poses
    """
    side = corners_m[1, 0] - corners_m[0, 0]
    ray = np.append(ideal.mean(0), 1.0)
    across = (ideal[1] - ideal[0] + ideal[2] - ideal[3]) / 2
    out_of_print = -normalise(towards)
    right = np.append(across, 0.0)
    right = normalise(right - out_of_print * (out_of_print @ right))
    extent = np.linalg.norm(ideal - np.roll(ideal, -1, 0), axis=1).mean()
    rotation = np.stack([right, np.cross(out_of_print, right), out_of_print], -1)
    return Pose(rotation, ray * float(divide(side, extent, where_zero=1.0)))


def _in_sight(pose: Pose) -> bool:
    """In front of the camera, printed side towards it."""
    t = pose.translation_m
    return bool(np.isfinite(t).all() and t[2] > 0 and pose.rotation[:, 2] @ t < 0)


def hypotheses(
    corners_m: Sequence[np.ndarray], ideal: np.ndarray, px_per_ideal: np.ndarray, sigma_px: np.ndarray
) -> list[tuple[Hypothesis, ...]]:
    """Refined hypotheses of n sightings, best first; none where no direction leads to a corner.

    corners_m : n times (4, 3);  ideal : (n, 4, 2);  px_per_ideal : (n, 4, 2, 2);  sigma_px : (n,)
    """
    owner: list[int] = []
    start: list[Pose] = []
    for k, points in enumerate(corners_m):
        if not np.isfinite(ideal[k]).all():
            continue
        # IPPE returns rubbish for a marker that faces the camera, or is parallel to the picture, exactly: starts of their own
        faces = (np.append(ideal[k].mean(0), 1.0), np.array([0.0, 0.0, 1.0]))
        for pose in (*both_poses(points, ideal[k]), *(frontal_pose(points, ideal[k], d) for d in faces)):
            owner.append(k)
            start.append(pose)
    out: list[tuple[Hypothesis, ...]] = [()] * len(corners_m)
    if not start:
        return out
    index = np.array(owner)
    seen = Observed(
        np.stack([corners_m[k] for k in owner]), ideal[index], px_per_ideal[index],
        np.repeat(sigma_px[index, None] ** -2.0, 4, 1),
    )  # fmt: skip
    rotation = np.stack([p.rotation for p in start])
    translation = np.stack([p.translation_m for p in start])
    rotation, translation, _ = refine_poses(rotation, translation, seen, iterations=80)
    error = rms_px(residuals(rotation, translation, seen), seen.weight)
    for k in range(len(corners_m)):
        mine = sorted(np.flatnonzero(index == k), key=lambda i: error[i])
        found: list[Hypothesis] = []
        for i in mine:
            pose = Pose(rotation[i], translation[i])
            if (
                len(found) < 2
                and _in_sight(pose)
                and all(rotation_angle_rad(pose, h.camera_from_marker) > _SAME_RAD for h in found)
            ):
                found.append(Hypothesis(pose, float(error[i])))
        out[k] = tuple(found)
    return out
