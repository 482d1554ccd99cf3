"""Sites on the model's surface: they move with it, whatever it does.

The surface is strewn with points once; a point's importance is the coarsest level of a nested grid in space at which it is
still its cell's first (docs/methods/watercolor.md#sites). Each picture takes those that the wanted density calls for, which is
higher where the surface is nearer than the marker. Cost: O(points) per set. Leaves out: which points other parts of the model
hide; they add cells where they lie."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log2
from typing import NamedTuple

import numba
import numpy as np

from arfx.core.numerics import EPS_DEPTH_M, normalise
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.watercolor.field import marker_depth_m, nearness_limits
from arfx.stages.watercolor.sites import FADE, STEPS, Sites

POINTS = 16000
_LEVELS = 9
_GRAZING = 0.2  # cosine to the viewer below which a point fades: it is about to turn away


@dataclass(frozen=True, eq=False)
class Surface:
    """points, normals (n, 3) WORLD, metres;  importance (n,) log2 of the cell size in metres up to which a point counts
    extent_m : largest side of the model;  max_cell_m (n,) : size of a cell from which nothing of a point is left"""

    points: np.ndarray
    normals: np.ndarray
    importance: np.ndarray
    extent_m: float

    @cached_property
    def max_cell_m(self) -> np.ndarray:
        return np.exp2(self.importance + 0.5 * FADE)


def sample_surface(scene: Scene, seed: int) -> Surface:
    vertices = scene.model_points_m
    faces, start = [], 0
    for part in scene.model.parts:
        faces.append(part.faces + start)
        start += len(part.vertices)
    corner = vertices[np.concatenate(faces)]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(across, axis=1)
    extent = float(max(np.ptp(vertices, axis=0).max(), 1e-6))
    if not area.sum() > 0:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), extent)
    rng = np.random.default_rng([seed, 0x0B1E])
    at = np.searchsorted(np.cumsum(area) / area.sum(), rng.random(POINTS)).clip(0, len(area) - 1)
    s, t = rng.random((2, POINTS))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    points = (
        corner[at, 0]
        + s[:, None] * (corner[at, 1] - corner[at, 0])
        + t[:, None] * (corner[at, 2] - corner[at, 0])
    )
    return Surface(points, normalise(across[at]), _importance(points, extent), extent)


def _importance(points: np.ndarray, extent: float) -> np.ndarray:
    """log2 metres. The lowest number in a cell is its first; it is the first of one of the cell's parts as well."""
    finest = np.log2(extent) - _LEVELS + 1
    out = np.full(len(points), finest - 1.0)
    first = np.arange(len(points))
    low = points.min(0) - 0.137 * extent
    for level in range(_LEVELS + 1):
        cell = np.floor((points[first] - low) / 2.0 ** (finest + level)).astype(np.int64)
        _, inverse = np.unique(cell, axis=0, return_inverse=True)
        inverse = inverse.ravel()
        order = np.lexsort((first, inverse))
        begins = np.flatnonzero(np.r_[True, np.diff(inverse[order]) != 0])
        count = np.diff(np.r_[begins, len(order)])
        rank = np.arange(len(order)) - np.repeat(begins, count)
        # of k parts that hold a point, the one of rank r appears where the cell should hold r + 1/2 of them
        parts = np.repeat(np.maximum(count, 2), count)
        out[first[order]] = finest + level - np.log(rank + 0.5 + 0.5 * (rank == 0)) / np.log(parts)
        first = np.sort(first[order[begins]])
    out[first] = np.inf
    return out


class _CellSize(NamedTuple):
    """Size of a cell at a depth; log2 of metres and of ratios. at_marker : at 1 m, where all is as near as the marker
    marker : depth of the marker;  strength : of `nearer_finer`;  least, most : nearness that counts"""

    at_marker: float
    marker: float
    strength: float
    least: float
    most: float


