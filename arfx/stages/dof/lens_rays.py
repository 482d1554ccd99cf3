"""The virtual object through a lens, for the reference level: rays through every pixel from places of the lens (embree).

The fraction of rays that meet the model is its coverage; a point met has the colour that the pinhole picture has there. Places
on the lens and in the pixel are one Sobol' sequence, the same for every pixel. A pixel whose samples have the standard
deviation sd is off by about sd n^-3/4 after n rays: it gets more until that is at most NOISE, or it has MOST. So a pixel depends
on no other. Before a plane, what passes by the object comes from one side of the lens: where some rays meet it and some do not,
the mean of the real scene over the whole lens is corrected by its covariance with passing by.
Cost: O(pixels of the object x rays), most of them with FIRST. Leaves out: colours of points that the pinhole
picture does not show (they take the mean of those met beside them), partly transparent materials."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.dof.aperture import circumradius
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.layers import depth_range
from arfx.stages.dof.planes import Real
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import build_mesh
from arfx.stages.triangles import Triangles

FIRST, MOST = 32, 512  # rays of a pixel; powers of two, as the sequence is even after such numbers
NOISE = 2e-3  # of white, linear light
_BATCH_PX = 1024
_HOLE = 0.1  # where less is covered all around, a point of the model is cut out, or hidden by what is real


@dataclass(frozen=True, eq=False)
class RayScene:
    """triangles : metres from centre_m in world axes;  directions : of the camera's pixels"""

    triangles: Triangles
    centre_m: np.ndarray
    directions: LensTable

    @staticmethod
    def of(scene: Scene) -> RayScene:
        mesh = build_mesh(scene)
        return RayScene(
            Triangles(mesh.corners_m, robust=True), mesh.centre_m, LensTable(scene.camera)
        )


@lru_cache(maxsize=4)
def lens_points(count: int, blades: int, turn_deg: float) -> np.ndarray:
    """(count, 4) places on a lens of the area of the unit disc, and within a pixel, 0..1. count : a power of two"""
    from scipy.stats.qmc import Sobol

    square = Sobol(4, seed=0).random(count)
    radius, angle = np.sqrt(square[:, 0]), 2 * np.pi * square[:, 1]
    if (
        blades >= 3
    ):  # stretch every ray from the centre to the polygon's edge, at the same fraction of the area
        wedge = 2 * np.pi / blades
        number, part = np.divmod(angle, wedge)
        # angles whose density follows the polygon's squared edge distance, as its area does
        within = np.arctan((2 * part / wedge - 1) * np.tan(wedge / 2))
        radius = radius * circumradius(blades) * np.cos(wedge / 2) / np.cos(within)
        angle = number * wedge + wedge / 2 + within + np.radians(turn_deg)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), square[:, 2:]])


