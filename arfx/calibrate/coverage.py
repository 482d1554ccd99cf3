"""What of the picture and of the board's tilts the views cover, and how far a projected point can be off where.

Source of the projection uncertainty: mrcal's documentation, "Projection uncertainty" (rotation-compensated, at infinity).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.calibrate.solve import Fit, Uncertainty, without_pose
from arfx.core.numerics import angle_between, arccos

CELLS = (8, 6)  # across, down: at 4:3 they are square
TILTED_DEG = 15.0  # a board tilted by less tells focal length from distance too weakly: its depth range is .27 of its size
GRID = (13, 9)  # where the projection uncertainty is looked at


@dataclass(frozen=True, eq=False)
class Coverage:
    """counts : (rows, columns) corners per cell of the picture; cells : share of the cells with a corner;
    radius : farthest corner from the picture's centre over half the diagonal; tilt_deg, azimuth_deg : (V,) of each view,
    the board's normal against the optical axis, and where its near edge points in the picture (0 right, 90 down);
    span_deg : largest angle between the normals of two views; directions : how many of the four quarter turns of azimuth
    hold a tilt above TILTED_DEG"""

    counts: np.ndarray
    cells: float
    radius: float
    tilt_deg: np.ndarray
    azimuth_deg: np.ndarray
    span_deg: float
    directions: int


def coverage(fitted: Fit) -> Coverage:
    """Coverage of the views that a fit rests on."""
    w, h = fitted.camera.width, fitted.camera.height
    points = np.concatenate([v.pixels for v in fitted.views])
    counts, _, _ = np.histogram2d(points[:, 1], points[:, 0], bins=(CELLS[1], CELLS[0]), range=((-0.5, h - 0.5), (-0.5, w - 0.5)))
    normals = np.array([board_normal(r) for r in fitted.rotations])
    tilt = np.degrees(arccos(-normals[:, 2]))
    # the normal leans away from the near edge, so the near edge lies on the opposite side
    azimuth = np.degrees(np.arctan2(-normals[:, 1], -normals[:, 0])) % 360
    span = max(float(np.degrees(angle_between(n[None], normals)).max()) for n in normals)
    quarters = {int(((a + 45) % 360) // 90) for a, t in zip(azimuth, tilt, strict=True) if t > TILTED_DEG}
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    radius = float(np.linalg.norm(points - centre, axis=1).max() / np.hypot(w / 2, h / 2))
    return Coverage(counts.astype(int), float((counts > 0).mean()), radius, tilt, azimuth, span, len(quarters))


def board_normal(rvec: np.ndarray) -> np.ndarray:
    """Unit normal of the board in camera coordinates, pointing towards the camera's side (z <= 0)."""
    normal = cv2.Rodrigues(np.asarray(rvec, float))[0][:, 2]
    return normal if normal[2] <= 0 else -normal


def grid_pixels(width: int, height: int) -> np.ndarray:
    """(n, 2) pixels spread over the picture, GRID of them, borders included."""
    x, y = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    return np.stack([x.ravel(), y.ravel()], -1)


def projection_jacobian(fitted: Fit) -> np.ndarray:
    """(2n, p) how each grid pixel's projection moves with the intrinsics, a turn of the camera taken out.

    A change of intrinsics that only turns the picture is no error for anyone who estimates the pose with them. Pixels that
    no direction maps to are left out.
    """
    rays = fitted.camera.directions(grid_pixels(fitted.camera.width, fitted.camera.height))
    rays = rays[np.isfinite(rays).all(-1)]
    j = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), fitted.camera.matrix, fitted.camera.distortion)[1]
    return without_pose(np.hstack([j[:, 6:10], j[:, [10 + i for i in fitted.model.free]]]), j[:, :3])


def projection_uncertainty_px(fitted: Fit, known: Uncertainty) -> np.ndarray:
    """(n,) one standard deviation of the projection at each grid pixel, px (root mean square of x and y)."""
    j = projection_jacobian(fitted)
    variance = np.einsum("np,pq,nq->n", j, known.covariance, j).reshape(-1, 2).sum(1) / 2
    return np.sqrt(np.maximum(variance, 0.0))
