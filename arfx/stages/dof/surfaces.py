"""Where the real scene stands: the plane of the marker that the object is on, other markers' prints, and a background.

Distances are kept as dioptres (1/m): of a plane they are affine in the viewing direction, so a grid of every GRID_PX-th
pixel follows the lens, linear between. Leaves out: real things that stand on the plane. Where the frame has measured depth
that stands in place of all planes."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np

from arfx.core.camera import Camera
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.stages import viewing
from arfx.stages.viewing import GRID_PX

_MARGIN = 1.25  # a print and its white border, as a fraction of the black square
_SAME_PLANE = 0.1  # a marker whose corners leave the main plane by less than this fraction of its side lies in it


@lru_cache(maxsize=4)
def direction_grid(camera: Camera) -> np.ndarray:
    """(gh, gw, 3) viewing directions as `viewing.direction_grid`; where there is none, the axis."""
    d = viewing.direction_grid(camera)
    return np.where(np.isfinite(d).all(-1, keepdims=True), d, [0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Plane:
    """A real plane. forms : (3, 3), times a viewing direction gives (X, Y, 1) / z: position on the plane, m, and dioptre

    half_m : half its side; 0 = endless"""

    forms: np.ndarray
    half_m: float

    def dioptres(self, grid: np.ndarray) -> np.ndarray:
        """(gh, gw) float32 on the nodes of a direction grid; <= 0 where the plane is not met."""
        return np.ascontiguousarray(grid @ self.forms[2], np.float32)

    def positions(self, grid: np.ndarray) -> np.ndarray:
        """(gh, gw, 3) float32, `forms` times the directions."""
        return np.ascontiguousarray(grid @ self.forms.T, np.float32)


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
    """base : the endless plane or None;  finite_planes : planes of limited size before it, farthest first
    background : dioptre of what is behind, 1/m;  tiles : of `RealDepth`, where depth was measured; else None"""

    base: Plane | None
    finite_planes: tuple[Plane, ...]
    background: float
    tiles: np.ndarray | None = None

    def dioptre_range(self, grid: np.ndarray) -> tuple[float, float]:
        """Least and greatest dioptre in the picture."""
        if self.tiles is not None:
            return float(self.tiles[0].min()), float(self.tiles[1].max())
        low = high = self.background
        if self.base is not None:
            d = np.maximum(self.base.dioptres(grid), self.background)
            low, high = float(d.min()), float(d.max())
        for plane in self.finite_planes:
            p = plane.positions(grid)
            inside = (p[..., 2] > 0) & (np.abs(p[..., :2]).max(-1) <= 2 * plane.half_m * p[..., 2])
            if inside.any():
                low, high = (
                    min(low, float(p[..., 2][inside].min())),
                    max(high, float(p[..., 2][inside].max())),
                )
        return low, high


def real_scene(
    scene: Scene, camera_from_world: Pose, plane_extent_m: float, background_m: float
) -> Real:
    background = 0.0 if background_m <= 0 else 1.0 / background_m
    main = camera_from_world @ scene.world_from_anchor, plane_extent_m / 2
    squares = [main] if plane_extent_m > 0 else []
    anchor_from_world = scene.world_from_anchor.inverse()
    for spec in scene.markers:
        pose = scene.world_from_marker.get(spec.key)
        if pose is None:
            continue
        corners = anchor_from_world.apply(pose.apply(spec.corners_m))
        within = plane_extent_m <= 0 or np.abs(corners[:, :2]).max() < plane_extent_m / 2
        half = float(spec.corners_m.max())
        if within and np.abs(corners[:, 2]).max() < _SAME_PLANE * 2 * half:
            continue
        squares.append((camera_from_world @ pose, half * _MARGIN))
    squares.sort(key=lambda square: -float(square[0].translation_m[2]))
    return Real(
        plane_of(*main) if plane_extent_m <= 0 else None,
        tuple(plane_of(*s) for s in squares),
        background,
    )


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def plane_radius(
    out, top, bottom, begin, end, x0, y0, nodes, background, optics
):  # pragma: no cover - compiled
    """Rows top..bottom, columns begin..end of out (h, w): blur radius of the endless plane, px.

    x0, y0 : the rectangle's corner in the frame;  optics : px per dioptre, focus in dioptres, limit in px
    nodes : (gh, gw) dioptres of the plane every GRID_PX pixels"""
    px_per_dioptre, focus, limit = optics
    step = np.float32(1.0 / GRID_PX)
    g0, g1 = (x0 + begin) // GRID_PX, (x0 + end - 1) // GRID_PX + 1
    line = np.empty(g1 - g0 + 1, np.float32)
    for j in range(top, bottom):
        iy = (y0 + j) // GRID_PX
        fy = np.float32((y0 + j) % GRID_PX) * step
        for i in range(g0, g1 + 1):
            line[i - g0] = nodes[iy, i] + (nodes[iy + 1, i] - nodes[iy, i]) * fy
        for i in range(g0, g1):
            a, d = line[i - g0], (line[i + 1 - g0] - line[i - g0]) * step
            first = i * GRID_PX - x0
            if first >= begin and first + GRID_PX <= end:
                whole = out[j, first : first + GRID_PX]
                for k in range(GRID_PX):  # a fixed number, which the compiler makes one vector of
                    v = max(a + d * np.float32(k), background)
                    whole[k] = min(px_per_dioptre * abs(focus - v), limit)
                continue
            for x in range(max(first, begin), min(first + GRID_PX, end)):
                v = max(a + d * np.float32(x - first), background)
                out[j, x] = min(px_per_dioptre * abs(focus - v), limit)


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def move_light(
    out, image, rows, columns, corner, nodes, background, optics
):  # pragma: no cover - compiled
    """Rows and columns (first, behind the last) of out (h, w, 3) = image (h, w, 3) moved so that discs around its pixels lie
    where the light of a slanted plane goes.

    s being the blur radius with its sign, a pixel at x sends light to x - s o through the place o of the lens, with the weight
    1 - o . grad s: on average to x + s grad s / 4. corner, nodes, background, optics : of `plane_radius`"""
    px_per_dioptre, focus, limit = optics
    h, w = out.shape[:2]
    step = np.float32(1.0 / GRID_PX)
    for j in range(rows[0], rows[1]):
        iy, fy = (corner[1] + j) // GRID_PX, np.float32((corner[1] + j) % GRID_PX) * step
        for i in range(columns[0], columns[1]):
            ix, fx = (corner[0] + i) // GRID_PX, np.float32((corner[0] + i) % GRID_PX) * step
            a, b, c, d = nodes[iy, ix], nodes[iy, ix + 1], nodes[iy + 1, ix], nodes[iy + 1, ix + 1]
            left, right = a + (c - a) * fy, b + (d - b) * fy
            v = left + (right - left) * fx
            s = px_per_dioptre * (v - focus)
            by = (
                s * px_per_dioptre * step * np.float32(0.25)
                if v > background and abs(s) < limit
                else np.float32(0)
            )
            y = min(
                max(np.float32(j) - by * (c - a + (d - b - c + a) * fx), np.float32(0)),
                np.float32(h - 1),
            )
            x = min(max(np.float32(i) - by * (right - left), np.float32(0)), np.float32(w - 1))
            top, beside = np.uintp(min(int(y), h - 2)), np.uintp(min(int(x), w - 2))
            t, u = y - np.float32(top), x - np.float32(beside)
            below, after = top + np.uintp(1), beside + np.uintp(1)
            for k in range(3):
                upper = image[top, beside, k] + (image[top, after, k] - image[top, beside, k]) * u
                lower = (
                    image[below, beside, k] + (image[below, after, k] - image[below, beside, k]) * u
                )
                out[j, i, k] = upper + (lower - upper) * t


@numba.njit(cache=True, nogil=True)
def square_radius(radius, inside, x0, y0, positions, half, optics):  # pragma: no cover - compiled
    """Of a plane of limited size: radius (h, w) px and inside (h, w) float32, 1 where the pixel shows it.

    positions : (gh, gw, 3) of `Plane.positions`"""
    px_per_dioptre, focus, limit = optics
    h, w = radius.shape
    step = np.float32(1.0 / GRID_PX)
    for j in range(h):
        iy = (y0 + j) // GRID_PX
        fy = np.float32((y0 + j) % GRID_PX) * step
        for i in range(w):
            ix = (x0 + i) // GRID_PX
            fx = np.float32((x0 + i) % GRID_PX) * step
            v = np.zeros(3, np.float32)
            for c in range(3):
                a = positions[iy, ix, c] + (positions[iy, ix + 1, c] - positions[iy, ix, c]) * fx
                b = (
                    positions[iy + 1, ix, c]
                    + (positions[iy + 1, ix + 1, c] - positions[iy + 1, ix, c]) * fx
                )
                v[c] = a + (b - a) * fy
            shown = v[2] > 0 and abs(v[0]) <= half * v[2] and abs(v[1]) <= half * v[2]
            inside[j, i] = 1.0 if shown else 0.0
            radius[j, i] = (
                min(px_per_dioptre * abs(focus - v[2]), limit) if shown else np.float32(-1)
            )
