"""A measured depth map as points with normals: what is flat is found among them.

Normals are those of the plane through the nearest neighbours (scipy's k-d tree), turned towards the camera. What they
miss tells the sensor's noise, which grows with the square of the distance (triangulation).
Source: S4 (point cloud, normals, k nearest neighbours). Cost: O(points x log points); points, not pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from arfx.core.camera import Camera
from arfx.core.numerics import divide

NEIGHBOURS = 24
MOST_POINTS = 14000
LEAST_NOISE_M = 1e-3  # no sensor is better, and rounding to millimetres alone is a third of it
JUMP = 0.05  # of the distance: neighbours farther apart in depth lie on another surface


@dataclass(frozen=True, eq=False)
class Cloud:
    """points, normals (n, 3) CAMERA axes, metres;  neighbours (n, k) int;  noise_m (n,) : standard deviation along the ray
    flat (n,) : share of the neighbours whose normal agrees;  spacing_m (n,) : of neighbouring points;  pixels (n, 2) x, y"""

    points: np.ndarray
    normals: np.ndarray
    neighbours: np.ndarray
    noise_m: np.ndarray
    flat: np.ndarray
    spacing_m: np.ndarray
    pixels: np.ndarray


def cloud_of(depth_m: np.ndarray, camera: Camera, most: int = MOST_POINTS) -> Cloud | None:
    """depth_m : (h, w) along the optical axis, not finite or <= 0 = not measured;  most : about so many points are taken,
    evenly over the picture. None where too little is measured to tell a plane."""
    with np.errstate(all="ignore"):
        known = np.isfinite(depth_m) & (depth_m > 0)
    h, w = depth_m.shape
    step = max(1, int(np.sqrt(known.sum() / max(most, 1))))
    y, x = np.mgrid[step // 2 : h : step, step // 2 : w : step]
    keep = known[y, x]
    if keep.sum() < 4 * NEIGHBOURS:
        return None
    pixels = np.stack([x[keep], y[keep]], -1).astype(float)
    at = camera.scaled_to(w, h)
    ray = at.directions(pixels)
    z = depth_m[y[keep], x[keep]].astype(float)
    points = ray * divide(z, ray[:, 2])[:, None]
    distance, index = cKDTree(points).query(points, NEIGHBOURS, workers=-1)
    near = points[index]
    same = np.abs(near[..., 2] - z[:, None, None][..., 0]) < JUMP * z[:, None]
    weight = same / np.maximum(same.sum(1, keepdims=True), 1)
    centred = near - (near * weight[..., None]).sum(1, keepdims=True)
    spread = np.einsum("nki,nkj,nk->nij", centred, centred, weight)
    value, axes = np.linalg.eigh(spread)
    normals = axes[..., 0]
    normals = np.where((normals * points).sum(1, keepdims=True) > 0, -normals, normals)
    misfit = np.sqrt(np.maximum(value[:, 0], 0))
    trusted = same.mean(1) > 0.9
    # what edges and clutter miss is no noise: the lower half of all
    rate = float(np.median(np.sort((misfit / z**2)[trusted])[: max(int(trusted.sum() * 0.6), 1)])) if trusted.any() else 0.0
    noise = np.maximum(1.5 * rate * z**2, LEAST_NOISE_M)
    agree = np.abs(np.einsum("ni,nki->nk", normals, normals[index])) > np.cos(np.radians(15))
    return Cloud(points, normals, index, noise, (agree & same).mean(1), distance[:, 1:5].mean(1), pixels)
