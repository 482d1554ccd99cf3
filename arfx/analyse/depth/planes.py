"""Planes of the real scene in a measured depth map: several, robust, each with what its
points miss of it.

Of a plane 1 / depth is linear in the viewing ray, and a depth sensor's noise in 1 / depth is
the same everywhere: small squares of the picture tell the noise, and the flat ones are
hypotheses. Thresholds are multiples of the noise. Planes of several maps are
brought together in one frame; what was seen of one is a mask: its points moved onto it, in
cells, the rim smoothed, small holes closed.
Source: docs/methods/calibration.md#planes.
Cost: O(patches x points) per plane."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane

MOST_POINTS = 14000  # about so many are taken, evenly over the picture
# no sensor is better, and rounding to millimetres alone is a third of it
LEAST_NOISE_M = 1e-3
PATCH, FULL = 8, 0.5  # points along a side of a square; share that must be measured
FLAT = 0.015  # of the distance: a square that misses its plane by more is none
MOST_PLANES = 6
SCORED = 2500  # points that hypotheses are judged by
LEAST_FRACTION = 0.03  # of all points: less is furniture
NEAR = 2.5  # noises: on the plane
TAKEN = 5.0  # noises: no seed of another plane
ROUNDS = 12  # of a plane's refinement
# of the largest connected part: a smaller one is something else at the same height
PART = 0.1
MOST_CELLS = 160  # along the longer side
_CLOSED = 3  # cells: holes and gaps narrower than twice this are closed
_RIM = 1.5  # cells: standard deviation of the smoothing
SAME_DEG = 6.0  # planes of two maps are one if they lean less against each other
SAME_NOISES, SAME_M = 3.0, 0.015  # and lie so near each other at their middles
UPRIGHT = np.cos(np.radians(60))
BORDER = 0.05  # of the picture's size: what lies so near its border may go on beyond
RIM = 0.06  # of a plane's extent: points so near one of its sides tell whether it ends there
CUT = 0.15  # share of those on the picture's border from which on it was the picture that ended
LEAST_AREA_M2 = 0.02  # what nothing can stand on is no plane to stand on


class Cloud(NamedTuple):
    """points (n, 3) CAMERA axes, metres;  rays (n, 3) : towards them, with z = 1
    noise_m (n,) : standard deviation along the axis;  spacing_m (n,) : of neighbouring points
    cut (n,) bool : next to the picture's border
    grid (rows, columns) : number of the point, -1 = not measured
    patches (k, 3) : planes of flat parts of the picture, as `plane @ ray` = 1 / depth"""

    points: ndarray
    rays: ndarray
    noise_m: ndarray
    spacing_m: ndarray
    cut: ndarray
    grid: ndarray
    patches: ndarray


def cloud_of(depth_m: ndarray, camera: Camera) -> Cloud | None:
    """depth_m : (h, w) along the optical axis, not finite or <= 0 = not measured.

    None where too little is."""
    known = np.isfinite(depth_m) & (depth_m > 0)
    h, w = depth_m.shape
    step = max(1, int(np.sqrt(known.sum() / MOST_POINTS)))
    y, x = np.mgrid[step // 2 : h : step, step // 2 : w : step]
    pixels, own = np.stack([x, y], -1).astype(float), camera.scaled_to(w, h)
    rays = own.directions(pixels)
    keep = known[y, x] & np.isfinite(rays).all(-1)
    if keep.sum() < PATCH**2:
        return None
    rays[~keep], near = 0.0, divide(keep, depth_m[y, x])
    patches, noise = _patches(rays, near)
    z, grid = 1 / near[keep], np.full(keep.shape, -1)
    grid[keep] = np.arange(len(z))
    margin, size = BORDER * max(w, h), np.array([w, h])
    cut = ((pixels < margin) | (pixels > size - 1 - margin)).any(-1)
    return Cloud(
        rays[keep] * z[:, None],
        rays[keep],
        np.maximum(noise * z**2, LEAST_NOISE_M),
        step * z / own.fx,
        cut[keep],
        grid,
        patches,
    )


def _patches(rays: ndarray, near: ndarray) -> tuple[ndarray, float]:
    """Planes (k, 3) through flat squares of the picture, and the standard deviation of 1 /
    depth. rays (rows, columns, 3), near (rows, columns) : 1 / depth;  0 = not measured"""
    whole = np.dstack([rays, near])
    rows, columns = (side // PATCH for side in near.shape)
    whole = whole[: rows * PATCH, : columns * PATCH].reshape(
        rows, PATCH, columns, PATCH, 4
    )
    parts = whole.swapaxes(1, 2).reshape(-1, PATCH**2, 4)
    count = (parts[..., 3] > 0).sum(1)
    parts, count = parts[count > FULL * PATCH**2], count[count > FULL * PATCH**2]
    a, b = parts[..., :3], parts[..., 3:]
    planes = np.linalg.pinv(a) @ b
    missed = np.sqrt(((a @ planes - b) ** 2).sum((1, 2)) / (count - 3))
    middle = b.sum((1, 2)) / count
    flat = missed < FLAT * middle
    if not flat.any():
        return np.zeros((0, 3)), 0.0
    # what edges and clutter miss is no noise
    noise = float(np.quantile(missed[flat], 0.2))
    flat &= missed < 2 * np.maximum(noise, LEAST_NOISE_M * middle**2)
    return planes[flat, :, 0], noise


class FoundPlane(NamedTuple):
    """normal (3,) unit, towards the camera; normal . x = offset_m, CAMERA axes;  inliers :
    indices into the cloud
    """

    normal: ndarray
    offset_m: float
    inliers: ndarray


def find_planes(cloud: Cloud) -> list[FoundPlane]:
    """The planes, that with the most points first; none where nothing is flat."""
    near = 1 / cloud.points[:, 2]
    noise = cloud.noise_m * near**2
    free, patches = np.ones(len(near), bool), cloud.patches
    out: list[FoundPlane] = []
    while len(out) < MOST_PLANES and len(patches):
        some = np.flatnonzero(free)
        some = some[:: max(1, len(some) // SCORED)]
        missed = np.abs(cloud.rays[some] @ patches.T - near[some, None])
        votes = (missed < NEAR * noise[some, None]).sum(0)
        plane = patches[votes.argmax()]
        for _ in range(ROUNDS):
            off = (cloud.rays @ plane - near) / (NEAR * noise)
            rows = _connected(cloud.grid, free & (np.abs(off) < 1))
            weight = (1 - off[rows] ** 2) / noise[rows]
            a = cloud.rays[rows] * weight[:, None]
            plane = np.linalg.lstsq(a, near[rows] * weight)[0]
        if len(rows) < LEAST_FRACTION * len(near):
            break
        far = 1 / float(np.linalg.norm(plane))
        out.append(FoundPlane(-plane * far, -far, rows))
        free &= np.abs(cloud.rays @ plane - near) > TAKEN * noise
        patches = patches[votes < votes.max()]
    return sorted(out, key=lambda p: -len(p.inliers))


def _connected(grid: ndarray, there: ndarray) -> ndarray:
    """Of those points (n,) the largest part that hangs together in the picture, and those
    parts that are not much smaller."""
    mask = (grid >= 0) & there[grid]
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    part = cv2.connectedComponents(wide)[1]
    size = np.bincount(part[mask], minlength=2)
    return grid[mask & (size >= PART * size.max())[part]]


class Seen(NamedTuple):
    """What was seen of a plane, its own axes. extent_m (4,) : x0, y0, x1, y1
    middle_m (2,) : the place nearest the mean that is well inside: as far from the rim as 60 %
    of what any place is"""

    area_m2: float
    extent_m: ndarray
    middle_m: ndarray


def seen_of(positions_m: ndarray, spacing_m: ndarray) -> Seen:
    """positions_m (n, 2) : points moved onto the plane, its axes;  spacing_m (n,) :
    distance of neighbouring points there
    """
    low, high = positions_m.min(0), positions_m.max(0)
    cell = max(
        float(np.quantile(spacing_m, 0.75)),
        float((high - low).max()) / MOST_CELLS,
        1e-4,
    )
    pad = _CLOSED + 1
    x, y = ((positions_m - low) / cell).astype(int).T + pad
    count = np.zeros((y.max() + 1 + pad, x.max() + 1 + pad), np.uint8)
    count[y, x] = 1
    width = 2 * _CLOSED + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    mask = cv2.morphologyEx(count, cv2.MORPH_CLOSE, disc)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _RIM)
    smooth = (soft > 0.5).astype(np.uint8)
    mask = smooth if smooth.any() else mask
    room = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    cells, inside = (
        np.argwhere(c)[:, ::-1] for c in (mask, room >= 0.6 * room.max())
    )
    middle = inside[((inside - cells.mean(0)) ** 2).sum(1).argmin()] + 0.5
    extent = np.append(cells.min(0), cells.max(0) + 1)
    first = low - pad * cell
    area = len(cells) * cell**2
    return Seen(area, np.tile(first, 2) + cell * extent, first + cell * middle)


class ScenePlane(NamedTuple):
    """A plane as found in one or several maps. points (n, 3), spacing_m (n,) : what lies on
    it, world;  up : world;
    cut (n,) bool : points next to the border of their picture;  right : of the picture,
    world, for its
    x axis;  noise_m : of the points"""

    normal: ndarray
    points: ndarray
    spacing_m: ndarray
    cut: ndarray
    right: ndarray
    noise_m: float
    frames: int

    def real_plane(self) -> RealPlane:
        """About the middle of what was seen."""
        x = normalise(self.right - (self.right @ self.normal) * self.normal)
        axes = np.stack([x, np.cross(self.normal, x), self.normal], 1)
        positions = self.points @ axes
        seen = seen_of(positions[:, :2], self.spacing_m)
        height, middle = float(np.median(positions[:, 2])), seen.middle_m
        pose = Pose(axes, axes @ np.array([middle[0], middle[1], height]))
        residual_mm = 1e3 * float(np.sqrt(((positions[:, 2] - height) ** 2).mean()))
        x0, y0, x1, y1 = (seen.extent_m - np.tile(middle, 2)).tolist()
        # whether it ends at its sides x0, y0, x1, y1
        low, high = np.quantile(positions[:, :2], (0.005, 0.995), 0)
        rim = RIM * (high - low)
        near = positions[:, :2] < low + rim, positions[:, :2] > high - rim
        a, b, c, d = (
            bool(self.cut[n].sum() < CUT * n.sum()) for n in np.hstack(near).T
        )
        return RealPlane(
            pose,
            (x0, y0, x1, y1),
            seen.area_m2,
            residual_mm,
            len(positions),
            self.frames,
            (a, b, c, d),
        )


def scene_planes(
    maps: Sequence[tuple[ndarray, Pose]], camera: Camera
) -> list[ScenePlane]:
    """maps : (depth (h, w) metres, 0 = unknown; camera_from_world) of some frames. Those
    seen most first.
    """
    out: list[ScenePlane] = []
    for depth, pose in maps:
        if (cloud := cloud_of(depth, camera)) is None:
            continue
        world_from_camera = pose.inverse()
        for found in find_planes(cloud):
            rows = found.inliers
            cosine = np.abs(normalise(cloud.rays[rows]) @ found.normal)
            plane = ScenePlane(
                world_from_camera.rotation @ found.normal,
                world_from_camera.apply(cloud.points[rows]),
                divide(cloud.spacing_m[rows], np.clip(cosine, 0.2, 1)),
                cloud.cut[rows],
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
        apart = old.points.mean(0) - new.points.mean(0)
        gap = max(abs(apart @ old.normal), abs(apart @ new.normal))
        if old.normal @ new.normal > np.cos(np.radians(SAME_DEG)) and gap < near:
            share = len(old.points) / (len(old.points) + len(new.points))
            normal = normalise(share * old.normal + (1 - share) * new.normal)
            pairs = zip(old[1:4], new[1:4], strict=True)
            points, spacing_m, cut = map(np.concatenate, pairs)
            old = old._replace(normal=normal, points=points, spacing_m=spacing_m)
            planes[k] = old._replace(cut=cut, frames=old.frames + 1)
            return
    planes.append(new)


def facing_up(
    planes: Sequence[ScenePlane], camera_from_world: Sequence[Pose]
) -> list[ScenePlane]:
    """Those on which something can stand, the one seen most first."""
    up = normalise(-np.mean([p.rotation[1] for p in camera_from_world], 0))
    return [
        p
        for p in planes
        if p.normal @ up > UPRIGHT and p.real_plane().area_m2 >= LEAST_AREA_M2
    ]
