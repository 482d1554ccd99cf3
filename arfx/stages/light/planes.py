"""The real scene as planes: the anchor's, and those of other markers that are not in it.
The picture is their radiance.

Where the object can change a plane by half a grey level: albedo x (r / d)^2 x the cosine at
which it is seen from there.
Source: docs/methods/gi.md#delta; bound from the solid angle of the ball around the object.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.numerics import HALF_GREY, normalise
from arfx.core.pose import Pose
from arfx.core.real_depth import RealPlane
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.stages.push_pull import fill_unknown
from arfx.stages.viewing import seen_rect

# Half a step of an sRGB code c is this share of its linear light or more: (2.4 / (c +
# .055)) x step, least at c = 1.
SHOWS = HALF_GREY * 2.4 / 1.055
# Least cosine of two normals, and most metres between the planes, that make them one: of
# markers, whose poses are that uncertain (an edge between two halves of one wall would be
# seen), and of planes that are measured as depth.
_SAME_MARKER, _SAME_MEASURED = (0.99, 0.02), (0.985, 0.03)
SAME_DEPTH = 0.03  # of the distance: what was measured off by more is not the plane
# a rough plane's mirror image is wider by this share of the object's height, times the
# lobe's tangent
BLUR = 0.6
NEAREST, FARTHEST = (
    1.5,
    8.0,
)  # radii of the object: the disc is never smaller or larger


ENDLESS = 1e6  # metres
BEHIND = 1e-3  # of half_m: places farther behind a plane do not see it
WARP = np.float32(
    3.0
)  # how much denser a plane's texture is in its middle than if it were even


@dataclass(frozen=True, eq=False)
class Planes:
    """Real planes, anchor axes. axes (p, 4, 3) float32 : origin, two directions in the
    plane, normal;  half_m : of textures
    bounds (p, 4) float32 : x0, y0, x1, y1 on those directions, beyond which a plane was
    seen to end; +-ENDLESS"""

    axes: ndarray
    half_m: float
    bounds: ndarray

    @property
    def key(self) -> tuple[bytes, float, bytes]:
        """Equal for equal planes."""
        return self.axes.tobytes(), self.half_m, self.bounds.tobytes()

    def first_met(
        self, starts: ndarray, directions: ndarray
    ) -> tuple[ndarray, ndarray]:
        """(plane, -1 = none; distance, inf), (...) each, of the nearest plane that rays meet
        from its front. starts, directions (..., 3), unit : broadcast together"""
        shape = np.broadcast_shapes(starts.shape, directions.shape)[:-1]
        plane, nearest = np.full(shape, -1), np.full(shape, np.inf, directions.dtype)
        for k, axes in enumerate(self.axes.astype(directions.dtype)):
            away = starts - axes[0]
            down, height = -(directions @ axes[3]), away @ axes[3]
            distance = np.maximum(height, 0) / np.maximum(down, 1e-6)
            meets = (down > 1e-6) & (distance < nearest)
            meets &= height > -BEHIND * self.half_m
            for axis, ends in zip(
                axes[1:3], self.bounds[k].reshape(2, 2).T, strict=True
            ):
                place = away @ axis + distance * (directions @ axis)
                meets &= (place >= ends[0]) & (place <= ends[1])
            plane[meets], nearest[meets] = k, distance[meets]
        return plane, nearest

    def texture_places(self, places: ndarray, plane: ndarray) -> ndarray:
        """(n, 2) on textures of planes (n,), in half sides from the middle, of places
        (n, 3)."""
        axes = self.axes.astype(float)[plane]
        along = np.einsum("nac,nc->na", axes[:, 1:3], places - axes[:, 0])
        return np.asarray(along / self.half_m)


def unwarped(u: ndarray) -> ndarray:
    """The inverse of `warped`."""
    k = float(WARP)
    return u / (k - (k - 1) * np.abs(u))


def warped(places: ndarray) -> ndarray:
    """Texture coordinate, -1..1 inside, of places on a plane in units of its texture's half
    side.
    """
    return np.asarray(WARP * places / (1 + (WARP - 1) * np.abs(places)))


@lru_cache(maxsize=4)
def bounding_ball(scene: Scene) -> tuple[ndarray, float]:
    """Centre (3,), anchor axes, and radius, metres, of a ball around the object."""
    p = scene.world_from_anchor.inverse().apply(scene.model_points_m)
    p = p[np.isfinite(p).all(1)]
    centre = (p.min(0) + p.max(0)) / 2
    return centre, max(float(np.linalg.norm(p - centre, axis=1).max()), 1e-6)


@lru_cache(maxsize=4)
def planes_of(scene: Scene) -> Planes:
    """The anchor's plane first; other markers' and measured ones only where the object
    stands before them.
    """
    anchor_from_world = scene.world_from_anchor.inverse()
    centre, radius = bounding_ball(scene)
    axes = [np.array([[centre[0], centre[1], 0.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])]
    bounds = [np.array([-ENDLESS, -ENDLESS, ENDLESS, ENDLESS])]
    markers = (
        (pose, None, *_SAME_MARKER) for pose in scene.world_from_marker.values()
    )
    real = ((p.world_from_plane, p, *_SAME_MEASURED) for p in scene.real_planes)
    for pose, measured, cosine, apart_m in (*markers, *real):
        m = anchor_from_world @ pose
        n, o = m.rotation[:, 2], m.translation_m
        same = [
            k
            for k, a in enumerate(axes)
            if n @ a[3] > cosine and abs((o - a[0]) @ a[3]) < apart_m
        ]
        distance = float((centre - o) @ n)
        if same and measured is not None and np.abs(bounds[same[0]]).min() >= ENDLESS:
            k = same[0]
            x = normalise(
                m.rotation[:, 0] - (m.rotation[:, 0] @ axes[k][3]) * axes[k][3]
            )
            axes[k] = np.stack([axes[k][0], x, np.cross(axes[k][3], x), axes[k][3]])
            bounds[k] = _bounds(measured, axes[k], o)
        if not same and -0.5 * radius < distance < FARTHEST * radius:
            axes.append(
                np.stack(
                    [centre - distance * n, m.rotation[:, 0], m.rotation[:, 1], n]
                )
            )
            bounds.append(_bounds(measured, axes[-1], o))
    return Planes(
        np.array(axes, np.float32), FARTHEST * radius, np.array(bounds, np.float32)
    )


def _bounds(measured: RealPlane | None, axes: ndarray, origin: ndarray) -> ndarray:
    """(4,) x0, y0, x1, y1 from axes[0] along axes[1], axes[2] where the plane was seen to end.

    origin (3,) : of its extent
    """
    out = np.array([-ENDLESS, -ENDLESS, ENDLESS, ENDLESS])
    if measured is not None:
        shift = np.tile(
            [(origin - axes[0]) @ axes[1], (origin - axes[0]) @ axes[2]], 2
        )
        out = np.where(measured.ends, np.asarray(measured.extent_m) + shift, out)
    return out


def disc_radius_m(scene: Scene, planes: Planes, fraction: float) -> float:
    """Beyond this distance from the object's foot the change of the plane is under half a
    grey level.

    fraction : of the plane's light that is indirect, times how much brighter than that
    light the object can be (>= 1)
    """
    centre, radius = bounding_ball(scene)
    height = max(float(centre[2]) + radius, 1e-9)
    # form factor of the ball from a place on the plane at distance d, at most (r / d)^2 x
    # height / d
    d = float(np.cbrt(max(fraction, 0.0) * radius**2 * height / SHOWS))
    return float(np.clip(d, NEAREST * radius, planes.half_m))


def disc_rect(
    scene: Scene, planes: Planes, radius_m: float, pose: Pose, frame: Rect
) -> Rect:
    """Pixels of the picture in which the discs of all planes lie; the whole frame where one
    reaches behind the camera.
    """
    angle = np.arange(32) * np.pi / 16
    ring = 1.02 * radius_m * np.stack([np.cos(angle), np.sin(angle)], -1)
    camera_from_anchor = pose @ scene.world_from_anchor
    out = EMPTY
    for axes in _faced(planes, camera_from_anchor):
        points = camera_from_anchor.apply(axes[0] + ring @ axes[1:3])
        out = out.union(seen_rect(scene.camera, points, 1.0))
    return out.clip(frame)


def _faced(planes: Planes, camera_from_anchor: Pose) -> Iterator[ndarray]:
    """Axes (4, 3) of the planes that the camera is before."""
    eye = camera_from_anchor.inverse().translation_m
    for axes in planes.axes.astype(float):
        if (eye - axes[0]) @ axes[3] > 0:
            yield axes


def mirror_rect(
    scene: Scene, planes: Planes, tangent: float, pose: Pose, frame: Rect
) -> Rect:
    """Pixels in which the planes can mirror the object; the whole frame where its image
    reaches behind the camera.

    tangent : of the lobe's half-angle, by which a rough plane widens the image"""
    corners = scene.world_from_anchor.inverse().apply(scene.model_corners_m)
    camera_from_anchor = pose @ scene.world_from_anchor
    out = EMPTY
    for axes in _faced(planes, camera_from_anchor):
        normal = axes[3]
        height = (corners - axes[0]) @ normal
        if height.max() <= 0:
            continue
        mirrored = corners - 2 * np.clip(height, 0, None)[:, None] * normal
        reach = BLUR * tangent * float(height.max())
        spread = np.concatenate(
            [mirrored + s * reach * a for s in (-1, 1) for a in (axes[1], axes[2])]
        )
        out = out.union(
            seen_rect(scene.camera, camera_from_anchor.apply(spread), 2.0)
        )
    return out.clip(frame)


