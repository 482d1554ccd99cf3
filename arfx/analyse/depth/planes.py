"""Planes of the real scene in a measured depth map: several, robust, each with what its points miss of it (sequential RANSAC).

Thresholds are multiples of the cloud's own noise. Deterministic. Source: docs/methods/calibration.md#planes.
Cost: O(points x log points), and O(hypotheses x points) per plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from arfx.core.camera import Camera
from arfx.core.numerics import divide, normalise

NEIGHBOURS = 24
MOST_POINTS = 14000  # about so many are taken, evenly over the picture
LEAST_NOISE_M = 1e-3  # no sensor is better, and rounding to millimetres alone is a third of it
JUMP = 0.05  # of the distance: neighbours farther apart in depth lie on another surface
MOST_PLANES = 6
HYPOTHESES = 120
SCORED = 2500  # points that hypotheses are judged by
LEAST_SHARE = 0.03  # of all points: less is furniture
NEAR = 3.0  # noises: on the plane
TAKEN = 5.0  # noises: no seed of another plane
FACING = np.cos(np.radians(30))  # a point's normal agrees with the plane's
FLAT = 0.6  # share of agreeing neighbours with which a point may be a seed
PART = 0.1  # of the largest connected part: a smaller one is something else at the same height


@dataclass(frozen=True, eq=False)
class Cloud:
    """points, normals (n, 3) CAMERA axes, metres;  neighbours (n, k) int;  noise_m (n,) : standard deviation along the ray
    flat (n,) : share of the neighbours whose normal agrees;  spacing_m (n,) : of neighbouring points;  pixels (n, 2) x, y"""

    points: np.ndarray
    normals: np.ndarray
    neighbours: np.ndarray
    noise_m: np.ndarray
    flat: np.ndarray
    spacing_m: np.ndarray
    pixels: np.ndarray


def cloud_of(depth_m: np.ndarray, camera: Camera) -> Cloud | None:
    """depth_m : (h, w) along the optical axis, not finite or <= 0 = not measured. None where too little is."""
    with np.errstate(all="ignore"):
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
    same = np.abs(near[..., 2] - z[:, None, None][..., 0]) < JUMP * z[:, None]
    weight = same / np.maximum(same.sum(1, keepdims=True), 1)
    centred = near - (near * weight[..., None]).sum(1, keepdims=True)
    spread = np.einsum("nki,nkj,nk->nij", centred, centred, weight)
    value, axes = np.linalg.eigh(spread)
    normals = axes[..., 0]
    normals = np.where((normals * points).sum(1, keepdims=True) > 0, -normals, normals)
    misfit = np.sqrt(np.maximum(value[:, 0], 0))
    trusted = same.mean(1) > 0.9
    # what edges and clutter miss is no noise: the lower half of all
    rate = float(np.median(np.sort((misfit / z**2)[trusted])[: max(int(trusted.sum() * 0.6), 1)])) if trusted.any() else 0.0
    noise = np.maximum(1.5 * rate * z**2, LEAST_NOISE_M)
    agree = np.abs(np.einsum("ni,nki->nk", normals, normals[index])) > np.cos(np.radians(15))
    return Cloud(points, normals, index, noise, (agree & same).mean(1), distance[:, 1:5].mean(1), pixels)


@dataclass(frozen=True, eq=False)
class FoundPlane:
    """normal (3,) unit, towards the camera; normal . x = offset_m, CAMERA axes;  inliers : indices into the cloud"""

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
        if len(seeds) < LEAST_SHARE * count:
            break
        best = _best(cloud, free, rng.choice(seeds, min(HYPOTHESES, len(seeds)), replace=False))
        found = None if best is None else _refined(cloud, free, *best)
        if found is None:
            break
        normal, offset, rows = found
        free &= np.abs(cloud.points @ normal - offset) > TAKEN * cloud.noise_m
        free[rows] = False
        if len(rows) < LEAST_SHARE * count:
            break
        out.append(FoundPlane(normal, offset, rows))
    return sorted(out, key=lambda p: -len(p.inliers))


def _fit(points: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """(normal towards the camera, offset) of the weighted least squares plane."""
    centre = divide((points * weight[:, None]).sum(0), weight.sum())
    d = points - centre
    normal = np.linalg.eigh(np.einsum("ni,nj,n->ij", d, d, weight))[1][:, 0]
    if normal @ centre > 0:
        normal = -normal
    return normal, float(normal @ centre)


def _on(cloud: Cloud, rows: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Those of the points `rows` that lie on a plane."""
    points = cloud.points[rows]
    # noise is along the ray: what of it is across the plane
    slope = np.abs(normalise(points) @ normal)
    near = np.abs(points @ normal - offset) < NEAR * np.maximum(cloud.noise_m[rows] * slope, 5e-4)
    return np.asarray(rows[near & (np.abs(cloud.normals[rows] @ normal) > FACING)])


def _best(cloud: Cloud, free: np.ndarray, seeds: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The hypothesis with the most points; the best few are refitted to what lies on them before they are compared."""
    scored = []
    some = np.flatnonzero(free)
    some = some[:: max(1, len(some) // SCORED)]
    for s in seeds:
        rows = cloud.neighbours[s]
        normal, offset = _fit(cloud.points[rows], np.ones(len(rows)))
        scored.append((len(_on(cloud, some, normal, offset)), normal, offset))
    scored.sort(key=lambda c: -c[0])
    best: tuple[int, np.ndarray, float] | None = None
    for _, normal, offset in scored[:8]:
        for _ in range(3):
            rows = _on(cloud, some, normal, offset)
            if len(rows) < 8:
                break
            normal, offset = _fit(cloud.points[rows], cloud.noise_m[rows] ** -2)
        n = len(_on(cloud, some, normal, offset))
        if best is None or n > best[0]:
            best = n, normal, offset
    return None if best is None or best[0] < 8 else best[1:]


def _refined(cloud: Cloud, free: np.ndarray, normal: np.ndarray, offset: float) -> tuple[np.ndarray, float, np.ndarray] | None:
    rows = np.zeros(0, int)
    for _ in range(6):
        rows = _connected(cloud, _on(cloud, np.flatnonzero(free), normal, offset))
        if len(rows) < 8:
            return None
        off = (cloud.points[rows] @ normal - offset) / (NEAR * cloud.noise_m[rows])
        biweight = np.clip(1 - off**2, 0, None) ** 2
        normal, offset = _fit(cloud.points[rows], biweight * cloud.noise_m[rows] ** -2)
    return normal, offset, rows


def _connected(cloud: Cloud, rows: np.ndarray) -> np.ndarray:
    """The largest connected part of these points, and those parts that are not much smaller."""
    if len(rows) < 2:
        return rows
    place = np.full(len(cloud.points), -1)
    place[rows] = np.arange(len(rows))
    near = place[cloud.neighbours[rows]]
    a, b = np.nonzero(near >= 0)
    graph = coo_matrix((np.ones(len(a)), (a, near[a, b])), shape=(len(rows), len(rows)))
    part = connected_components(graph, directed=False)[1]
    size = np.bincount(part)
    return np.asarray(rows[size[part] >= PART * size.max()])
