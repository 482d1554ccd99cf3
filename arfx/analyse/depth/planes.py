"""Planes of the real scene in a measured depth map: several, robust, each with what its
points miss of it (sequential RANSAC).

Thresholds are multiples of the cloud's own noise. Deterministic. Planes of several maps are
brought together in one frame; what was seen of one is a mask: its points moved onto it, in
cells, the rim smoothed, small holes closed.
Source: docs/methods/calibration.md#planes.
Cost: O(points x log points), and O(hypotheses x points) per plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane

NEIGHBOURS = 24
MOST_POINTS = 14000  # about so many are taken, evenly over the picture
LEAST_NOISE_M = (
    1e-3  # no sensor is better, and rounding to millimetres alone is a third of it
)
JUMP = 0.05  # of the distance: neighbours farther apart in depth lie on another surface
MOST_PLANES = 6
HYPOTHESES = 120
SCORED = 2500  # points that hypotheses are judged by
LEAST_FRACTION = 0.03  # of all points: less is furniture
NEAR = 3.0  # noises: on the plane
TAKEN = 5.0  # noises: no seed of another plane
FACING = np.cos(np.radians(30))  # a point's normal agrees with the plane's
FLAT = 0.6  # share of agreeing neighbours with which a point may be a seed
PART = (
    0.1  # of the largest connected part: a smaller one is something else at the same height
)
MOST_CELLS = 160  # along the longer side
CLOSED = 2.5  # cells: holes and gaps narrower than twice this are closed
_RIM = 1.5  # cells: standard deviation of the smoothing
SAME_DEG = 6.0  # planes of two maps are one if they lean less against each other
SAME_NOISES, SAME_M = 3.0, 0.015  # and lie so near each other at their middles
UPRIGHT = np.cos(np.radians(60))
BORDER = 0.05  # of the picture's size: what lies so near its border may go on beyond
RIM = (
    0.06  # of a plane's extent: points so near one of its sides tell whether it ends there
)
CUT = 0.15  # share of those on the picture's border from which on it was the picture that ended
LEAST_AREA_M2 = 0.02  # what nothing can stand on is no plane to stand on


@dataclass(frozen=True, eq=False)
class Cloud:
    """points, normals (n, 3) CAMERA axes, metres;  rays (n, 3) : unit, towards the points;
    neighbours (n, k) int
    noise_m (n,) : standard deviation along the ray
    flat (n,) : share of the neighbours whose normal agrees;  spacing_m (n,) : of
    neighbouring points;  pixels (n, 2) x, y
    """

    points: np.ndarray
    normals: np.ndarray
    rays: np.ndarray
    neighbours: np.ndarray
    noise_m: np.ndarray
    flat: np.ndarray
    spacing_m: np.ndarray
    pixels: np.ndarray


def cloud_of(depth_m: np.ndarray, camera: Camera) -> Cloud | None:
    """depth_m : (h, w) along the optical axis, not finite or <= 0 = not measured.

    None where too little is.
    """
    from scipy.spatial import (
        cKDTree,
    )  # 0.2 s with its kin, which a job without measured depth need not take

    known = np.isfinite(depth_m) & (depth_m > 0)
    h, w = depth_m.shape
    step = max(1, int(np.sqrt(known.sum() / MOST_POINTS)))
    y, x = np.mgrid[step // 2 : h : step, step // 2 : w : step]
    keep = known[y, x]
    if keep.sum() < 4 * NEIGHBOURS:
        return None
    pixels = np.stack([x[keep], y[keep]], -1).astype(float)
    at = camera.scaled_to(w, h)
    ray = at.directions(pixels)
    z = depth_m[y[keep], x[keep]].astype(float)
    points = ray * divide(z, ray[:, 2])[:, None]
    distance, index = cKDTree(points).query(points, NEIGHBOURS, workers=-1)
    near = points[index]
    same = np.abs(near[..., 2] - z[:, None]) < JUMP * z[:, None]
    weight = same / np.maximum(same.sum(1, keepdims=True), 1)
    centred = near - (near * weight[..., None]).sum(1, keepdims=True)
    spread = np.einsum("nki,nkj,nk->nij", centred, centred, weight)
    value, axes = np.linalg.eigh(spread)
    normals = axes[..., 0] * np.where(
        (axes[..., 0] * points).sum(1, keepdims=True) > 0, -1, 1
    )
    misfit = np.sqrt(np.maximum(value[:, 0], 0))
    trusted = same.mean(1) > 0.9
    # what edges and clutter miss is no noise: the lower half of all
    rate = (
        float(
            np.median(np.sort((misfit / z**2)[trusted])[: max(int(trusted.sum() * 0.6), 1)])
        )
        if trusted.any()
        else 0.0
    )
    noise = np.maximum(1.5 * rate * z**2, LEAST_NOISE_M)
    agree = np.abs(np.einsum("ni,nki->nk", normals, normals[index])) > np.cos(
        np.radians(15)
    )
    return Cloud(
        points,
        normals,
        normalise(points),
        index,
        noise,
        (agree & same).mean(1),
        distance[:, 1:5].mean(1),
        pixels,
    )


@dataclass(frozen=True, eq=False)
class FoundPlane:
    """normal (3,) unit, towards the camera; normal . x = offset_m, CAMERA axes;  inliers :
    indices into the cloud
    """

    normal: np.ndarray
    offset_m: float
    inliers: np.ndarray


def find_planes(cloud: Cloud) -> list[FoundPlane]:
    """The planes, that with the most points first; none where nothing is flat."""
    rng = np.random.default_rng(0)
    count = len(cloud.points)
    free = np.ones(count, bool)
    out: list[FoundPlane] = []
    while len(out) < MOST_PLANES:
        seeds = np.flatnonzero(free & (cloud.flat >= FLAT))
        if len(seeds) < LEAST_FRACTION * count:
            break
        chosen = rng.choice(seeds, min(HYPOTHESES, len(seeds)), replace=False)
        found = _refined(cloud, free, *_likeliest(cloud, free, chosen))
        if found is None:
            break
        normal, offset, rows = found
        free &= np.abs(cloud.points @ normal - offset) > TAKEN * cloud.noise_m
        free[rows] = False
        if len(rows) < LEAST_FRACTION * count:
            break
        out.append(FoundPlane(normal, offset, rows))
    return sorted(out, key=lambda p: -len(p.inliers))


def _fit(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """(normal towards the camera, offset) of the weighted least squares plane."""
    centre = divide((points * weight[:, None]).sum(0), weight.sum())
    d = points - centre
    normal = np.linalg.eigh(np.einsum("ni,nj,n->ij", d, d, weight))[1][:, 0]
    normal = -normal if normal @ centre > 0 else normal
    return normal, float(normal @ centre)


def _on(cloud: Cloud, rows: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Those of the points `rows` that lie on a plane."""
    points = cloud.points[rows]
    # noise is along the ray: what of it is across the plane
    slope = np.abs(cloud.rays[rows] @ normal)
    near = np.abs(points @ normal - offset) < NEAR * np.maximum(
        cloud.noise_m[rows] * slope, 5e-4
    )
    return np.asarray(rows[near & (np.abs(cloud.normals[rows] @ normal) > FACING)])


