"""Viewing directions of a camera as a table: the lens is solved at every GRID_PX-th pixel,
and linear between.
"""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.core.rect import Rect

GRID_PX = 8  # pitch of the table: error below 1e-3 px for usual lenses


def direction_grid(camera: Camera, pixel: int = 1) -> np.ndarray:
    """(gh, gw, 3) float64 viewing directions, z = 1, at every GRID_PX-th pixel, one step
    beyond the picture.

    pixel : side, px, of the squares that count as pixels"""
    x, y = (
        pixel * np.arange(0, -(-n // pixel) + GRID_PX, GRID_PX) + (pixel - 1) / 2
        for n in (camera.width, camera.height)
    )
    return camera.directions(np.stack(np.meshgrid(x, y), -1))


def seen_rect(camera: Camera, points: np.ndarray, pad_px: float) -> Rect:
    """Pixels that hold points (n, 3), CAMERA axes, and around them; the whole frame where
    some are not before the camera.
    """
    seen = camera.project(points)
    return Rect.around(seen, pad_px) if np.isfinite(seen).all() else camera.rect


def viewing(grid: np.ndarray, rect: Rect) -> np.ndarray:
    """(h, w, 3) float32 of the pixels of `rect`, linear between the entries of a table (gh,
    gw, 3) as `direction_grid` makes it.

    The same for a pixel whatever the rectangle."""
    x, y = np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1)
    i, j = x // GRID_PX, y // GRID_PX
    fx, fy = (
        (x % GRID_PX / GRID_PX)[None, :, None],
        (y % GRID_PX / GRID_PX)[:, None, None],
    )
    top = grid[j[:, None], i] * (1 - fx) + grid[j[:, None], i + 1] * fx
    bottom = grid[j[:, None] + 1, i] * (1 - fx) + grid[j[:, None] + 1, i + 1] * fx
    return np.ascontiguousarray(top * (1 - fy) + bottom * fy, np.float32)
