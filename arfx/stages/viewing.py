"""Viewing directions of a camera as a table: the lens is solved at every GRID_PX-th pixel,
and linear between.
"""

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.rect import Rect

GRID_PX = 8  # pitch of the table: error below 1e-3 px for usual lenses


def direction_grid(camera: Camera, pixel: int = 1) -> ndarray:
    """(gh, gw, 3) float64 viewing directions, z = 1, at every GRID_PX-th pixel, one step
    beyond the picture.

    pixel : side, px, of the squares that count as pixels"""
    x, y = (
        pixel * np.arange(0, -(-n // pixel) + GRID_PX, GRID_PX) + (pixel - 1) / 2
        for n in (camera.width, camera.height)
    )
    return camera.directions(np.stack(np.meshgrid(x, y), -1))


def seen_rect(camera: Camera, points: ndarray, pad_px: float) -> Rect:
    """Pixels that hold points (n, 3), CAMERA axes, and around them; the whole frame where
    some are not before the camera.
    """
    seen = camera.project(points)
    return Rect.around(seen, pad_px) if np.isfinite(seen).all() else camera.rect


def between_nodes(nodes: ndarray, rect: Rect) -> ndarray:
    """(h, w, ...) float32 of the pixels of `rect`, linear between nodes (gh, gw, ...) float32 at
    every GRID_PX-th pixel, up to 4 channels. The same for a pixel whatever the rectangle."""
    step = 1 / GRID_PX
    pixel_to_node = np.array([[step, 0, step * rect.x0], [0, step, step * rect.y0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = rect.width, rect.height
    return cv2.warpAffine(
        nodes, pixel_to_node, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