def object_sites(
    surface: Surface,
    scene: Scene,
    camera_from_world: Pose,
    cell_px: float,
    flow_px: float,
    nearer_finer: float,
) -> tuple[Sites, np.ndarray]:
    """(sites of the points that face the camera, at about one per cell; (points,) float32 size of the cell of each, px).

    cell_px : where the surface is as far as the marker;  a site's key is its point. Places u, v are in px at which the model
    is four wavelengths of the flow wide, whatever its size in the picture."""
    camera, row, at = (
        scene.camera,
        camera_from_world.rotation[2],
        float(camera_from_world.translation_m[2]),
    )
    eye = camera_from_world.inverse().translation_m
    least, most = nearness_limits(nearer_finer) if nearer_finer > 0 else (1.0, 1.0)
    marker_m = marker_depth_m(camera_from_world @ scene.world_from_anchor)
    wanted = _CellSize(
        log2(cell_px / camera.fx), log2(marker_m), float(nearer_finer), log2(least), log2(most)
    )
    points = surface.points, surface.normals, surface.importance, surface.max_cell_m
    keep, fade, factor = _visible(*points, eye, row, at, wanted)
    pixel = camera.project(camera_from_world.apply(surface.points[keep]))
    size = np.zeros(len(surface.points), np.float32)
    size[keep] = cell_px * factor
    grown = (1.2 * STEPS * cell_px * factor) ** 2
    return Sites(
        *_sites(surface.points, keep, fade, pixel, grown, 4 * flow_px / surface.extent_m)
    ), size


@numba.njit(cache=True, nogil=True)
def _sites(points, keep, fade, pixel, grown, scale):  # pragma: no cover - compiled
    """As Sites holds them, without those that are not in the picture's plane."""
    n, k = keep.shape[0], 0
    x, y, weight = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    key, u, v = np.empty(n, np.int64), np.empty(n, np.float32), np.empty(n, np.float32)
    for m in range(n):
        px, py = pixel[m, 0], pixel[m, 1]
        if not (np.isfinite(px) and np.isfinite(py)):
            continue
        x[k], y[k] = (
            np.rint(min(max(px, -1e5), 1e5) * STEPS),
            np.rint(min(max(py, -1e5), 1e5) * STEPS),
        )
        weight[k], key[k] = -np.rint((1 - fade[m]) * grown[m]), keep[m]
        qx, qy, qz = (
            points[keep[m], 0] * scale,
            points[keep[m], 1] * scale,
            points[keep[m], 2] * scale,
        )
        u[k], v[k] = qx + 0.6 * qz, qy + 0.4 * qz
        k += 1
    return x[:k], y[:k], weight[:k], key[:k], u[:k], v[:k]


@numba.njit(cache=True, nogil=True)
def _visible(
    points, normals, importance, max_cell, eye, row, at, wanted: _CellSize
):  # pragma: no cover - compiled
    """(which points face the camera and count at this density (k,), how far each has appeared (k,), 0..1], factor on the size
    of its cell (k,)).

    max_cell : of Surface.max_cell_m;  row . point + at : depth, metres"""
    n = points.shape[0]
    which, fade, factor = np.empty(n, np.int64), np.empty(n), np.empty(n)
    finest = 2.0 ** (wanted.at_marker - wanted.strength * wanted.most)
    k = 0
    for m in range(n):
        depth = points[m, 0] * row[0] + points[m, 1] * row[1] + points[m, 2] * row[2] + at
        if depth * finest >= max_cell[m]:  # has not begun to appear, whatever the size
            continue
        x, y, z = eye[0] - points[m, 0], eye[1] - points[m, 1], eye[2] - points[m, 2]
        facing = x * normals[m, 0] + y * normals[m, 1] + z * normals[m, 2]
        if not (depth > EPS_DEPTH_M and facing > 0):
            continue
        level = np.log2(depth)
        larger = -wanted.strength * min(max(wanted.marker - level, wanted.least), wanted.most)
        grown = (importance[m] - (level + wanted.at_marker + larger)) / FADE + 0.5
        turned = (
            facing / np.sqrt(x * x + y * y + z * z) / _GRAZING
        )  # facing > 0: the distance is not 0
        if grown > 0:
            which[k], fade[k], factor[k] = m, min(grown, 1.0) * min(turned, 1.0), 2.0**larger
            k += 1
    return which[:k].copy(), fade[:k].copy(), factor[:k].copy()
