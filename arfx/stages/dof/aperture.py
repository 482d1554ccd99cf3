"""What one blur circle looks like on the pixel grid: a disc, or an n-blade polygon of the same
area."""

from functools import lru_cache

import numpy as np
from numpy import ndarray

SHARP_PX = 0.5  # a disc of this radius lies within its own pixel
_SUBROWS = 16  # lines of a pixel by which the area of a shape in it is known


@lru_cache(maxsize=1024)
def disc(radius: float, blades: int = 0, turn_deg: float = 0.0) -> ndarray:
    """Fractions of a blur circle's light that pixels around its centre get.

    radius : px;  blades : 0 = round, else corners of the polygon, the first at turn_deg from x

    Returns (2 n + 1, 2 n + 1) float32, sum 1; one pixel where the radius is at most SHARP_PX.
    """
    if radius <= SHARP_PX:
        return np.ones((1, 1), np.float32)
    half = int(np.ceil(radius * circumradius(blades) - 0.5))
    px = np.arange(-half, half + 1.0)
    lines = px[:, None] + (np.arange(_SUBROWS) + 0.5) / _SUBROWS - 0.5
    left, right = chord(lines, radius, blades, turn_deg)
    within = np.minimum(right[..., None], px + 0.5) - np.maximum(
        left[..., None], px - 0.5
    )
    area = within.clip(0).mean(1)
    return (area / area.sum()).astype(np.float32)


def circumradius(blades: int) -> float:
    """Of a polygon whose area is that of a disc of radius 1."""
    if blades < 3:
        return 1.0
    return float(np.sqrt(2 * np.pi / (blades * np.sin(2 * np.pi / blades))))


def chord(
    y: ndarray, radius: float, blades: int, turn_deg: float
) -> tuple[ndarray, ndarray]:
    """Left and right end of the shape at heights y, px; left >= right where it does not reach."""
    if blades < 3:
        half = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        return -half, half
    corner_px = radius * circumradius(blades)
    middle = np.radians(turn_deg) + (np.arange(blades) + 0.5) * 2 * np.pi / blades
    apothem = corner_px * np.cos(np.pi / blades)
    left, right = np.full(y.shape, -2 * corner_px), np.full(y.shape, 2 * corner_px)
    # inside: nx x + ny y <= apothem
    for nx, ny in zip(np.cos(middle), np.sin(middle), strict=True):
        if abs(nx) < 1e-9:
            outside = ny * y > apothem
            left, right = np.where(outside, 0.0, left), np.where(outside, 0.0, right)
        elif nx > 0:
            right = np.minimum(right, (apothem - ny * y) / nx)
        else:
            left = np.maximum(left, (apothem - ny * y) / nx)
    return left, right