@lru_cache(maxsize=4)
def texel_positions(planes: Planes, side: int) -> ndarray:
    """(p, side, side, 3) float64 metres, anchor axes, of the texels' centres."""
    t = unwarped((np.arange(side) + 0.5) / side * 2 - 1) * planes.half_m
    v, u = np.meshgrid(t, t, indexing="ij")
    a = planes.axes.astype(float)[:, :, None, None]
    return a[:, 0] + u[..., None] * a[:, 1] + v[..., None] * a[:, 2]


@dataclass(frozen=True, eq=False)
class PlatePicture:
    """A frame's picture as the radiance of the places of planes that it shows.

    plate : (h, w, 3) over `rect`;  allowed : only these pixels are looked at;  bias (3,)
    real : (h, w) measured depth, or none: a pixel that shows something before a plane does
    not show the plane"""

    plate: ndarray
    rect: Rect
    allowed: Rect
    camera: Camera
    camera_from_anchor: Pose
    bias: ndarray
    real: ndarray

    def radiance(self, places: ndarray, axes: ndarray) -> tuple[ndarray, ndarray]:
        """(h, w, 3) float32 at places (h, w, 3) of one plane, and 1 where it is known, else
        0, (h, w) float32. axes (4, 3) : of `Planes`"""
        rect, allowed = self.rect, self.allowed.clip(self.rect)
        eye = self.camera_from_anchor.inverse().translation_m
        placed = self.camera_from_anchor.apply(places)
        seen = self.camera.project(placed)
        inside = np.isfinite(seen).all(-1) & ((eye - axes[0]) @ axes[3] > 0)
        x, y = np.moveaxis(np.where(inside[..., None], seen, -1e6), -1, 0)
        inside &= (x >= allowed.x0) & (x <= allowed.x1 - 1)
        inside &= (y >= allowed.y0) & (y <= allowed.y1 - 1)
        if not inside.any():
            return np.zeros(places.shape, np.float32), inside.astype(np.float32)
        x, y = x - rect.x0, y - rect.y0
        if self.real.size:
            column, row = np.rint([x[inside], y[inside]]).astype(int)
            dioptres = 1 / placed[inside][:, 2]
            inside[inside] = (
                on_plane(self.real[row, column], dioptres, SAME_DEPTH) == 1
            )
        border = cv2.BORDER_REPLICATE
        at = x.astype(np.float32), y.astype(np.float32)
        out = cv2.remap(self.plate, *at, cv2.INTER_LINEAR, borderMode=border)
        out = np.clip(out - self.bias, 0, None) * inside[..., None]
        return np.asarray(out, np.float32), inside.astype(np.float32)


