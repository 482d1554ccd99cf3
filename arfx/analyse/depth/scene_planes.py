"""The real scene's planes over a clip: those of several depth maps brought together in one frame, and the one to stand on.

What was seen of a plane is a mesh: its points moved onto it, in cells, the rim smoothed, small holes closed.
Source: docs/methods/calibration.md#planes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.analyse.depth.planes import Cloud, FoundPlane, cloud_of, find_planes
from arfx.core.camera import Camera
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane

MOST_CELLS = 160  # along the longer side
CLOSED = 2.5  # cells: holes and gaps narrower than twice this are closed
_RIM = 1.5  # cells: standard deviation of the smoothing
SAME_DEG = 6.0  # planes of two maps are one if they lean less against each other
SAME_NOISES, SAME_M = 3.0, 0.015  # and lie so near each other at their middles
UPRIGHT = np.cos(np.radians(60))
BORDER = 0.05  # of the picture's size: what lies so near its border may go on beyond
RIM = 0.06  # of a plane's extent: points so near one of its sides tell whether it ends there
CUT = 0.15  # share of those on the picture's border from which on it was the picture that ended
LEAST_AREA_M2 = 0.02  # what nothing can stand on is no plane to stand on


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


@dataclass(frozen=True, eq=False)
class ScenePlane:
    """A plane as found in one or several maps. points (n, 3), spacing_m (n,) : what lies on it, world;  up : world;
    cut (n,) bool : points next to the border of their picture;  right : of the picture, world, for its
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

    def meshed(self) -> tuple[RealPlane, PlaneMesh]:
        """With its mesh, about the middle of what was seen."""
        x = normalise(self.right - (self.right @ self.normal) * self.normal)
        axes = np.stack([x, np.cross(self.normal, x), self.normal], 1)
        places = self.points @ axes
        mesh = mesh_of(places[:, :2], self.spacing_m)
        height = self.offset_m
        middle = mesh.middle_m
        moved = PlaneMesh(mesh.mask, mesh.low_m - middle, mesh.cell_m)
        pose = Pose(axes, axes @ np.array([middle[0], middle[1], height]))
        residual = 1e3 * float(np.sqrt(((places[:, 2] - height) ** 2).mean()))
        ends = self._ends(places[:, :2])
        plane = RealPlane(pose, moved.extent_m, moved.area_m2, residual, len(places), self.frames, ends)
        return plane, moved

    def _ends(self, places: np.ndarray) -> tuple[bool, bool, bool, bool]:
        """Of the sides x0, y0, x1, y1 of what was seen: whether the plane ends there. places (n, 2), plane axes"""
        low, high = np.quantile(places, 0.005, 0), np.quantile(places, 0.995, 0)
        rim = RIM * (high - low)
        near = [places[:, 0] < low[0] + rim[0], places[:, 1] < low[1] + rim[1]]
        near += [places[:, 0] > high[0] - rim[0], places[:, 1] > high[1] - rim[1]]
        a, b, c, d = (bool(n.any()) and float(self.cut[n].mean()) < CUT for n in near)
        return a, b, c, d


def scene_planes(maps: Sequence[tuple[np.ndarray, Pose]], camera: Camera) -> list[ScenePlane]:
    """maps : (depth (h, w) metres, 0 = unknown; camera_from_world) of some frames. Those seen most first."""
    out: list[ScenePlane] = []
    for depth, pose in maps:
        cloud = cloud_of(depth, camera)
        if cloud is None:
            continue
        for found in find_planes(cloud):
            _join(out, _in_world(cloud, found, pose.inverse(), (depth.shape[1], depth.shape[0])))
    return sorted(out, key=lambda p: -len(p.points))


def _in_world(cloud: Cloud, found: FoundPlane, world_from_camera: Pose, size: tuple[int, int]) -> ScenePlane:
    rows = found.inliers
    margin = BORDER * max(size)
    at = cloud.pixels[rows]
    cut = ((at < margin) | (at > np.array(size) - 1 - margin)).any(1)
    cosine = np.abs(normalise(cloud.points[rows]) @ found.normal)
    return ScenePlane(
        world_from_camera.rotation @ found.normal, world_from_camera.apply(cloud.points[rows]),
        divide(cloud.spacing_m[rows], np.clip(cosine, 0.2, 1)), cut, world_from_camera.rotation[:, 0],
        float(np.median(cloud.noise_m[rows])), 1,
    )  # fmt: skip


def _join(planes: list[ScenePlane], new: ScenePlane) -> None:
    """Add `new`, or make it part of one that is already there."""
    for k, old in enumerate(planes):
        near = SAME_M + SAME_NOISES * max(old.noise_m, new.noise_m)
        gap = max(
            abs(float(new.points.mean(0) @ old.normal) - old.offset_m), abs(float(old.points.mean(0) @ new.normal) - new.offset_m)
        )
        if old.normal @ new.normal > np.cos(np.radians(SAME_DEG)) and gap < near:
            share = len(old.points) / (len(old.points) + len(new.points))
            planes[k] = ScenePlane(
                normalise(share * old.normal + (1 - share) * new.normal), np.concatenate([old.points, new.points]),
                np.concatenate([old.spacing_m, new.spacing_m]), np.concatenate([old.cut, new.cut]), old.right,
                share * old.noise_m + (1 - share) * new.noise_m,
                old.frames + new.frames,
            )  # fmt: skip
            return
    planes.append(new)


def facing_up(planes: Sequence[ScenePlane], camera_from_world: Sequence[Pose]) -> list[ScenePlane]:
    """Those on which something can stand, the one seen most first."""
    up = normalise(-np.mean([p.rotation[1] for p in camera_from_world], 0))
    level = [p for p in planes if p.normal @ up > UPRIGHT]
    return [p for p in level if p.meshed()[0].area_m2 >= LEAST_AREA_M2]
