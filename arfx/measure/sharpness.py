"""How sharp and how tilted a marker is in the picture, from its outline."""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import angle_between, divide, normalise

_PROFILES, _STEP_PX = 7, 0.25
_MIN_SIDE_PX = 24.0  # in smaller ones the profile leaves the border before the edge levels out
_MIN_CONTRAST = 20.0  # grey levels; below, the width of an edge is noise
_SQUARE = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])


def edge_blur_px(luma: np.ndarray, quad_px: np.ndarray) -> float | None:
    """Standard deviation in px of the blur of a marker's outer edges (black square on a lighter margin).

    luma : (h, w) uint8;  quad_px : (4, 2) corners, about 1 px accurate
    A Gaussian edge of contrast C and deviation s has its steepest slope C / (s sqrt(2 pi)); the median over profiles
    across all four sides is taken. A perfectly sharp, pixel-sampled edge gives about .4. None without usable profile.
    """
    side = float(np.linalg.norm(quad_px - np.roll(quad_px, -1, 0), axis=1).mean())
    if side < _MIN_SIDE_PX:
        return None
    half = max(3.0, side / 12)  # within the black border (at least a tenth of the side) and the white margin
    offsets = np.arange(-half, half + _STEP_PX / 2, _STEP_PX)
    centre = quad_px.mean(0)
    found = []
    for a, b in zip(quad_px, np.roll(quad_px, -1, 0), strict=True):
        along = normalise(b - a)
        normal = np.array([along[1], -along[0]])
        if normal @ ((a + b) / 2 - centre) < 0:
            normal = -normal
        for t in np.linspace(0.25, 0.75, _PROFILES):
            p = a + (b - a) * t + offsets[:, None] * normal
            if (p < 0).any() or (p[:, 0] > luma.shape[1] - 1).any() or (p[:, 1] > luma.shape[0] - 1).any():
                continue
            line = cv2.remap(luma, p[None, :, 0].astype(np.float32), p[None, :, 1].astype(np.float32), cv2.INTER_LINEAR)[0]
            line = line.astype(float)
            contrast = float(np.median(line[-4:]) - np.median(line[:4]))
            slope = float(np.abs(np.diff(line)).max()) / _STEP_PX
            if abs(contrast) >= _MIN_CONTRAST:
                found.append(float(divide(abs(contrast), slope * np.sqrt(2 * np.pi))))
    return float(np.median(found)) if len(found) >= _PROFILES else None


def tilt_deg(quad_px: np.ndarray, camera: Camera) -> float | None:
    """Angle in degrees between the marker's normal and the line of sight, of the better planar pose; None without one."""
    rays = camera.normalised(quad_px)
    if not np.isfinite(rays).all():
        return None
    count, rotations, shifts, _ = cv2.solvePnPGeneric(_SQUARE, rays[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    if not count:
        return None
    normal = cv2.Rodrigues(rotations[0])[0][:, 2]
    return float(np.degrees(angle_between(normal, -shifts[0].ravel())))