def on_plane(real_m: ndarray, dioptres: ndarray, tolerance: float) -> ndarray:
    """(h, w) float32: 1 = the real surface is the plane, 0 = it is not; 1 where nothing was
    measured.

    real_m : (h, w) metres;  dioptres : of the plane, 1/m;  tolerance : share of the plane's
    distance, twice that gives 0
    """
    known = np.isfinite(real_m) & (real_m > 0)
    off = np.abs(np.where(known, real_m, 0) * dioptres - 1)
    fraction = np.clip(2 - off * np.float32(1 / tolerance), 0, 1)
    return np.where(known, fraction, 1).astype(np.float32)


def filled(radiance: ndarray, known: ndarray, otherwise: ndarray) -> ndarray:
    """(p, side, side, 3) float32: what the picture does not show as what it shows around;
    `otherwise` (3,) where it shows nothing. known (p, side, side) : 0 or 1"""
    out = np.empty_like(radiance)
    for to, values, shown in zip(out, radiance, known > 0, strict=True):
        to[:] = fill_unknown(values, shown) if shown.any() else otherwise
    return out


def halvings(texels: ndarray, least: int) -> list[ndarray]:
    """(p, n, n, c) and the means of four texels each, down to `least` texels a side."""
    levels = [texels]
    while (n := levels[-1].shape[1] // 2) >= least:
        levels.append(levels[-1].reshape(len(texels), n, 2, n, 2, -1).mean((2, 4)))
    return levels


def mip_chain(radiance: ndarray) -> tuple[ndarray, ndarray]:
    """(p, texels, 3) float32 and (levels, 2) int64 (offset, side): halved down to one texel."""
    p, levels = len(radiance), halvings(radiance, 1)
    sides = np.array([level.shape[1] for level in levels], np.int64)
    offsets = np.cumsum(sides**2) - sides**2
    flat = np.concatenate([level.reshape(p, -1, 3) for level in levels], 1)
    return np.ascontiguousarray(flat, np.float32), np.stack([offsets, sides], -1)