def seen_object(
    now: Layers,
    facts: FrameFacts,
    camera: Camera,
    coc: CircleOfConfusion,
    params: DofParams,
    scene: RayScene,
    sharp: np.ndarray,
    blurred: np.ndarray,
    real: Real,
) -> tuple[np.ndarray, np.ndarray]:
    """Fraction of the lens that sees the object (h, w), and what its light adds (h, w, 3), together with the correction of
    what passes by it. sharp, blurred : (h, w, 3) the real scene"""
    shape = (now.rect.height, now.rect.width)
    fraction, colour = np.zeros(shape), np.zeros((*shape, 3))
    near, far = depth_range(facts)
    reach = circumradius(params.blades) * coc.largest_px((1 / near, 1 / far))
    box = facts.raster_box.pad(int(np.ceil(reach)) + 1).clip(now.rect)
    if facts.model_box.empty or box.empty:
        return fraction, colour
    points = lens_points(MOST, params.blades, params.blade_turn_deg).copy()
    points[:, :2] *= coc.px_per_dioptre / camera.fx
    on_plane = params.scope == "all" and real.base is not None and not real.finite_planes
    rays = _Rays(now, facts, camera, coc.focus, points, scene, sharp, real if on_plane else None)
    rows = max(_BATCH_PX // box.width, 1)

    def trace(top: int) -> None:
        part = Rect(box.x0, top, box.x1, min(top + rows, box.y1))
        at = part.slices_in(now.rect)
        seen, mean = rays.trace(part, blurred[at].reshape(-1, 3))
        fraction[at], colour[at] = seen.reshape(fraction[at].shape), mean.reshape(colour[at].shape)

    parallel_map(trace, list(range(box.y0, box.y1, rows)))
    return fraction, colour


@dataclass(frozen=True, eq=False)
class _Rays:
    """points : (n, 4) of `lens_points`, the lens in metres;  focus : 1/m;  behind : (h, w, 3) the real scene, sharp
    real : it is an endless plane before a background; None = what passes by the object is not looked at"""

    now: Layers
    facts: FrameFacts
    camera: Camera
    focus: float
    points: np.ndarray
    scene: RayScene
    behind: np.ndarray
    real: Real | None

    def trace(self, part: Rect, behind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the pixels of a rectangle: fraction of rays that meet the object (n, 1), and what `seen_object` adds (n, 3)."""
        corners = self.scene.directions.at(
            np.arange(part.y0, part.y1 + 1) - 0.5, np.arange(part.x0, part.x1 + 1) - 0.5
        )
        known = np.isfinite(corners).all(-1)
        active = np.flatnonzero(known[1:, 1:] & known[:-1, 1:] & known[1:, :-1] & known[:-1, :-1])
        sums, count = np.zeros((part.area, 12)), np.ones((part.area, 1))
        first, last = 0, FIRST
        while len(active) and first < len(self.points):
            self._add(sums, active, np.ascontiguousarray(corners, float), self.points[first:last])
            count[active] = last
            fraction = sums[:, :1] / count
            mean, square = (divide(sums[:, a : a + 3], sums[:, 1:2]) for a in (2, 5))
            colour = fraction * mean + (1 - fraction) * behind
            variance = fraction * square + (1 - fraction) * behind**2 - colour**2
            left = np.sqrt(np.maximum(variance.max(1), 0) + sums[:, 11] / count[:, 0]) * last**-0.75
            active = active[left[active] > NOISE]
            first, last = last, 2 * last
        fraction = sums[:, :1] / count
        return fraction, fraction * divide(sums[:, 2:5], sums[:, 1:2]) + sums[:, 8:11] / count

    def _add(
        self, sums: np.ndarray, active: np.ndarray, corners: np.ndarray, points: np.ndarray
    ) -> None:
        """More rays of the pixels `active`, from these points."""
        n, pose, now = len(points), self.facts.pose, self.now
        eye = pose.inverse().translation_m - self.scene.centre_m
        origins, directions = np.empty((2, len(active) * n, 3), np.float32)
        _aim(active, corners, points, eye, pose.rotation, self.focus, origins, directions)
        hit = self.scene.triangles.first_hits(origins, directions)
        met = np.flatnonzero(hit["primID"] >= 0)
        along = np.asarray(hit["tfar"], float)[
            met, None
        ]  # directions have z = 1: distance along the axis
        place = self.camera.project(
            (origins[met] + along * directions[met] - eye) @ pose.rotation.T
        )
        place -= [now.rect.x0, now.rect.y0]
        picture = tuple(packed(now[name]) for name in (Layer.VIRTUAL, Layer.COVERAGE, Layer.DEPTH))
        opaque = np.zeros(len(origins), bool)
        _look_up(
            sums, active[met // n], place, along[:, 0], points[met % n, 2:], picture, opaque, met
        )
        if self.real is not None:
            passing = 1.0 - opaque.reshape(-1, n)
            passing -= passing.mean(1, keepdims=True)
            mixed = np.flatnonzero(passing.any(1))
            rays = directions.reshape(-1, n, 3)[mixed] @ pose.rotation.T
            behind = passing[mixed][..., None] * self._behind(rays, points, self.real)
            sums[active[mixed], 8:11] += behind.sum(1)
            sums[active[mixed], 11] += n * behind.var(1).max(1)

    def _behind(self, rays: np.ndarray, points: np.ndarray, real: Real) -> np.ndarray:
        """Colours (k, n, 3) of the real scene that rays (k, n, 3), in the camera's axes, would meet."""
        assert real.base is not None
        form = real.base.forms[2]
        dioptre = np.maximum(divide(rays @ form, 1 - points[:, :2] @ form[:2]), real.background)
        rays = rays + dioptre[..., None] * np.pad(points[:, :2], ((0, 0), (0, 1)))
        place = (
            self.camera.project(rays) - [self.now.rect.x0, self.now.rect.y0] - (points[:, 2:] - 0.5)
        )
        h, w = self.behind.shape[:2]
        x, y = np.rint(np.where(np.isfinite(place), place, 0.0)).astype(int).transpose(2, 0, 1)
        return self.behind[y.clip(0, h - 1), x.clip(0, w - 1)]


@numba.njit(cache=True, nogil=True)
def _aim(
    active, corners, points, eye, rotation, focus, origins, directions
):  # pragma: no cover - compiled
    """Rays (pixels x points, 3) in world axes. corners : (h + 1, w + 1, 2) directions of the pixels' corners"""
    w, n = corners.shape[1] - 1, len(points)
    for i in range(len(active)):
        y, x = active[i] // w, active[i] % w
        a, b, c, d = corners[y, x], corners[y, x + 1], corners[y + 1, x], corners[y + 1, x + 1]
        for k in range(n):
            lens_x, lens_y, s, t = points[k]
            dx = (
                (a[0] * (1 - s) + b[0] * s) * (1 - t)
                + (c[0] * (1 - s) + d[0] * s) * t
                - focus * lens_x
            )
            dy = (
                (a[1] * (1 - s) + b[1] * s) * (1 - t)
                + (c[1] * (1 - s) + d[1] * s) * t
                - focus * lens_y
            )
            for m in range(3):
                origins[i * n + k, m] = eye[m] + lens_x * rotation[0, m] + lens_y * rotation[1, m]
                directions[i * n + k, m] = (
                    dx * rotation[0, m] + dy * rotation[1, m] + rotation[2, m]
                )


@numba.njit(cache=True, nogil=True)
def _look_up(sums, pixel, place, z, within, picture, opaque, met):  # pragma: no cover - compiled
    """Add points met to sums (n, 8 and more): number that is opaque, and of those that the pinhole picture shows, colour, its
    squares. Of rays met (m,) that are opaque, sets opaque (rays,).

    place (m, 2) px, z (m,) metres : of the points;  within (m, 2) : where in its pixel the ray begins. The picture is an average
    over pixels already, so it is asked at the place that belongs to a ray from the pixel's middle."""
    virtual, coverage, depth = picture
    h, w = coverage.shape
    for i in range(len(pixel)):
        u, v, to = place[i, 0], place[i, 1], sums[pixel[i]]
        if not (np.isfinite(u) and np.isfinite(v)):
            to[0] += 1
            opaque[met[i]] = True
            continue
        if 0 <= u <= w - 1 and 0 <= v <= h - 1:
            y, x = int(v), int(u)
            b, r = min(y + 1, h - 1), min(x + 1, w - 1)
            if (
                max(max(coverage[y, x], coverage[y, r]), max(coverage[b, x], coverage[b, r]))
                < _HOLE
            ):
                continue
        to[0] += 1
        opaque[met[i]] = True
        for shift in (1.0, 0.0):
            x, y = (
                int(np.rint(u - shift * (within[i, 0] - 0.5))),
                int(np.rint(v - shift * (within[i, 1] - 0.5))),
            )
            if (
                0 <= x < w
                and 0 <= y < h
                and coverage[y, x] > 0
                and abs(depth[y, x] - z[i]) < 0.02 * z[i]
            ):
                to[1] += 1
                for c in range(3):
                    value = virtual[y, x, c] / coverage[y, x]
                    to[2 + c] += value
                    to[5 + c] += value * value
                break
