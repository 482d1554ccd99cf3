"""Viewing directions of a camera as a table: the lens is solved at every GRID_PX-th pixel, and linear between."""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera

GRID_PX = 8  # pitch of the table: error below 1e-3 px for usual lenses


def direction_grid(camera: Camera) -> np.ndarray:
    """(gh, gw, 3) float64 viewing directions, z = 1, at every GRID_PX-th pixel, one step beyond the picture."""
    x = np.arange(0, camera.width + GRID_PX, GRID_PX)
    y = np.arange(0, camera.height + GRID_PX, GRID_PX)
    return camera.directions(np.stack(np.meshgrid(x, y), -1).astype(float))
