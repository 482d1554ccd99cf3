"""Sites on the model's surface: they move with it, whatever it does.

The surface is strewn with points once; a point's importance is the coarsest level of a nested grid
in space at which it is still its cell's first (docs/methods/watercolor.md#sites). Each picture
takes those that the wanted density calls for, which is higher where the surface is nearer than the
marker. Cost: O(points) per set. Leaves out: which points other parts of the model hide; they add
cells where they lie."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.numerics import EPS_DEPTH_M, normalise, same_rows
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages.watercolor.field import marker_depth_m, nearness_limits
from arfx.stages.watercolor.pigment import FLOW_PX
from arfx.stages.watercolor.sites import FADE, STEPS, Sites

POINTS = 16000
_LEVELS = 9
_FAR_PX = 1e5  # where points lie that have no place in the picture's plane
_GRAZING = (
    0.2  # cosine to the viewer below which a point fades: it is about to turn away
)
# places on the surface, from space
_UNROLLED = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.4]])


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """points, normals (n, 3) WORLD, metres;  importance (n,) log2 of the cell size in metres up to
    which a point counts
    extent_m : largest side of the model"""

    points: ndarray
    normals: ndarray
    importance: ndarray
    extent_m: float


def sample_surface(scene: Scene, seed: int) -> SurfacePoints:
    mesh = scene.mesh_at(0.0)
    first, second, third = np.moveaxis(mesh.corners_m + mesh.centre_m, 1, 0)
    across = np.cross(second - first, third - first)
    area = np.linalg.norm(across, axis=1)
    extent = float(max(np.ptp(mesh.vertices, axis=0).max(), 1e-6))
    if not area.sum() > 0:
        return SurfacePoints(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), extent)
    rng = np.random.default_rng([seed, 0x0B1E])
    at = np.searchsorted(np.cumsum(area) / area.sum(), rng.random(POINTS))
    at = at.clip(0, len(area) - 1)
    s, t = rng.random((2, POINTS, 1))
    s, t = np.where(s + t > 1, (1 - s, 1 - t), (s, t))
    points = first[at] + s * (second - first)[at] + t * (third - first)[at]
    normals, importance = normalise(across[at]), _importance(points, extent)
    return SurfacePoints(points, normals, importance, extent)


def _importance(points: ndarray, extent: float) -> ndarray:
    """log2 metres. The lowest number in a cell is its first; it is the first of one of the cell's
    parts as well."""
    finest = np.log2(extent) - _LEVELS + 1
    out = np.full(len(points), finest - 1.0)
    first = np.arange(len(points))
    low = points.min(0) - 0.137 * extent
    for level in range(_LEVELS + 1):
        cell = np.floor((points[first] - low) / 2.0 ** (finest + level)).astype(
            np.int64
        )
        _, number = same_rows(cell)
        order, count = np.argsort(number, kind="stable"), np.bincount(number)
        begins = np.cumsum(count) - count
        rank = np.arange(len(order)) - np.repeat(begins, count)
        # of k parts that hold a point, the one of rank r appears where the cell should hold r + 1/2
        # of them
        parts = np.repeat(np.maximum(count, 2), count)
        later = np.log(rank + 0.5 + 0.5 * (rank == 0)) / np.log(parts)
        out[first[order]] = finest + level - later
        first = np.sort(first[order[begins]])
    out[first] = np.inf
    return out


def object_sites(
    surface: SurfacePoints,
    scene: Scene,
    camera_from_world: Pose,
    cell_px: float,
    nearer_finer: float,
) -> tuple[Sites, ndarray]:
    """(sites of the points that face the camera, at about one per cell; (points,) float32 size of
    the cell of each, px).

    cell_px : where the surface is as far as the marker;  a site's key is its point. Places u, v are
    in px at which the model is four wavelengths of the flow wide, whatever its size in the picture
    """
    camera = scene.camera
    eye = camera_from_world.inverse().translation_m
    seen = camera_from_world.apply(surface.points)
    towards = eye - surface.points
    facing = (towards * surface.normals).sum(1)
    keep = np.flatnonzero((seen[:, 2] > EPS_DEPTH_M) & (facing > 0))
    level = np.log2(seen[keep, 2])
    larger = np.zeros(len(keep))
    if nearer_finer > 0:
        least, most = np.log2(nearness_limits(nearer_finer))
        marker_m = marker_depth_m(camera_from_world @ scene.world_from_anchor)
        larger = -nearer_finer * np.clip(np.log2(marker_m) - level, least, most)
    # log2 of the size of a cell, metres
    wanted = level + np.log2(cell_px / camera.fx) + larger
    grown = (surface.importance[keep] - wanted) / FADE + 0.5
    grows = grown > 0
    keep, grown, factor = keep[grows], grown[grows], 2.0 ** larger[grows]
    turned = facing[keep] / np.linalg.norm(towards[keep], axis=-1) / _GRAZING
    pixel = camera.project(seen[keep])
    pixel = np.clip(np.where(np.isfinite(pixel), pixel, _FAR_PX), -_FAR_PX, _FAR_PX)
    x, y = np.rint(pixel * STEPS).T.astype(np.float32)
    size = np.zeros(len(surface.points), np.float32)
    size[keep] = cell_px * factor
    fade = np.minimum(grown, 1) * np.minimum(turned, 1)
    weight = -np.rint((1 - fade) * (1.2 * STEPS * cell_px * factor) ** 2)
    places = surface.points[keep] @ _UNROLLED * (4 * FLOW_PX / surface.extent_m)
    u, v = places.T.astype(np.float32)
    return Sites(x, y, weight.astype(np.float32), keep, u, v), size
