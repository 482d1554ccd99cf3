"""Step 2 of Yao, Tao, Wu 2018, voxels: which voxels a scene's surfaces meet, how full they are, and
their normals.

Every triangle is cut into pieces smaller than half a voxel, and each piece counts in the voxel that
holds its centre, by its area: neither the order nor the size of triangles matters. How voxels are
filled is not printed.

Deviations. A part that is seen through is as opaque all over as where it lets the least light
pass."""

# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene

PIECE = np.float32(0.5)  # of a voxel: the longest edge of a piece
# A flat wall covers a voxel's face once, a slanted one that crosses a corner less: twice the area
# is opaque, so that slanted walls do not leak.
FULL = 2.0


class Volume(NamedTuple):
    """A cube of n^3 voxels. low_m : (x, y, z) of its lowest corner, anchor axes
    voxel_m : side of a voxel"""

    n: int
    low_m: ndarray | tuple[float, float, float]
    voxel_m: float


class Voxels(NamedTuple):
    """cells (v, 3) int64 x, y, z
    normal (v, 3) : unit, mean of the surface, anchor axes; 0 where two sides cancel
    opacity (v,) 0..1"""

    cells: ndarray
    normal: ndarray
    opacity: ndarray


def voxelise(volume: Volume, *scenes: Scene) -> Voxels:
    """Every part of the scenes' models within the volume. Triangles without area or not finite
    count for nothing."""
    sums = np.zeros((*[volume.n] * 3, 5), np.float32)
    for scene in scenes:
        placed = scene.world_from_anchor.inverse().matrix @ scene.world_from_model
        linear = placed[:3, :3]
        unscaled = linear / np.cbrt(abs(np.linalg.det(linear)))
        for part in scene.model.parts:
            metres = part.vertices @ linear.T + placed[:3, 3]
            vertices = ((metres - volume.low_m) / volume.voxel_m).astype(np.float32)
            normals = (part.normals @ unscaled.T).astype(np.float32)
            faces = part.faces[np.isfinite(vertices[part.faces]).all((1, 2))]
            corners = vertices[faces]
            edges = corners - np.roll(corners, 1, 1)
            longest = np.linalg.norm(edges, axis=-1).max(1, initial=0)
            cuts = (longest / PIECE).astype(int) + 1  # along an edge
            area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / 2
            add_pieces(
                corners, normals[faces], cuts, area, np.float32(part.opacity), sums
            )
    zyx = np.nonzero(sums[..., 0])
    held = sums[zyx].astype(float).T
    mean = divide(held[1:], held[0])
    opacity = np.minimum(FULL * held[0], 1) * np.clip(mean[3], 0, 1)
    normal = normalise(mean[:3].T)
    return Voxels(
        np.stack(zyx[::-1], -1), normal.astype(np.float32), opacity.astype(np.float32)
    )


@kernel()
def add_pieces(
    corners, normals, cuts, area, alpha, sums
):  # pragma: no cover - compiled
    """sums (n, n, n, 5), z first, += area of each piece of triangles (f, 3, 3), voxels, and the
    area times its normal and its opacity alpha."""
    n = sums.shape[0]
    for f in np.flatnonzero(area > 0):
        a, b, c = corners[f]
        cut = cuts[f]
        piece_area = area[f] / np.float32(cut * cut)
        for i in range(cut):
            for j in range(2 * (cut - i) - 1):
                # the centre of sub-triangle j of row i, as weights of the three corners
                third = np.float32(1.0 / 3.0) if j % 2 == 0 else np.float32(2.0 / 3.0)
                p = (np.float32(i) + third) / np.float32(cut)
                q = (np.float32(j // 2) + third) / np.float32(cut)
                w = np.float32(1) - p - q
                x = int(np.floor(a[0] * w + b[0] * p + c[0] * q))
                y = int(np.floor(a[1] * w + b[1] * p + c[1] * q))
                z = int(np.floor(a[2] * w + b[2] * p + c[2] * q))
                if min(x, y, z) < 0 or max(x, y, z) >= n:
                    continue
                to = sums[z, y, x]
                to[0] += piece_area
                for k in range(3):
                    corner = normals[f, :, k]
                    normal = corner[0] * w + corner[1] * p + corner[2] * q
                    to[1 + k] += piece_area * normal
                to[4] += piece_area * alpha
