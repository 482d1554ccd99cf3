"""The virtual object through a lens, for the reference level: rays through every pixel from places
of the lens (embree).

The fraction of rays that meet the model is its coverage; a point met has the colour that the
pinhole picture has there. Places on the lens and in the pixel are one Sobol' sequence, the same
for every pixel. A pixel whose samples have the standard deviation sd is off by about sd n^-3/4
after n rays: it gets more until that is at most NOISE, or it has MOST. So a pixel depends on no
other. Before a plane, what passes by the object comes from one side of the lens: where some rays
meet it and some do not, the mean of the real scene over the whole lens is corrected by its
covariance with passing by. Cost: O(pixels of the object x rays), most of them with FIRST.
Leaves out: colours of points that the pinhole picture does not show (they take the mean of those
met beside them), partly transparent materials."""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.compiled import kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, packed
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.dof.aperture import circumradius
from arfx.stages.dof.layers import object_box, object_radius_px
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real
from arfx.stages.raster.lens import LensTable
from arfx.stages.triangles import Triangles

FIRST, MOST = (
    32,
    512,
)  # rays of a pixel; powers of two, as the sequence is even after such numbers
NOISE = 2e-3  # of white, linear light
_BATCH_PX = 1024
# Where less is covered all around, a point of the model is cut out, or hidden by what is real.
_HOLE = 0.1


class RayScene:
    """triangles : metres from centre_m in world axes;  directions : of the camera's pixels"""

    def __init__(self, scene: Scene) -> None:
        mesh = scene.mesh_at(0.0)
        self.triangles = Triangles(mesh.corners_m, robust=True)
        self.centre_m, self.directions = mesh.centre_m, LensTable(scene.camera)


@lru_cache(maxsize=4)
def lens_points(count: int, blades: int, turn_deg: float) -> ndarray:
    """(count, 4) places on a lens of the area of the unit disc, and within a pixel, 0..1. count :
    a power of two"""
    from scipy.stats.qmc import Sobol

    square = Sobol(4, seed=0).random(count)
    radius, angle = np.sqrt(square[:, 0]), 2 * np.pi * square[:, 1]
    if blades >= 3:
        # stretch every ray from the centre to the polygon's edge, at the same fraction of the area
        wedge = 2 * np.pi / blades
        number, part = np.divmod(angle, wedge)
        # angles whose density follows the polygon's squared edge distance, as its area does
        within = np.arctan((2 * part / wedge - 1) * np.tan(wedge / 2))
        radius = radius * circumradius(blades) * np.cos(wedge / 2) / np.cos(within)
        angle = number * wedge + wedge / 2 + within + np.radians(turn_deg)
    return np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), square[:, 2:]]
    )


