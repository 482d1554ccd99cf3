"""What was seen of a plane as a mesh: its points moved onto it, in cells, the rim smoothed, small holes closed.

Source: S4 (points moved onto the plane, mesh); the rim is the half level of the smoothed occupancy.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.numerics import divide

MOST_CELLS = 160  # along the longer side
CLOSED = 2.5  # cells: holes and gaps narrower than twice this are closed
_RIM = 1.5  # cells: standard deviation of the smoothing


@dataclass(frozen=True, eq=False)
class PlaneMesh:
    """Cells of a plane, its own axes. mask (rows, columns) bool : what was seen;  low_m (2,) : x, y of the first cell's corner"""

    mask: np.ndarray
    low_m: np.ndarray
    cell_m: float

    @property
    def area_m2(self) -> float:
        return float(self.mask.sum() * self.cell_m**2)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        rows, columns = np.flatnonzero(self.mask.any(1)), np.flatnonzero(self.mask.any(0))
        x, y = self.low_m[0] + columns[[0, -1]] * self.cell_m, self.low_m[1] + rows[[0, -1]] * self.cell_m
        return float(x[0]), float(y[0]), float(x[1] + self.cell_m), float(y[1] + self.cell_m)

    @property
    def middle_m(self) -> np.ndarray:
        """(2,) the place nearest the cells' mean that is well inside: as far from the rim as 60 % of what any place is."""
        room = cv2.distanceTransform(np.pad(self.mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        inside = np.argwhere(room >= 0.6 * room.max())
        seen = np.argwhere(self.mask)
        at = inside[((inside - seen.mean(0)) ** 2).sum(1).argmin()]
        return np.asarray(self.low_m + (at[::-1] + 0.5) * self.cell_m)

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """(vertices (v, 3) metres, plane axes, z = 0; faces (f, 3) int32, towards +z)."""
        columns = self.mask.shape[1]
        row, column = np.nonzero(self.mask)
        a = row * (columns + 1) + column
        b, c, d = a + 1, a + columns + 2, a + columns + 1
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
        used, index = np.unique(faces, return_inverse=True)
        y, x = np.divmod(used, columns + 1)
        vertices = np.stack([self.low_m[0] + x * self.cell_m, self.low_m[1] + y * self.cell_m, 0.0 * x], -1)
        return vertices, index.reshape(-1, 3).astype(np.int32)


def mesh_of(places_m: np.ndarray, spacing_m: np.ndarray) -> PlaneMesh:
    """places_m (n, 2) : points moved onto the plane, its axes;  spacing_m (n,) : distance of neighbouring points there"""
    low, high = places_m.min(0), places_m.max(0)
    cell = max(float(np.quantile(spacing_m, 0.75)), float((high - low).max()) / MOST_CELLS, 1e-4)
    pad = int(np.ceil(CLOSED)) + 1
    size = np.ceil((high - low) / cell).astype(int) + 1 + 2 * pad
    at = np.clip(((places_m - low) / cell).astype(int) + pad, 0, size - 1)
    count = np.zeros((size[1], size[0]), np.uint8)
    count[at[:, 1], at[:, 0]] = 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * pad - 1, 2 * pad - 1))
    mask = cv2.morphologyEx(count, cv2.MORPH_CLOSE, disc)
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _RIM) > 0.5
    if not smooth.any():
        smooth = mask > 0
    return PlaneMesh(smooth, low - pad * cell, cell)


def spacing_on(spacing_m: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Distance of neighbouring points along a plane that is seen under that cosine."""
    return np.asarray(divide(spacing_m, np.clip(cosine, 0.2, 1)))
