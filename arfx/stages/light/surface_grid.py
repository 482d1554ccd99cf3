"""What is known at points of the object's surface, kept at the nodes of a grid and read at
its pixels.

Points and pixels meet the grid one cell off the surface, along their normal: so what is on
the two sides of a wall does not mix, nor what is on the two sides of an edge. A pixel reads
between eight nodes.
Cost: O(points) for new values, O(covered pixels) a frame. Source: irradiance volumes
(Greger et al. 1998).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.layers import packed
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.vectors import cell, placed, shifted, turned

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_FAR = 1e-4  # weight of a point for the nodes beyond its cell: they count where nothing is nearer


class SurfaceGrid:
    """points, normals (n, 3) : of the surface;  weights (n,) : of the points;  cells :
    along the largest side
    """

    def __init__(
        self, points: ndarray, normals: ndarray, weights: ndarray, cells: int
    ) -> None:
        low, high = points.min(0), points.max(0)
        self.pitch_m = max(float((high - low).max()) / cells, 1e-9)
        self.low_m = low - 3 * self.pitch_m
        x, y, z = np.ceil((high - self.low_m) / self.pitch_m).astype(int) + 4
        self.shape = int(z), int(y), int(x)
        self._spread = self._spreading(points, normals, weights)

    def nodes(self, values: ndarray) -> ndarray:
        """(z, y, x, c) float32: weighted means of the points' values (n, c) near each node."""
        kept = self._spread @ np.ascontiguousarray(values, np.float32)
        return np.ascontiguousarray(kept.reshape(*self.shape, -1), np.float32)

    def nearest(self, points: ndarray, normals: ndarray) -> ndarray:
        """(n,) number of the node that places (n, 3) of the surface are nearest to."""
        place = (points - self.low_m) / self.pitch_m + normals
        node = np.rint(place).astype(np.int64)
        return np.ravel_multi_index(node.T[::-1], self.shape, mode="clip")

    def read(
        self,
        nodes: ndarray,
        coverage: ndarray,
        normal: ndarray,
        position: ndarray,
        anchor_from_world: Pose,
    ) -> ndarray:
        """(h, w, c) float32 of pixels by their layers; 0 where nothing covers them."""
        turn = anchor_from_world.rotation
        shift = (anchor_from_world.translation_m - self.low_m) / self.pitch_m
        matrix = np.column_stack([turn / self.pitch_m, shift]).astype(np.float32, "C")
        out = np.zeros((*coverage.shape, nodes.shape[-1]), np.float32)
        layers = packed(coverage), packed(normal), packed(position)
        _read(out, *layers, nodes, matrix, np.ascontiguousarray(turn, np.float32))
        return out

    def _spreading(
        self, points: ndarray, normals: ndarray, weights: ndarray
    ) -> csr_array:
        """(nodes, points) float32 weights whose rows sum to 1, or to 0 far from the surface."""
        from scipy.sparse import csr_array, diags_array

        place = (points - self.low_m) / self.pitch_m + normals
        first = np.floor(place).astype(np.int64)
        rows, shares = [], []
        for corner in np.ndindex(4, 4, 4):
            node = first + np.array(corner) - 1
            near = np.clip(1 - np.abs(place - node), 0, None).prod(1)
            far = _FAR * np.exp(-((place - node) ** 2).sum(1))
            inside = ((node >= 0) & (node < self.shape[::-1])).all(1)
            rows.append(np.ravel_multi_index(node.T[::-1], self.shape, mode="clip"))
            shares.append(inside * weights * (near + far))
        columns = np.tile(np.arange(len(points)), 64)
        entries = np.concatenate(shares), (np.concatenate(rows), columns)
        table = csr_array(entries, shape=(int(np.prod(self.shape)), len(points)))
        scaled = diags_array(divide(1, table.sum(1))) @ table
        scaled.data[scaled.data < _FAR] = 0
        scaled.eliminate_zeros()
        return csr_array(scaled.astype(np.float32))


@line_kernel(fastmath=FAST, error_model="numpy")
def _read(
    out, coverage, normal, position, nodes, matrix, turn
):  # pragma: no cover - compiled
    """matrix (3, 4) : node of a WORLD place;  turn (3, 3) : of a normal"""
    nz, ny, nx, channels = nodes.shape
    flat, zero, one = nodes.reshape(-1, channels), np.float32(0), np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if coverage[y, x] <= zero:
                continue
            off = turned(turn, normal[y, x])
            u, v, w = shifted(placed(matrix, position[y, x]), one, off)
            (iu, fu), (iv, fv), (iw, fw) = cell(u, nx), cell(v, ny), cell(w, nz)
            a = np.uintp((iw * ny + iv) * nx + iu)
            behind = a + np.uintp(nx * ny)
            for c in range(channels):
                near = _between(flat, a, np.uintp(nx), c, fu, fv)
                far = _between(flat, behind, np.uintp(nx), c, fu, fv)
                out[y, x, c] = near + fw * (far - near)


@line_kernel(fastmath=FAST)
def _between(flat, first, row, channel, fu, fv):  # pragma: no cover - compiled
    """One channel between a node, the next one, and those one `row` on."""
    right, below = first + np.uintp(1), first + row
    across = below + np.uintp(1)
    low = flat[first, channel] + fu * (flat[right, channel] - flat[first, channel])
    high = flat[below, channel] + fu * (flat[across, channel] - flat[below, channel])
    return low + fv * (high - low)
