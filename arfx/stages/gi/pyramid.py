"""Voxels, and coarser and coarser ones, for six directions of view; stored in bricks, so that memory grows with the surface.

Coarser voxels: for each axis direction the nearer child hides the farther one, then the four columns are averaged: a wall one
voxel thick stays opaque. Radiance is premultiplied by opacity. Source: docs/methods/gi.md#pyramid."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from arfx.stages.gi.cones import Bricks

BRICK = 4  # cells a side; a brick stores one more, so that values between cells need one brick
_SIDE = BRICK + 1
SAMPLES = _SIDE**3


@dataclass(frozen=True, eq=False)
class PyramidLevel:
    """One level's cells. cells (v, 3) int32;  children (v, 8) int32 into the level below, -1 = empty; level 0 has none"""

    n: int
    cells: np.ndarray
    children: np.ndarray


@dataclass(frozen=True, eq=False)
class Structure:
    """Where the voxels lie, at all levels; the same for every light.

    brick_of : int32, all levels' grids of bricks, -1 = empty
    meta (levels, 4) int64 : cells a side, bricks a side, first entry in brick_of, first float in the atlas
    floats : of the atlas"""

    layers: tuple[PyramidLevel, ...]
    brick_of: np.ndarray
    meta: np.ndarray
    floats: int


@numba.njit(cache=True, nogil=True)
def front_to_back(below, children, out):  # pragma: no cover - compiled
    """For each axis direction the nearer child hides the farther one; the mean of the four columns."""
    directed = below.shape[1] == 6
    one, quarter = np.float32(1), np.float32(0.25)
    for p in range(children.shape[0]):
        for d in range(6):
            axis, backward, source = d // 2, d % 2, d if directed else 0
            bit = 1 << axis
            u, v = 1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3)
            for column in range(4):
                base = (u if column & 1 else 0) + (v if column & 2 else 0)
                near = children[p, base + (bit if backward else 0)]
                far = children[p, base + (0 if backward else bit)]
                transmittance = one
                if near >= 0:
                    transmittance = one - below[near, source, 3]
                    for k in range(4):
                        out[p, d, k] += quarter * below[near, source, k]
                if far >= 0:
                    for k in range(4):
                        out[p, d, k] += quarter * transmittance * below[far, source, k]


def structure_of(cells: np.ndarray, n: int) -> Structure:
    """cells (v, 3) int of level 0;  n : voxels a side, a power of two. n levels need log2 n filter passes."""
    layers = [PyramidLevel(n, np.ascontiguousarray(cells, np.int32), np.zeros((0, 8), np.int32))]
    while layers[-1].n > 1:
        layers.append(_parent_level(layers[-1]))
    grids, meta, floats, start = [], [], 0, 0
    for k, layer in enumerate(layers):
        across = layer.n // BRICK + 1
        grid = np.full(across**3, -1, np.int32)
        _touch(layer.cells, across, grid)
        used = np.flatnonzero(grid == 0)
        grid[used] = np.arange(len(used), dtype=np.int32)
        meta.append([layer.n, across, start, floats])
        grids.append(grid)
        start += len(grid)
        floats += len(used) * SAMPLES * (4 if k == 0 else 24)
    return Structure(tuple(layers), np.concatenate(grids), np.array(meta, np.int64), floats)


def levels_of(structure: Structure, values: np.ndarray) -> list[np.ndarray]:
    """Values of every level: (v, 1, 4) of level 0 as given, then (v, 6, 4) by direction of travel +x, -x, +y, -y, +z, -z.

    values (v, 4) float32 : radiance times opacity, and opacity"""
    out = [np.ascontiguousarray(values, np.float32)[:, None, :]]
    for layer in structure.layers[1:]:
        out.append(np.zeros((len(layer.cells), 6, 4), np.float32))
        front_to_back(out[-2], layer.children, out[-1])
    return out


def atlas_of(structure: Structure, values: np.ndarray) -> Bricks:
    """The pyramid of `values` (v, 4), packed."""
    atlas = np.zeros(structure.floats, np.float32)
    for k, (layer, level_values) in enumerate(
        zip(structure.layers, levels_of(structure, values), strict=True)
    ):
        _, across, first, at = structure.meta[k]
        _pack(
            layer.cells,
            level_values,
            structure.brick_of[first : first + across**3],
            across,
            atlas[at:],
        )
    return Bricks(atlas, structure.brick_of, structure.meta)


def _parent_level(layer: PyramidLevel) -> PyramidLevel:
    half = layer.n // 2
    parent = layer.cells // 2
    key = (parent[:, 2].astype(np.int64) * half + parent[:, 1]) * half + parent[:, 0]
    keys, inverse = np.unique(key, return_inverse=True)
    slot = (layer.cells[:, 2] % 2) * 4 + (layer.cells[:, 1] % 2) * 2 + layer.cells[:, 0] % 2
    children = np.full((len(keys), 8), -1, np.int32)
    children[inverse.ravel(), slot] = np.arange(len(key), dtype=np.int32)
    cells = np.stack([keys % half, keys // half % half, keys // half**2], -1).astype(np.int32)
    return PyramidLevel(half, cells, children)


@numba.njit(cache=True, nogil=True)
def _touch(cells, across, grid):  # pragma: no cover - compiled
    """grid : 0 for every brick that holds one of the cells or borders on it from below. Sample g = cell + 1."""
    for i in range(cells.shape[0]):
        for corner in range(8):
            at, ok = 0, True
            for axis in range(2, -1, -1):
                g = cells[i, axis] + 1
                b = g // BRICK
                if corner >> axis & 1:
                    ok = ok and g % BRICK == 0
                    b -= 1
                at = at * across + b
            if ok:
                grid[at] = 0


@numba.njit(cache=True, nogil=True)
def _pack(cells, values, grid, across, atlas):  # pragma: no cover - compiled
    directions = values.shape[1]
    for i in range(cells.shape[0]):
        for corner in range(8):
            at, inside, ok = 0, 0, True
            for axis in range(2, -1, -1):
                g = cells[i, axis] + 1
                b, r = g // BRICK, g % BRICK
                if corner >> axis & 1:
                    ok = ok and r == 0
                    b, r = b - 1, BRICK
                at, inside = at * across + b, inside * _SIDE + r
            if ok:
                to = (grid[at] * SAMPLES + inside) * directions * 4
                for d in range(directions):
                    for k in range(4):
                        atlas[to + d * 4 + k] = values[i, d, k]
