"""What the reference's rays meet: the model's triangles (embree), the real planes and the picture
on them.

Axes are the anchor's; positions and directions are (n, 3) float64."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.cube import look_up
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide, normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.gi.reference_sky import Environment
from arfx.stages.light.planes import ENDLESS, SAME_DEPTH, Planes, on_plane
from arfx.stages.light.surfels import texels_of
from arfx.stages.triangles import Triangles, anchor_mesh

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator

UNSEEN_ALBEDO = 0.4  # of a plane that the picture does not show
LIFT = 1e-4  # of the object's size, by which rays start off a surface
AROUND = 3.0  # radii of the object, within which a plane's mean is taken
# along a side of the lattice that stands for a plane's picture: arcsinh of radii of the object
_LATTICE = np.linspace(-4, 4, 41)
LINEAR = np.asarray(SRGB.decode(np.arange(256) / 255), float)  # of a colour's codes


class Met(NamedTuple):
    """What rays (n,) meet first. distance : metres, inf where nothing is
    triangle : -1 where nothing is;  u, v : on it"""

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray

    def of(self, rows: np.ndarray) -> Met:
        return Met(*(values[rows] for values in self))


class Surface(NamedTuple):
    """Places on the model. position, normal, albedo, emission (n, 3)
    metal, f0, roughness (n, 1) : f0 of what is no metal"""

    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    metal: np.ndarray
    f0: np.ndarray
    roughness: np.ndarray

    @property
    def material(self) -> tuple[np.ndarray, ...]:
        """As `MaterialLobes` takes it."""
        return self.albedo, self.metal, self.f0, self.roughness

    @property
    def diffuse(self) -> np.ndarray:
        """(n, 3) share of the light that is scattered evenly."""
        return self.albedo * (1 - self.metal) * (1 - self.f0)

    @property
    def reflectance(self) -> np.ndarray:
        """(n, 3) share of the light that is scattered or mirrored."""
        return self.diffuse + self.f0 + self.albedo * self.metal


class RayScene:
    """The model. lift : metres by which rays start off a surface
    centre (3,), radius : of a ball around it"""

    def __init__(self, scene: Scene) -> None:
        self._mesh = anchor_mesh(scene)
        corners = self._mesh.corners_m + self._mesh.centre_m
        self._triangles = Triangles(corners)
        self.blocked = self._triangles.blocked
        points = corners.reshape(-1, 3)
        low, high = points.min(0), points.max(0)
        self.lift = LIFT * max(float((high - low).max()), 1e-9)
        self.centre = (low + high) / 2
        away = np.linalg.norm(points - self.centre, axis=1)
        self.radius = max(float(away.max()), 1e-6)

    def nearest(self, origins: np.ndarray, directions: np.ndarray) -> Met:
        """What each ray meets first. directions : of any length, by which distances count"""
        hits = self._triangles.first_hits(origins, directions)
        triangle = np.asarray(hits["primID"]).astype(np.int64)
        distance, u, v = (np.asarray(hits[name], float) for name in ("tfar", "u", "v"))
        distance = np.where(triangle >= 0, distance, np.inf)
        return Met(distance, triangle, u, v)

    def surface(self, met: Met, origins: np.ndarray, directions: np.ndarray) -> Surface:
        """Where rays met something; every ray has to."""
        position = origins + met.distance[:, None] * directions
        weights = np.stack([1 - met.u - met.v, met.u, met.v], -1)
        mesh = self._mesh
        corners, part = mesh.faces[met.triangle], mesh.part[met.triangle]
        normal, colours, uv = (
            np.einsum("nk,nkc->nc", weights, rows[corners])
            for rows in (mesh.normals, mesh.colours, mesh.uv)
        )
        of_parts = [
            (*m.base_colour[:3], *m.emissive, m.roughness, m.metallic, m.specular)
            for m in mesh.materials
        ]
        albedo, emission, shine, specular = np.split(np.array(of_parts)[part], (3, 6, 8), 1)
        names = "base_texture", "emissive_texture", "metallic_roughness_texture"
        base, glow, shiny = (texels_of(mesh, name, part, uv)[:, :3] for name in names)
        albedo *= colours[:, :3] * LINEAR[base]
        emission *= LINEAR[glow]
        roughness, metal = np.hsplit(shine * shiny[:, 1:] / 255, 2)
        f0 = 0.08 * specular * (1 - metal)
        return Surface(position, normalise(normal), albedo, emission, metal, f0, roughness)


class Surroundings:
    """Planes and environment. shown : pixels of the picture that may be looked at
    radius_m : of the object"""

    def __init__(
        self,
        now: Layers,
        shown: Rect,
        scene: Scene,
        facts: FrameFacts,
        environment: Environment,
        planes: Planes,
        radius_m: float,
    ) -> None:
        self.environment = environment
        self.axes = planes.axes.astype(float)
        self._bounds = planes.bounds.astype(float)
        self._bounds[np.abs(self._bounds) >= ENDLESS] *= np.inf
        self._camera = scene.camera
        self._camera_from_anchor = facts.pose @ scene.world_from_anchor
        eye = self._camera_from_anchor.inverse().translation_m
        height = (eye - self.axes[:, 0]) * self.axes[:, 3]
        self._in_front = height.sum(-1) > 0
        self._rect = shown.clip(now.rect)
        shown_px = self._rect.slices_in(now.rect)
        plate, self._real_m = now[Layer.PLATE][shown_px], now[Layer.REAL_DEPTH][shown_px]
        self._plate = np.maximum(plate.astype(float) - facts.bias_rgb, 0)
        up = environment.turn[:, 2]
        below = environment.irradiance(np.zeros(3), up)
        guess = UNSEEN_ALBEDO * look_up(below, up[None])
        self._means = np.tile(guess, (len(self.axes), 1))
        self._radius_m = radius_m
        self._beside = []
        for k in range(len(self.axes)):
            places, radiance, known = self._lattice_of(k)
            near = known & (np.abs(places) <= np.arcsinh(AROUND)).all(1)
            self._means[k] = radiance[near].mean(0) if near.any() else self._means[0]
            self._beside.append(_filled(places, radiance, known, self._means[k]))
        self._irradiance = environment.irradiance(self._means[0], up)

    def first_plane(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(plane (n,), -1 = none; distance (n,), inf) of the nearest plane met from its front."""
        distances = self._distances(origins, directions)
        return _chosen(distances, distances.argmin(1))

    def plane_by_distance(
        self, origins: np.ndarray, directions: np.ndarray, measured: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same, of the plane that agrees best with a measured distance (n,); NaN = none."""
        distances = self._distances(origins, directions)
        off = np.abs(distances / measured[:, None] - 1)
        known = np.isfinite(measured)[:, None]
        return _chosen(distances, np.where(known, off, distances).argmin(1))

    def _distances(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n, planes) at which rays meet each plane from its front, inf = not."""
        distances = np.full((len(origins), len(self.axes)), np.inf)
        for k, (origin, x, y, normal) in enumerate(self.axes):
            x0, y0, x1, y1 = self._bounds[k]
            start = origins - origin
            falls = -(directions @ normal)
            height = np.maximum(start @ normal, 0)
            t = np.where(falls > 1e-9, divide(height, falls), 0)
            met = start + t[:, None] * directions
            u, v = met @ x, met @ y
            within = (x0 < u) & (u < x1) & (y0 < v) & (v < y1) & (t > 0)
            distances[within, k] = t[within]
        return distances

    def picture(self, positions: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of the planes as the picture shows them; where it does not, as it is
        around."""
        radiance, known = self._picture(positions, plane)
        for k in np.unique(plane[~known]):
            rows = np.flatnonzero(~known & (plane == k))
            at = np.clip(self._logarithmic(positions[rows], k), _LATTICE[0], _LATTICE[-1])
            radiance[rows] = self._beside[k](at)
        return radiance

    def _logarithmic(self, positions: np.ndarray, plane: int) -> np.ndarray:
        """(n, 2) places on a plane in radii of the object, farther out by their logarithms."""
        origin, x, y, _ = self.axes[plane]
        along = (positions - origin) @ np.stack([x, y], -1)
        return np.asarray(np.arcsinh(along / self._radius_m))

    def _lattice_of(self, plane: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(places (n, 2) as `_logarithmic`, radiance (n, 3), known (n,)) of a plane's lattice; the
        last two as `_picture`."""
        places = np.stack(np.meshgrid(_LATTICE, _LATTICE, indexing="ij"), -1).reshape(-1, 2)
        origin, x, y, _ = self.axes[plane]
        u, v = np.hsplit(np.sinh(places) * self._radius_m, 2)
        return places, *self._picture(origin + u * x + v * y, np.full(len(u), plane))

    def _picture(
        self, positions: np.ndarray, plane: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """((n, 3) radiance, (n,) whether the picture shows it, and no real thing before it):
        linear between pixels."""
        from scipy.ndimage import map_coordinates

        placed = self._camera_from_anchor.apply(positions)
        seen = self._camera.project(placed)
        last = np.array([self._rect.width - 1, self._rect.height - 1])
        at = seen - [self._rect.x0, self._rect.y0]
        with np.errstate(invalid="ignore"):
            known = ((at >= 0) & (at <= last)).all(-1)
        known &= self._in_front[plane]
        column, row = np.rint(at[known].T).astype(int)
        real_m, dioptres = self._real_m[row, column], 1 / placed[known, 2]
        known[known] = on_plane(real_m, dioptres, SAME_DEPTH) == 1
        column, row = at[known].T
        out = np.zeros((len(positions), 3))
        for k in range(3):
            out[known, k] = map_coordinates(self._plate[..., k], (row, column), order=1)
        return out, known

    def unoccluded(self, normals: np.ndarray) -> np.ndarray:
        """(n, 3) what a white surface gets from all around with nothing in the way: the end of a
        path."""
        return look_up(self._irradiance, normals @ self.environment.turn.T)


def _filled(
    places: np.ndarray, radiance: np.ndarray, known: np.ndarray, otherwise: np.ndarray
) -> RegularGridInterpolator:
    """A lattice's radiance between its places. What is not known is the mean of all that is, by the
    inverse cube of the distance: an area as wide as it is far counts; `otherwise` (3,) where
    nothing is."""
    from scipy.interpolate import RegularGridInterpolator
    from scipy.spatial.distance import cdist

    filled = np.where(known[:, None], radiance, otherwise)
    if known.any():
        weight = cdist(places[~known], places[known]) ** -3.0
        filled[~known] = weight @ radiance[known] / weight.sum(1, keepdims=True)
    side = len(_LATTICE)
    return RegularGridInterpolator((_LATTICE, _LATTICE), filled.reshape(side, side, 3))


def _chosen(distances: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(plane (n,), -1 where a ray does not meet it; distance (n,))."""
    distance = np.take_along_axis(distances, plane[:, None], 1)[:, 0]
    return np.where(np.isfinite(distance), plane, -1), distance