@dataclass(frozen=True, eq=False)
class LensView:
    """A frame's object through the lens. scene : what `prepare` made
    sharp, behind : (h, w, 3) the real scene, before and after its blur
    real : a plane before a background; None = what passes by the object is not looked at"""

    now: Layers
    facts: FrameFacts
    camera: Camera
    coc: CircleOfConfusion
    params: DofParams
    scene: RayScene
    sharp: ndarray
    behind: ndarray
    real: Real | None

    def seen(self) -> tuple[ndarray, ndarray]:
        """Fraction of the lens that sees the object (h, w, 1), and what its light adds (h, w, 3),
        with the correction of what passes by it."""
        rect, blades = self.now.rect, self.params.blades
        fraction, colour = (
            np.zeros((*self.sharp.shape[:2], 1)),
            np.zeros(self.sharp.shape),
        )
        reach = circumradius(blades) * object_radius_px(self.facts, self.coc)
        box = object_box(self.facts, rect, reach)
        if self.facts.model_box.empty or box.empty:
            return fraction, colour
        points = lens_points(MOST, blades, self.params.blade_turn_deg).copy()
        points[:, :2] *= self.coc.px_per_dioptre / self.camera.fx
        rows = max(_BATCH_PX // box.width, 1)

        def trace(top: int) -> None:
            part = Rect(box.x0, top, box.x1, min(top + rows, box.y1))
            at = part.slices_in(rect)
            seen, mean = self.trace(part, points)
            fraction[at] = seen.reshape(-1, part.width, 1)
            colour[at] = mean.reshape(-1, part.width, 3)

        parallel_map(trace, range(box.y0, box.y1, rows))
        return fraction, colour

    def trace(self, part: Rect, points: ndarray) -> tuple[ndarray, ndarray]:
        """`seen` of the n pixels of a rectangle, (n, 1) and (n, 3). points : (k, 4) of
        `lens_points`, the lens in metres"""
        behind = self.behind[part.slices_in(self.now.rect)].reshape(-1, 3)
        rows, columns = (
            np.arange(part.y0, part.y1 + 1),
            np.arange(part.x0, part.x1 + 1),
        )
        corners = self.scene.directions.at(rows - 0.5, columns - 0.5).astype(float)
        beside = corners[:-1] + corners[1:]
        active = np.flatnonzero(np.isfinite(beside[:, :-1] + beside[:, 1:]).all(-1))
        sums, count = np.zeros((part.area, 12)), np.ones((part.area, 1))
        first, last = 0, FIRST
        while len(active) and first < len(points):
            self._add(sums, active, corners, points[first:last])
            count[active] = last
            fraction = sums[:, :1] / count
            mean, square = (divide(sums[:, a : a + 3], sums[:, 1:2]) for a in (2, 5))
            colour = fraction * mean + (1 - fraction) * behind
            variance = fraction * square + (1 - fraction) * behind**2 - colour**2
            variance = np.maximum(variance.max(1), 0) + sums[:, 11] / count[:, 0]
            noise = np.sqrt(variance) * last**-0.75
            active = active[noise[active] > NOISE]
            first, last = last, 2 * last
        fraction = sums[:, :1] / count
        light = fraction * divide(sums[:, 2:5], sums[:, 1:2])
        return fraction, light + sums[:, 8:11] / count

    def _add(
        self,
        sums: ndarray,
        active: ndarray,
        corners: ndarray,
        points: ndarray,
    ) -> None:
        """More rays of the pixels `active`, from these points."""
        n, pose, now = len(points), self.facts.pose, self.now
        eye = pose.inverse().translation_m - self.scene.centre_m
        aims = _aim(active, corners, points, self.coc.focus).reshape(-1, 2)
        directions = (aims @ pose.rotation[:2] + pose.rotation[2]).astype(np.float32)
        on_lens = (eye + points[:, :2] @ pose.rotation[:2]).astype(np.float32)
        origins = np.tile(on_lens, (len(active), 1))
        hit = self.scene.triangles.first_hits(origins, directions)
        met = np.flatnonzero(hit["primID"] >= 0)
        # directions have z = 1: distance along the axis
        z = np.asarray(hit["tfar"], float)[met]
        world = origins[met] + z[:, None] * directions[met] - eye
        place = self.camera.project(world @ pose.rotation.T) - [
            now.rect.x0,
            now.rect.y0,
        ]
        picture = tuple(
            packed(now[name]) for name in (Layer.VIRTUAL, Layer.COVERAGE, Layer.DEPTH)
        )
        opaque = np.zeros(len(origins))
        opaque[met] = _look_up(
            sums, active[met // n], place, z, points[met % n, 2:], picture
        )
        if self.real is not None:
            passing = 1 - opaque.reshape(-1, n)
            passing -= passing.mean(1, keepdims=True)
            mixed = np.flatnonzero(passing.any(1))
            rays = directions.reshape(-1, n, 3)[mixed] @ pose.rotation.T
            behind = passing[mixed][..., None] * self._behind(rays, points, self.real)
            sums[active[mixed], 8:11] += behind.sum(1)
            sums[active[mixed], 11] += n * behind.var(1).max(1)

    def _behind(self, rays: ndarray, points: ndarray, real: Real) -> ndarray:
        """Colours (k, n, 3) of the real scene that rays (k, n, 3), in the camera's axes, would
        meet."""
        form, lens = real.base.forms[2], points[:, :2]
        dioptre = np.maximum(
            divide(rays @ form, 1 - lens @ form[:2]), real.background
        )
        seen = rays + dioptre[..., None] * np.pad(lens, ((0, 0), (0, 1)))
        corner = np.array([self.now.rect.x0, self.now.rect.y0])
        place = self.camera.project(seen) - corner - (points[:, 2:] - 0.5)
        h, w = self.sharp.shape[:2]
        nearest = np.rint(np.where(np.isfinite(place), place, 0.0)).astype(int)
        return self.sharp[
            nearest[..., 1].clip(0, h - 1), nearest[..., 0].clip(0, w - 1)
        ]


def _aim(
    active: ndarray,
    corners: ndarray,
    points: ndarray,
    focus: float,
) -> ndarray:
    """(pixels, points, 2) directions, z = 1. corners : (h + 1, w + 1, 2) those of the pixels'
    corners"""
    y, x = np.divmod(active, corners.shape[1] - 1)
    a, b, c, d = (corners[y + j, x + i, None] for j in (0, 1) for i in (0, 1))
    s, t = points[:, 2:3], points[:, 3:4]
    above, below = a + (b - a) * s, c + (d - c) * s
    return np.asarray(above + (below - above) * t - focus * points[:, :2])


@kernel()
def _look_up(sums, pixel, place, z, within, picture):  # pragma: no cover - compiled
    """Add points met to sums (n, 8 and more): number that is opaque, and of those that the pinhole
    picture shows, colour, its squares.

    place (m, 2) px, z (m,) metres : of the points;  within (m, 2) : where in its pixel the ray
    begins.
    The picture is an average over pixels already, so it is asked at the place that belongs to a ray
    from the pixel's middle. Returns (m,), 1 where a point is opaque."""
    virtual, coverage, depth = picture
    opaque = np.ones(len(pixel))
    h, w = coverage.shape
    for i in range(len(pixel)):
        u, v, to = place[i, 0], place[i, 1], sums[pixel[i]]
        if not (np.isfinite(u) and np.isfinite(v)):
            to[0] += 1
            continue
        if 0 <= u <= w - 1 and 0 <= v <= h - 1:
            around = coverage[int(v) : int(v) + 2, int(u) : int(u) + 2]
            if around.max() < _HOLE:
                opaque[i] = 0
                continue
        to[0] += 1
        for shift in (1.0, 0.0):
            x = int(np.rint(u - shift * (within[i, 0] - 0.5)))
            y = int(np.rint(v - shift * (within[i, 1] - 0.5)))
            inside = 0 <= x < w and 0 <= y < h
            if (
                inside
                and coverage[y, x] > 0
                and abs(depth[y, x] - z[i]) < 0.02 * z[i]
            ):
                to[1] += 1
                for c in range(3):
                    value = virtual[y, x, c] / coverage[y, x]
                    to[2 + c] += value
                    to[5 + c] += value * value
                break
    return opaque
