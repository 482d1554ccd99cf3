"""What the reference's rays meet: the model's triangles (embree), the real planes with the picture, the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from arfx.core.cube import face_directions, solid_angles
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide, normalise
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.gi.reference_kernels import (
    Surfaces,
    cube_radiance,
    first_plane,
    picture_or,
    surface_at,
)
from arfx.stages.gi.surroundings import irradiance
from arfx.stages.light.planes import ENDLESS, Planes
from arfx.stages.triangles import Triangles, model_triangles

IRRADIANCE_PX = 16  # of a face, for the end of a path


class Met(NamedTuple):
    """What rays (n,) meet first. distance : inf where nothing is;  triangle : any where nothing is;  u, v : on it"""

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray


@dataclass(frozen=True, eq=False)
class Hit:
    """met (n,);  distance (n,);  position, normal (n, 3);  diffuse, specular, emission (n, 3) of the surface
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
            np.array(v, float)
            for v in zip(
                *((m.metallic, 0.08 * m.specular * (1 - m.metallic)) for m in materials),
                strict=True,
            )
        )
        of = self.part_of
        colours = np.broadcast_to(
            np.array([m.base_colour[:3] for m in materials], float)[of][:, None], (len(of), 3, 3)
        ).copy()
        for k, part in enumerate(self.parts):
            if part.colours is not None:
                rows = np.flatnonzero(of == k)
                colours[rows] *= part.colours[part.faces[self.face_of[rows]]][..., :3]
        shares = np.stack([(1 - metal) * (1 - f0), f0, metal], 1)[of]
        emission = np.array([m.emissive for m in materials], float)[of]
        self.surfaces = Surfaces(
            self._normals,
            colours,
            shares,
            emission,
            self._face_normal,
            self._light_density,
            *self._textures(),
        )

    def _textures(self) -> tuple[np.ndarray, ...]:
        """uv, base, glow, table, texels of `Surfaces`."""
        uv, used = np.zeros((len(self.part_of), 3, 2)), np.full((2, len(self.part_of)), -1)
        table: list[tuple[int, int, int]] = []
        texels, count = [np.zeros((0, 3), np.uint8)], 0
        for k, part in enumerate(self.parts):
            for which, texture in enumerate(
                (part.material.base_texture, part.material.emissive_texture)
            ):
                laid = None if texture is None else part.uv_on(texture)
                if texture is None or laid is None:
                    continue
                rows = np.flatnonzero(self.part_of == k)
                uv[rows] = laid[part.faces[self.face_of[rows]]]
                used[which, rows] = len(table)
                height, width = texture.picture.shape[:2]
                table.append((count, width, height))
                texels.append(texture.picture[..., :3].reshape(-1, 3))
                count += len(texels[-1])
        return uv, used[0], used[1], np.array(table, int).reshape(-1, 3), np.concatenate(texels)

    def corners_of(self, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        c = self._corners[triangle]
        return c[:, 0], c[:, 1], c[:, 2]

    def nearest(self, origins: np.ndarray, directions: np.ndarray) -> Met:
        found = self._triangles.first_hits(origins, directions)
        triangle = np.asarray(found["primID"]).astype(np.int64)
        distance = np.where(triangle >= 0, np.asarray(found["tfar"], float), np.inf)
        return Met(distance, triangle, np.asarray(found["u"]), np.asarray(found["v"]))

    def first(self, origins: np.ndarray, directions: np.ndarray) -> Hit:
        """Of every ray; zeros where it meets nothing."""
        met = self.nearest(origins, directions)
        rows = np.flatnonzero(np.isfinite(met.distance))
        every = []
        for part in vars(self.hit(met, rows, origins, directions)).values():
            every.append(np.zeros((len(origins), *part.shape[1:]), part.dtype))
            every[-1][rows] = part
        hit = Hit(*every)
        hit.distance[~hit.met] = np.inf
        return hit

    def hit(self, met: Met, rows: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> Hit:
        """Where the rays `rows` (m,) of those (n, 3) met something."""
        distance, d = met.distance[rows], directions[rows]
        surface = surface_at(self.surfaces, met.triangle[rows], met.u[rows], met.v[rows])
        return Hit(
            np.ones(len(rows), bool), distance, origins[rows] + distance[:, None] * d, *surface
        )


class Surroundings:
    """Planes and environment, anchor axes."""

    def __init__(
        self,
        now: Layers,
        seen: Rect,
        scene: Scene,
        facts: FrameFacts,
        cubes: tuple[np.ndarray, np.ndarray],
        planes: Planes,
        radius_m: float,
    ) -> None:
        self.axes, self._bounds = planes.axes.astype(float), planes.bounds.astype(float)
        self._endless = np.abs(self._bounds).min(1) >= ENDLESS
        self.narrow, cube = (np.ascontiguousarray(c, float) for c in cubes)
        self.cube, self.turn = cube, np.ascontiguousarray(scene.world_from_anchor.rotation, float)
        self._camera, self._pose = scene.camera, facts.pose @ scene.world_from_anchor
        self._eye = self._pose.inverse().translation_m
        inside = seen.clip(now.rect)
        self._at, plate = inside, now[Layer.PLATE]
        self._plate = np.clip(
            plate[inside.slices_in(now.rect)] - np.array(facts.bias_rgb, np.float32), 0, None
        )
        grid = np.linspace(-3, 3, 25) * radius_m
        u, v = (a.ravel()[:, None] for a in np.meshgrid(grid, grid))
        self._means = np.tile(0.4 * irradiance(cube, self.turn[:, 2]), (len(self.axes), 1))
        for k, axes in enumerate(self.axes):
            sampled, known = self._picture_or(
                axes[0] + u * axes[1] + v * axes[2], np.full(len(u), k), np.zeros((len(u), 3))
            )
            self._means[k] = sampled[known].mean(0) if known.any() else self._means[0]
        part = max(
            cube.shape[1] // IRRADIANCE_PX, 1
        )  # irradiance is smooth: a cube of few texels gives the same
        size = cube.shape[1] // part
        coarse = (
            cube[:, : size * part, : size * part].reshape(6, size, part, size, part, 3).mean((2, 4))
        )
        d, solid = face_directions(size).reshape(-1, 3), np.tile(solid_angles(size).ravel(), 6)
        below = (d @ self.turn[:, 2] < 0)[:, None]
        flat = np.where(below, self._means[0], coarse.reshape(-1, 3))
        facing = np.clip(face_directions(IRRADIANCE_PX).reshape(-1, 3) @ d.T, 0, None)
        self._irradiance = divide(
            facing @ (flat * solid[:, None]), (facing @ solid)[:, None]
        ).reshape(6, IRRADIANCE_PX, IRRADIANCE_PX, 3)

    def first_plane(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(plane (n,), -1 = none; distance (n,), inf) of the nearest plane met from its front."""
        o, d = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        found: tuple[np.ndarray, np.ndarray] = first_plane(
            self.axes, self._bounds, self._endless, o, d
        )
        return found

    def picture(self, positions: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """(n, 3) radiance of the planes as the picture shows them; each one's mean where it does not."""
        return self._picture_or(positions, plane, self._means[plane])[0]

    def _picture_or(
        self, positions: np.ndarray, plane: np.ndarray, means: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        at = self._camera.project(self._pose.apply(positions))
        front = ((self._eye - self.axes[:, 0]) * self.axes[:, 3]).sum(-1) > 0
        found: tuple[np.ndarray, np.ndarray] = picture_or(
            self._plate, at, np.array([self._at.x0, self._at.y0]), front[plane], means
        )
        return found

    def environment(self, directions: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """(n, 3) radiance in directions (n, 3), anchor axes. wide (n,) : 0 as a mirror sees it, 1 as a matt surface does"""
        return np.asarray(cube_radiance(self.narrow, self.cube, self.turn, directions, wide))

    def unoccluded_irradiance(self, normals: np.ndarray) -> np.ndarray:
        """(n, 3) what a white surface gets from all around with nothing in the way: the end of a path."""
        return np.asarray(
            cube_radiance(
                self._irradiance, self._irradiance, self.turn, normals, np.ones(len(normals))
            )
        )
