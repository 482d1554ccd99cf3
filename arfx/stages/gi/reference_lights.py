"""Small bright things, found on purpose: samples towards bright parts of the environment and towards what glows.

A ray in the direction that the surface's own reflection suggests meets a small lamp once in hundreds, and then it counts
hundredfold: single pixels far too bright. So lights are sampled as well, and each sample weighs what its density is of the
sum of both (balance heuristic), which leaves the mean as it is. Source: Veach and Guibas 1995 (multiple importance sampling).
"""

from __future__ import annotations

import numpy as np

from arfx.core.cube import solid_angles
from arfx.core.numerics import divide
from arfx.stages.gi.reference_draw import Draw
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings

EVEN = 3.0  # an environment whose brightest texel is less than so many times its mean needs no samples of its own
_FLOOR = 0.1  # share of the mean that every texel is chosen with: what lies between texels is never left out
_GREY = np.array([0.2126, 0.7152, 0.0722])


class Lights:
    """Samples of environment and emitting triangles. bright, glows : whether there is a need for either"""

    def __init__(self, rays: RayScene, around: Surroundings) -> None:
        self._rays, self._around = rays, around
        cube, self._turn = around.cube, around.turn
        self._size = cube.shape[1]
        grey = np.asarray(cube, float) @ _GREY
        solid = np.tile(solid_angles(self._size), (6, 1, 1))
        mean = float((grey * solid).sum() / solid.sum())
        self.bright = mean > 0 and float(grey.max()) > EVEN * mean
        # the largest of a texel and its neighbours, as radiance is linear between them
        wide = np.pad(grey, ((0, 0), (1, 1), (1, 1)), mode="edge")
        n = self._size
        most = np.max([wide[:, i : i + n, j : j + n] for i in range(3) for j in range(3)], 0)
        chance = (most + _FLOOR * mean) * solid
        self._chance = divide(chance, chance.sum()).ravel()
        self._up_to = np.cumsum(self._chance)
        self.glows = rays.emits > 0
        self._triangle_up_to = np.cumsum(rays.emitting)

    def environment_density(self, directions: np.ndarray) -> np.ndarray:
        """(n,) per steradian, of unit directions (n, 3), with which `to_environment` takes them; 0 if it is not used."""
        if not self.bright:
            return np.zeros(len(directions))
        face, u, v = self._around.on_cube(directions)
        n = self._size
        column, row = (np.clip(((t + 1) / 2 * n).astype(int), 0, n - 1) for t in (u, v))
        return np.asarray(self._chance[(face * n + row) * n + column] * n**2 / 4 * (1 + u**2 + v**2) ** 1.5)

    def to_environment(self, count: int, draw: Draw) -> tuple[np.ndarray, np.ndarray]:
        """(unit directions (n, 3), density (n,))."""
        x, y = draw.second()
        n = self._size
        texel, x = _chosen(self._up_to, x)
        face, row, column = texel // n**2, texel // n % n, texel % n
        u, v = (column + x) / n * 2 - 1, (row + y) / n * 2 - 1
        directions = _cube_directions(face, u, v) @ self._turn
        return directions, self.environment_density(directions)

    def emitter_density(self, hit: Hit, directions: np.ndarray) -> np.ndarray:
        """(n,) per steradian with which `to_emitters` takes what was hit; 0 for what does not glow."""
        facing = np.abs((hit.face_normal * directions).sum(1))
        with np.errstate(invalid="ignore", over="ignore"):
            away = np.where(hit.met, hit.distance, 0.0) ** 2
        return np.asarray(np.where(facing > 1e-6, hit.chosen * divide(away, facing), 0.0))

    def to_emitters(self, points: np.ndarray, draw: Draw) -> tuple[np.ndarray, np.ndarray]:
        """(unit directions (n, 3), distance (n,)) from points (n, 3) to places on what glows."""
        x, y = draw.second()
        triangle, x = _chosen(self._triangle_up_to, x)
        a, b, c = self._rays.corners_of(triangle)
        root = np.sqrt(x)[:, None]
        place = (1 - root) * a + root * (1 - y[:, None]) * b + root * y[:, None] * c
        d = place - points
        distance = np.linalg.norm(d, axis=1)
        return divide(d, distance[:, None]), distance


def shared(density: np.ndarray | None, other: np.ndarray) -> np.ndarray:
    """(n, 1) weight of a sample drawn with `density`, where `other` might have drawn it too; 1 for a mirror's (None)."""
    if density is None:
        return np.ones((len(other), 1))
    return np.asarray(divide(density, density + other, where_zero=1.0))[:, None]


def _chosen(up_to: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index (n,) into chances whose sums are `up_to`, what is left of x (n,) within it, 0..1)."""
    total = up_to[-1]
    index = np.minimum(np.searchsorted(up_to, x * total, side="right"), len(up_to) - 1)
    below = np.where(index > 0, up_to[index - 1], 0.0)
    return index, np.clip(divide(x * total - below, up_to[index] - below), 0, 1 - 1e-9)


def _cube_directions(face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions of places u, v on the cube's faces; as core.cube.face_directions."""
    one = np.ones(len(face))
    sign = np.where(face % 2 == 0, 1.0, -1.0)
    axis = face // 2
    x, y, z = (np.choose(axis, parts) for parts in ((sign, u, u), (v, sign, v), (-u, -v, sign)))
    d = np.stack([x, y, z], -1)
    return np.asarray(d / np.sqrt(one + u**2 + v**2)[:, None])
