"""Where the real scene stands: the plane of the marker that the object is on, other markers'
prints, and a background.

Distances are kept as dioptres (1/m): of a plane they are affine in the viewing direction, so a
table of every GRID_PX-th pixel follows the lens, linear between. Leaves out: real things that
stand on the plane. Where the frame has measured depth, that stands in place of all planes.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages import viewing
from arfx.stages.viewing import between_nodes

_MARGIN = 1.25  # a print and its white border, as a fraction of the black square
# A marker whose corners leave the main plane by less than this fraction of its side lies in it.
_SAME_PLANE = 0.1


@lru_cache(maxsize=4)
def direction_grid(camera: Camera) -> ndarray:
    """(gh, gw, 3) directions as `viewing.direction_grid`; where there is none, the axis."""
    directions = viewing.direction_grid(camera)
    known = np.isfinite(directions).all(-1, keepdims=True)
    return np.where(known, directions, [0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Plane:
    """A real plane.

    forms : (3, 3), times a viewing direction gives (X, Y, 1) / z: position on the plane, m, and
        dioptre
    half_m : half its side; 0 = endless"""

    forms: ndarray
    half_m: float

    def positions(self, grid: ndarray) -> ndarray:
        """(gh, gw, 3) float32 on the nodes of a direction grid, `forms` times the directions; the
        dioptre is <= 0 where the plane is not met."""
        return np.ascontiguousarray(grid @ self.forms.T, np.float32)

    def within(self, positions: ndarray, sides: float = 1.0) -> ndarray:
        """(...) bool, where a square of `sides` times the plane's side is met. positions : (...,
        3)"""
        x, y, dioptre = np.moveaxis(positions, -1, 0)
        reach = sides * self.half_m * dioptre
        return (dioptre > 0) & (np.abs(x) <= reach) & (np.abs(y) <= reach)


def plane_of(camera_from_plane: Pose, half_m: float) -> Plane:
    """The plane z = 0 of a pose. A plane seen edge on is nowhere."""
    r, t = camera_from_plane.rotation, camera_from_plane.translation_m
    height = float(r[:, 2] @ t)
    if abs(height) < EPS_DEPTH_M:
        return Plane(np.zeros((3, 3)), half_m)
    dioptre = divide(r[:, 2], height)  # n . d = (n . t) / z
    # p = z d lies on the plane at r' (p - t); divided by z: r' d - (r' t) / z
    x = r[:, 0] - float(r[:, 0] @ t) * dioptre
    y = r[:, 1] - float(r[:, 1] @ t) * dioptre
    return Plane(np.stack([x, y, dioptre]), half_m)


@dataclass(frozen=True, eq=False)
class Real:
    """The real scene of a frame.

    base : the endless plane
    finite_planes : planes of limited size before it, farthest first
    background : dioptre of what is behind, 1/m
    tiles : of `RealDepth`, where depth was measured, in place of all planes; else None"""

    base: Plane
    finite_planes: tuple[Plane, ...]
    background: float
    tiles: ndarray | None = None

    def dioptres(self, grid: ndarray, rect: Rect | None = None) -> ndarray:
        """(gh, gw) float32 of the endless plane and what is behind it, on the nodes of the grid;
        (h, w) of the pixels of `rect`, if there is one."""
        nodes = self.base.positions(grid)[..., 2]
        own = nodes if rect is None else between_nodes(nodes, rect)
        return np.maximum(own, np.float32(self.background))

    def dioptre_range(self, grid: ndarray) -> tuple[float, float]:
        """Least and greatest dioptre in the picture."""
        if self.tiles is not None:
            return float(self.tiles[0].min()), float(self.tiles[1].max())
        seen = [self.dioptres(grid).ravel()]
        for plane in self.finite_planes:
            positions = plane.positions(grid)
            seen.append(positions[plane.within(positions, 2.0)][:, 2])
        dioptres = np.concatenate(seen)
        return float(dioptres.min()), float(dioptres.max())


def real_scene(scene: Scene, camera_from_world: Pose, background_m: float) -> Real:
    """background_m : 0 = the plane is endless"""
    squares = []
    anchor_from_world = scene.world_from_anchor.inverse()
    for spec in scene.markers:
        pose = scene.world_from_marker.get(spec.key)
        if pose is None:
            continue
        corners = anchor_from_world.apply(pose.apply(spec.corners_m))
        half = float(spec.corners_m.max())
        if np.abs(corners[:, 2]).max() >= _SAME_PLANE * 2 * half:
            squares.append((camera_from_world @ pose, half * _MARGIN))
    squares.sort(key=lambda square: -float(square[0].translation_m[2]))
    return Real(
        plane_of(camera_from_world @ scene.world_from_anchor, 0.0),
        tuple(plane_of(*square) for square in squares),
        1.0 / background_m if background_m > 0 else 0.0,
    )