def _likeliest(
    cloud: Cloud, free: np.ndarray, seeds: np.ndarray
) -> tuple[np.ndarray, float]:
    """Of planes by the neighbours of the seeds that with the most points."""
    sparse = np.flatnonzero(free)
    sparse = sparse[:: max(1, len(sparse) // SCORED)]
    near = cloud.points[cloud.neighbours[seeds]]
    hypotheses = [_fit(points, np.ones(len(points))) for points in near]
    return max(hypotheses, key=lambda plane: len(_on(cloud, sparse, *plane)))


def _refined(
    cloud: Cloud, free: np.ndarray, normal: np.ndarray, offset: float
) -> tuple[np.ndarray, float, np.ndarray] | None:
    rows = np.zeros(0, int)
    for _ in range(12):
        rows = _connected(cloud, _on(cloud, np.flatnonzero(free), normal, offset))
        if len(rows) < 8:
            return None
        off = (cloud.points[rows] @ normal - offset) / (NEAR * cloud.noise_m[rows])
        biweight = np.clip(1 - off**2, 0, None) ** 2
        normal, offset = _fit(cloud.points[rows], biweight * cloud.noise_m[rows] ** -2)
    return normal, offset, rows


def _connected(cloud: Cloud, rows: np.ndarray) -> np.ndarray:
    """The largest connected part of these points, and those parts that are not much smaller."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(rows):
        return rows
    count, near = cloud.neighbours.shape
    ends = np.arange(0, count * near + 1, near)
    graph = csr_matrix((np.ones(ends[-1]), cloud.neighbours.ravel(), ends), (count, count))
    part = connected_components(graph[rows][:, rows], directed=False)[1]
    size = np.bincount(part)
    return np.asarray(rows[size[part] >= PART * size.max()])


@dataclass(frozen=True, eq=False)
class PlaneMask:
    """Cells of a plane, its own axes.

    mask (rows, columns) bool : what was seen;  low_m (2,) : x, y of the first cell's corner
    """

    mask: np.ndarray
    low_m: np.ndarray
    cell_m: float

    @property
    def area_m2(self) -> float:
        return float(self.mask.sum() * self.cell_m**2)

    @property
    def extent_m(self) -> np.ndarray:
        """(4,) x0, y0, x1, y1"""
        at = np.argwhere(self.mask)[:, ::-1]
        return np.tile(self.low_m, 2) + self.cell_m * np.append(at.min(0), at.max(0) + 1)

    @property
    def middle_m(self) -> np.ndarray:
        """(2,) the place nearest the cells' mean that is well inside: as far from the rim
        as 60 % of what any place is.
        """
        room = cv2.distanceTransform(np.pad(self.mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[
            1:-1, 1:-1
        ]
        inside = np.argwhere(room >= 0.6 * room.max())
        seen = np.argwhere(self.mask)
        at = inside[((inside - seen.mean(0)) ** 2).sum(1).argmin()]
        return np.asarray(self.low_m + (at[::-1] + 0.5) * self.cell_m)


def mask_of(positions_m: np.ndarray, spacing_m: np.ndarray) -> PlaneMask:
    """positions_m (n, 2) : points moved onto the plane, its axes;  spacing_m (n,) :
    distance of neighbouring points there
    """
    low, high = positions_m.min(0), positions_m.max(0)
    cell = max(
        float(np.quantile(spacing_m, 0.75)), float((high - low).max()) / MOST_CELLS, 1e-4
    )
    pad = int(np.ceil(CLOSED)) + 1
    x, y = ((positions_m - low) / cell).astype(int).T + pad
    count = np.zeros((y.max() + 1 + pad, x.max() + 1 + pad), np.uint8)
    count[y, x] = 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * pad - 1, 2 * pad - 1))
    mask = cv2.morphologyEx(count, cv2.MORPH_CLOSE, disc)
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _RIM) > 0.5
    return PlaneMask(smooth if smooth.any() else mask > 0, low - pad * cell, cell)


@dataclass(frozen=True, eq=False)
class ScenePlane:
    """A plane as found in one or several maps. points (n, 3), spacing_m (n,) : what lies on
    it, world;  up : world;
    cut (n,) bool : points next to the border of their picture;  right : of the picture,
    world, for its
    x axis;  noise_m : of the points"""

    normal: np.ndarray
    points: np.ndarray
    spacing_m: np.ndarray
    cut: np.ndarray
    right: np.ndarray
    noise_m: float
    frames: int

    @property
    def offset_m(self) -> float:
        return float(np.median(self.points @ self.normal))

    def real_plane(self) -> RealPlane:
        """About the middle of what was seen."""
        x = normalise(self.right - (self.right @ self.normal) * self.normal)
        axes = np.stack([x, np.cross(self.normal, x), self.normal], 1)
        positions = self.points @ axes
        seen = mask_of(positions[:, :2], self.spacing_m)
        height, middle = self.offset_m, seen.middle_m
        pose = Pose(axes, axes @ np.array([middle[0], middle[1], height]))
        residual_mm = 1e3 * float(np.sqrt(((positions[:, 2] - height) ** 2).mean()))
        x0, y0, x1, y1 = (seen.extent_m - np.tile(middle, 2)).tolist()
        return RealPlane(
            pose,
            (x0, y0, x1, y1),
            seen.area_m2,
            residual_mm,
            len(positions),
            self.frames,
            self._ends(positions[:, :2]),
        )

    def _ends(self, positions: np.ndarray) -> tuple[bool, bool, bool, bool]:
        """Of the sides x0, y0, x1, y1 of what was seen: whether the plane ends there.
        places (n, 2), plane axes
        """
        low, high = np.quantile(positions, (0.005, 0.995), 0)
        rim = RIM * (high - low)
        near = np.hstack([positions < low + rim, positions > high - rim]).T
        a, b, c, d = (bool(n.any()) and float(self.cut[n].mean()) < CUT for n in near)
        return a, b, c, d


def scene_planes(
    maps: Sequence[tuple[np.ndarray, Pose]], camera: Camera
) -> list[ScenePlane]:
    """maps : (depth (h, w) metres, 0 = unknown; camera_from_world) of some frames. Those
    seen most first.
    """
    out: list[ScenePlane] = []
    for depth, pose in maps:
        if (cloud := cloud_of(depth, camera)) is None:
            continue
        size, world_from_camera = np.array(depth.shape[1::-1]), pose.inverse()
        margin = BORDER * size.max()
        for found in find_planes(cloud):
            rows = found.inliers
            at = cloud.pixels[rows]
            cosine = np.abs(cloud.rays[rows] @ found.normal)
            plane = ScenePlane(
                world_from_camera.rotation @ found.normal,
                world_from_camera.apply(cloud.points[rows]),
                divide(cloud.spacing_m[rows], np.clip(cosine, 0.2, 1)),
                ((at < margin) | (at > size - 1 - margin)).any(1),
                world_from_camera.rotation[:, 0],
                float(np.median(cloud.noise_m[rows])),
                1,
            )
            _join(out, plane)
    return sorted(out, key=lambda p: -len(p.points))


def _join(planes: list[ScenePlane], new: ScenePlane) -> None:
    """Add `new`, or make it part of one that is already there."""
    for k, old in enumerate(planes):
        near = SAME_M + SAME_NOISES * max(old.noise_m, new.noise_m)
        gap = max(
            abs(float(a.points.mean(0) @ b.normal) - b.offset_m)
            for a, b in ((new, old), (old, new))
        )
        if old.normal @ new.normal > np.cos(np.radians(SAME_DEG)) and gap < near:
            points, spacing, cut = (
                np.concatenate([getattr(p, name) for p in (old, new)])
                for name in ("points", "spacing_m", "cut")
            )
            fraction = len(old.points) / len(points)
            normal = normalise(fraction * old.normal + (1 - fraction) * new.normal)
            noise_m = fraction * old.noise_m + (1 - fraction) * new.noise_m
            frames = old.frames + new.frames
            planes[k] = ScenePlane(normal, points, spacing, cut, old.right, noise_m, frames)
            return
    planes.append(new)


def facing_up(
    planes: Sequence[ScenePlane], camera_from_world: Sequence[Pose]
) -> list[ScenePlane]:
    """Those on which something can stand, the one seen most first."""
    up = normalise(-np.mean([p.rotation[1] for p in camera_from_world], 0))
    level = [p for p in planes if p.normal @ up > UPRIGHT]
    return [p for p in level if p.real_plane().area_m2 >= LEAST_AREA_M2]
