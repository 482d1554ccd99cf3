"""What the reference's rays meet: the model's triangles (embree), the real planes with the picture, the environment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.cube import face_directions, look_up, solid_angles
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide, normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.gi.surroundings import ENDLESS, Planes, irradiance
from arfx.stages.triangles import Triangles, model_triangles

IRRADIANCE_PX = 16  # of a face, for the end of a path


@dataclass(frozen=True, eq=False)
class Hit:
    """met (n,);  distance (n,) inf where nothing is;  place, normal (n, 3);  matt, mirrors, emission (n, 3) of the surface
    face_normal (n, 3) : of the flat triangle, unit;  light_density (n,) : density per square metre of samples on what glows"""

    met: np.ndarray
    distance: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    emission: np.ndarray
    face_normal: np.ndarray
    light_density: np.ndarray

    def of(self, rows: np.ndarray) -> Hit:
        return Hit(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


class RayScene:
    """The model in anchor axes. lift : metres by which rays start off a surface;  emits : sum of what glows, times its area;
    emitting (triangles,) : each one's share of that"""

    def __init__(self, scene: Scene) -> None:
        corners, self._normals, self.part_of, self.face_of = model_triangles(scene)
        self.parts, self._corners = scene.model.parts, corners
        self.lift = 1e-4 * max(float(np.ptp(corners.reshape(-1, 3), axis=0).max()), 1e-9)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._face_normal = normalise(across)
        strength = np.array([max(p.material.emissive) for p in self.parts], float)[self.part_of]
        weight = strength * np.linalg.norm(across, axis=1) / 2
        self.emits = float(weight.sum())
        self.emitting = divide(weight, self.emits)
        self._light_density = divide(strength, self.emits)
        self._triangles = Triangles(corners)
        self.blocked = self._triangles.blocked
        materials = [p.material for p in self.parts]
        metal, f0 = (
            np.array(v, float) for v in zip(*((m.metallic, 0.08 * m.specular * (1 - m.metallic)) for m in materials), strict=True)
        )
        of = self.part_of
        self._matt, self._f0, self._metal = ((1 - metal) * (1 - f0))[of, None], f0[of, None], metal[of, None]
        self._emission = np.array([m.emissive for m in materials], float)[of]
        self._colours = np.broadcast_to(
            np.array([m.base_colour[:3] for m in materials], float)[of][:, None], (len(of), 3, 3)
        ).copy()
        for k, part in enumerate(self.parts):
            if part.colours is not None:
                rows = np.flatnonzero(of == k)
                self._colours[rows] *= part.colours[part.faces[self.face_of[rows]]][..., :3]
        self._textured = [
            k for k, p in enumerate(self.parts)
            if p.uv is not None and (p.material.base_texture is not None or p.material.emissive_texture is not None)
        ]  # fmt: skip

    def corners_of(self, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        c = self._corners[triangle]
        return c[:, 0], c[:, 1], c[:, 2]

    def first_distance(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) metres; inf where nothing is."""
        result = self._triangles.first_hits(origins, directions)
        return np.where(np.asarray(result["primID"]).astype(np.int64) >= 0, np.asarray(result["tfar"], float), np.inf)

    def first(self, origins: np.ndarray, directions: np.ndarray) -> Hit:
        result = self._triangles.first_hits(origins, directions)
        prim = np.asarray(result["primID"]).astype(np.int64)
        met = (prim >= 0) & (np.asarray(result["geomID"]).astype(np.int64) >= 0)
        n = len(origins)
        distance = np.where(met, np.asarray(result["tfar"], float), np.inf)
        z = np.zeros((6, n, 3))
        hit = Hit(met, distance, z[0], z[1], z[2], z[3], z[4], z[5], np.zeros(n))
        rows = np.flatnonzero(met)
        at = prim[rows]
        u, v = np.asarray(result["u"], float)[rows], np.asarray(result["v"], float)[rows]
        w = np.stack([1 - u - v, u, v], -1)[..., None]
        base, glow = (self._colours[at] * w).sum(1), self._emission[at]
        for k in self._textured:
            mine = np.flatnonzero(self.part_of[at] == k)
            part, m = self.parts[k], self.parts[k].material
            assert part.uv is not None
            uv = (part.uv[part.faces[self.face_of[at[mine]]]] * w[mine]).sum(1) % 1
            base[mine] *= _texel(m.base_texture, uv)
            glow[mine] *= _texel(m.emissive_texture, uv)
        hit.face_normal[rows], hit.light_density[rows] = self._face_normal[at], self._light_density[at]
        hit.position[rows] = origins[rows] + distance[rows, None] * directions[rows]
        hit.normal[rows] = normalise((self._normals[at] * w).sum(1))
        hit.diffuse[rows], hit.specular[rows] = base * self._matt[at], self._f0[at] + base * self._metal[at]
        hit.emission[rows] = glow
        return hit


def _texel(texture: np.ndarray | None, uv: np.ndarray) -> np.ndarray | float:
    if texture is None:
        return 1.0
    h, w = texture.shape[:2]
    at = np.minimum((uv[:, 1] * h).astype(int), h - 1), np.minimum((uv[:, 0] * w).astype(int), w - 1)
    return np.asarray(SRGB.decode(texture[at][:, :3] / 255.0))


class Surroundings:
    """Planes and environment, anchor axes."""

    def __init__(
        self, now: Layers, seen: Rect, scene: Scene, facts: FrameFacts, cubes: tuple[np.ndarray, np.ndarray], planes: Planes,
        radius_m: float,
    ) -> None:  # fmt: skip
        self.axes, self._bounds = planes.axes.astype(float), planes.bounds.astype(float)
        (self.narrow, cube), self.turn = cubes, scene.world_from_anchor.rotation
        self.cube = cube
        self._camera, self._pose = scene.camera, facts.pose @ scene.world_from_anchor
        self._eye = self._pose.inverse().translation_m
        inside = seen.clip(now.rect)
        self._at, plate = inside, now[Layer.PLATE]
        self._plate = np.clip(plate[inside.slices_in(now.rect)] - np.array(facts.bias_rgb, np.float32), 0, None)
        grid = np.linspace(-3, 3, 25) * radius_m
        u, v = (a.ravel()[:, None] for a in np.meshgrid(grid, grid))
        self._means = np.tile(0.4 * irradiance(cube, self.turn[:, 2]), (len(self.axes), 1))
        for k, axes in enumerate(self.axes):
            sampled, known = self._picture_at(axes[0] + u * axes[1] + v * axes[2], np.full(len(u), k))
            self._means[k] = sampled[known].mean(0) if known.any() else self._means[0]
        part = max(cube.shape[1] // IRRADIANCE_PX, 1)  # irradiance is smooth: a cube of few texels gives the same
        size = cube.shape[1] // part
        coarse = cube[:, : size * part, : size * part].reshape(6, size, part, size, part, 3).mean((2, 4))
        d, solid = face_directions(size).reshape(-1, 3), np.tile(solid_angles(size).ravel(), 6)
        below = (d @ self.turn[:, 2] < 0)[:, None]
        flat = np.where(below, self._means[0], coarse.reshape(-1, 3))
        facing = np.clip(face_directions(IRRADIANCE_PX).reshape(-1, 3) @ d.T, 0, None)
        self._irradiance = divide(facing @ (flat * solid[:, None]), (facing @ solid)[:, None]).reshape(
            6, IRRADIANCE_PX, IRRADIANCE_PX, 3
        )

    def first_plane(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(plane (n,), -1 = none; distance (n,), inf) of the nearest plane met from its front."""
        plane, distance = np.full(len(origins), -1), np.full(len(origins), np.inf)
        for k, axes in enumerate(self.axes):
            falls = -(directions @ axes[3])
            height = np.clip((origins - axes[0]) @ axes[3], 0, None)
            t = np.where(falls > 1e-9, divide(height, falls, where_zero=np.inf), np.inf)
            with np.errstate(invalid="ignore", over="ignore"):
                at = origins + np.where(np.isfinite(t), t, 0.0)[:, None] * directions - axes[0]
            on = np.stack([at @ axes[1], at @ axes[2]], -1)
            ends = ((on > self._bounds[k, :2]) & (on < self._bounds[k, 2:])).all(-1)
            nearer = (t < distance) & (t > 0) & (ends | (np.abs(self._bounds[k]).min() >= ENDLESS))
            plane, distance = np.where(nearer, k, plane), np.where(nearer, t, distance)
        return plane, distance

    def picture(self, positions: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of the planes as the picture shows them; each one's mean where it does not."""
        seen, known = self._picture_at(positions, plane)
        return np.where(known[:, None], seen, self._means[plane])

    def _picture_at(self, positions: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = self._camera.project(self._pose.apply(positions))
        front = ((self._eye - self.axes[plane, 0]) * self.axes[plane, 3]).sum(-1) > 0
        r = self._at
        with np.errstate(invalid="ignore"):
            known = np.isfinite(at).all(-1) & (at >= [r.x0, r.y0]).all(-1) & (at <= [r.x1 - 1, r.y1 - 1]).all(-1) & front
        out = np.zeros((len(positions), 3))
        x, y = at[known, 0] - r.x0, at[known, 1] - r.y0
        if len(x):
            i, j = np.minimum(x.astype(int), max(r.width - 2, 0)), np.minimum(y.astype(int), max(r.height - 2, 0))
            i1, j1 = np.minimum(i + 1, r.width - 1), np.minimum(j + 1, r.height - 1)
            fx, fy = (x - i)[:, None], (y - j)[:, None]
            p = self._plate
            out[known] = (p[j, i] * (1 - fx) + p[j, i1] * fx) * (1 - fy) + (p[j1, i] * (1 - fx) + p[j1, i1] * fx) * fy
        return out, known

    def environment(self, directions: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """(n, 3) radiance in directions (n, 3), anchor axes. wide (n,) : 0 as a mirror sees it, 1 as a matt surface does"""
        d = directions @ self.turn.T
        far = look_up(self.cube, d)
        if self.narrow is self.cube:
            return far
        near = look_up(self.narrow, d)
        return np.asarray(near + wide[:, None] * (far - near))

    def unoccluded_irradiance(self, normals: np.ndarray) -> np.ndarray:
        """(n, 3) what a white surface gets from all around with nothing in the way: the end of a path."""
        return look_up(self._irradiance, normals @ self.turn.T)
