"""Step 2 of Yao, Tao, Wu 2018, volumes: V_eta of normals, in a sparse octree that stores no empty
voxel.

A node has the number of its first child and a mask of the children that are there; those lie one
behind the other. Nodes of a level follow each other, the root first. What is stored in a volume is
a row for each node; all volumes share one octree.

V_eta : normal times opacity, and opacity. V_rho, V_mu, V_delta (s4_shadow_maps.py) : radiance times
opacity."""

# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.scene import Scene
from arfx.papers.s4_voxels import Volume, voxelise
from arfx.stages.light.planes import bounding_ball

# Radii of the object to each side of its middle: where its shadow and its bounced light fall
MARGIN = 2.0
POINTER_BYTES = 5  # of a node: first child and mask
_BITS = np.array([bin(mask).count("1") for mask in range(256)], np.int32)


class Octree(NamedTuple):
    """first () int32 : first child, mask () uint8 : which of the eight children are there, bit
    4 z + 2 y + x, of the nodes over the lowest level;  eta (nodes, 4) float32 : V_eta
    depth : levels under the root"""

    first: ndarray
    mask: ndarray
    eta: ndarray
    depth: int


class Volumes(NamedTuple):
    """The voxelised scene. volume : its cube;  tree;  codes (leaves,) int64 : of the lowest level's
    voxels, sorted
    starts : of every level over the lowest, first child of each node, counted within the level
    below"""

    volume: Volume
    tree: Octree
    codes: ndarray
    starts: list[ndarray]

    def in_voxels(self, positions_m: ndarray) -> ndarray:
        """(n, 3), voxels of the lowest level from the cube's corner, of positions (n, 3), metres,
        anchor axes."""
        return (positions_m - self.volume.low_m) / self.volume.voxel_m

    def leaf_of(self, positions_m: ndarray) -> ndarray:
        """(n,) leaf that holds each position (n, 3), metres, anchor axes; -1 where nothing is
        stored."""
        cells = np.floor(self.in_voxels(positions_m))
        inside = ((cells >= 0) & (cells < self.volume.n)).all(-1)
        code = morton(np.where(inside[:, None], cells, 0).astype(int))
        at = np.minimum(np.searchsorted(self.codes, code), len(self.codes) - 1)
        return np.where(inside & (self.codes[at] == code), at, -1)

    def filtered(self, leaves: ndarray) -> ndarray:
        """As `step2_mean`."""
        return step2_mean(leaves, self.starts)

    def rows_of(self, level: int) -> slice:
        """Nodes of a level, 0 = lowest, in the order of their codes."""
        count = [len(self.codes), *map(len, self.starts)]
        first = sum(count[level + 1 :])
        return slice(first, first + count[level])

    def memory_bytes(self, channels: int) -> tuple[int, int]:
        """Of one volume of that many float32 channels with its pyramid: in the octree, pointers
        counted too, and dense."""
        dense = sum(8**level for level in range(self.tree.depth + 1)) * 4 * channels
        return len(self.tree.eta) * (POINTER_BYTES + 4 * channels), dense


def step2_mean(
    leaves: ndarray, starts: list[ndarray], stored: bool = False
) -> ndarray:
    """(nodes, c) float32 of values (leaves, c): n levels take n - 1 steps, from the lowest upwards.

    A voxel is the mean of its eight children, of which the missing ones are empty. Through a wall
    one voxel thick 1 - 2^-L of the light leaks at level L. stored : the mean of those children that
    are there: no light leaks, but every surface grows with the level
    starts : of `Volumes`"""
    levels: list[ndarray] = [leaves.astype(np.float32)]
    for start in starts:
        below = levels[-1]
        children = np.diff(start, append=len(below))[:, None] if stored else 8
        levels.append(np.add.reduceat(below, start) / np.float32(children))
    return np.concatenate(levels[::-1])


def step2_volumes(real: Scene, scene: Scene, n: int) -> Volumes:
    """V_eta of the real scene and of the scene with the object, which is in the middle. n : voxels
    a side"""
    volume = cube_around(scene, n)
    return octree_of(volume, *voxelise(volume, real, scene))


def cube_around(scene: Scene, n: int) -> Volume:
    """The smallest cube with one empty voxel around the object and the plane under it, MARGIN
    radii to each side. Borders of voxels lie on z = 0, where the plane is."""
    points = scene.world_from_anchor.inverse().apply(scene.model_points_m)
    z = points[np.isfinite(points).all(1), 2]
    centre, radius = bounding_ball(scene)
    low = np.append(centre[:2] - MARGIN * radius, min(z.min(), 0))
    high = np.append(centre[:2] + MARGIN * radius, max(z.max(), 0))
    voxel_m = float((high - low).max()) / (n - 3)
    corner = (low + high) / 2 - voxel_m * n / 2
    # what stands on the plane fills the voxels over it: not by rounding those under it
    corner[2] = (np.floor(low[2] / voxel_m - 1 + 1e-3) - 1e-3) * voxel_m
    return Volume(n, corner, voxel_m)


def octree_of(
    volume: Volume,
    cells: ndarray,
    normal: ndarray,
    opacity: ndarray,
    stored: bool = False,
) -> Volumes:
    """cells (v, 3) int;  normal (v, 3);  opacity (v,);  stored : of `step2_mean`"""
    code = morton(cells)
    order = np.argsort(code)
    codes = [code[order]]
    starts: list[ndarray] = []
    masks = []
    while len(starts) < int(np.log2(volume.n)):
        above, start = np.unique(codes[-1] >> 3, return_index=True)
        masks.append(np.add.reduceat(1 << (codes[-1] & 7), start))
        codes.append(above)
        starts.append(start)
    # children lie behind all nodes of the levels over theirs
    before = np.cumsum([len(level) for level in codes[:0:-1]])
    first = [k + start for k, start in zip(before, starts[::-1], strict=True)]
    leaves = np.column_stack([normal * opacity[:, None], opacity])[order]
    tree = Octree(
        np.concatenate(first).astype(np.int32),
        np.concatenate(masks[::-1]).astype(np.uint8),
        step2_mean(leaves, starts, stored),
        len(starts),
    )
    return Volumes(volume, tree, codes[0], starts)


def morton(cells: ndarray) -> ndarray:
    """(n,) codes of cells (n, 3) x, y, z: their bits interleaved, those of z first, so that >> 3 is
    the parent's."""
    out = np.zeros(len(cells), np.int64)
    for bit in range(10):
        for axis in range(3):
            out |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return out


@kernel()
def node_below(tree: Octree, node, bits, x, y, z):  # pragma: no cover - compiled
    """Voxel x, y, z, `bits` levels under a node that holds it; -1 where nothing is stored. The root
    is node 0."""
    for b in range(bits - 1, -1, -1):
        child = ((z >> b & 1) << 2) | ((y >> b & 1) << 1) | (x >> b & 1)
        mask = int(tree.mask[node])
        if not mask >> child & 1:
            return -1
        node = (
            tree.first[node] + _BITS[mask & ((1 << child) - 1)]
        )  # those in front of it
    return node
