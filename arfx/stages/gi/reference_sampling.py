"""Random numbers and directions of the reference's rays, with their densities.

Numbers are keyed by pixel, sample and dimension. Gloss: microfacet normals that the viewer sees (GGX), whose weight never
exceeds 1, unlike those of all normals, which now and then weigh hundreds. A ray in the direction that the surface's own
reflection suggests meets a small lamp once in hundreds, and then counts hundredfold: single pixels far too bright. So bright
parts of the environment and what glows are sampled as well, each sample weighted by its density over the sum of both (balance
heuristic), which leaves the mean as it is.
Source: O'Neill 2014 (PCG); Burley 2020 (scrambled Sobol sequence); Heitz 2014 (Smith's G), 2018 (visible normals); Veach and
Guibas 1995 (multiple importance sampling)."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from types import EllipsisType

import numpy as np

from arfx.core.cube import on_cube, solid_angles
from arfx.core.numerics import divide, normalise
from arfx.stages.gi.reference_kernels import (
    cone_of_ball,
    cosine_about,
    disc_about,
    dots,
    hashed,
    in_frame_of,
    scrambled,
)
from arfx.stages.gi.reference_scene import Hit, RayScene, Surroundings

NEAR = 1.3  # radii: from nearer a ball fills so much that the plane's own directions are better
Reflectance = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
_DEEPER = 100  # dimensions that a place on a path may use
SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
EVEN = 3.0  # an environment whose brightest texel is less than so many times its mean needs no samples of its own
_FLOOR = 0.1  # share of the mean that every texel is chosen with: what lies between texels is never left out
_GREY = np.array([0.2126, 0.7152, 0.0722])


def uniform(pixel: np.ndarray, sample: int, dimension: int, seed: int) -> np.ndarray:
    """Numbers in [0, 1) from pixels (n,) uint32: a hash (PCG output permutation of O'Neill 2014) of all arguments."""
    return np.asarray(hashed(pixel, _mixed(sample, dimension, seed)))


def _mixed(sample: int, dimension: int, seed: int) -> np.uint32:
    return np.uint32(
        (sample * 0x9E3779B1 + dimension * 0x85EBCA77 + seed * 0xC2B2AE3D) & 0xFFFFFFFF
    )


def _reversed_bits(x: int) -> int:
    return int(f"{x & 0xFFFFFFFF:032b}"[::-1], 2)


_SECOND = [1 << 31]  # direction numbers of Sobol's second dimension
for _ in range(31):
    _SECOND.append(_SECOND[-1] ^ _SECOND[-1] >> 1)


class Sampler:
    """Random numbers of some pixels for one sample; every call takes new dimensions."""

    def __init__(self, pixel: np.ndarray, sample: int, seed: int, dimension: int = 0) -> None:
        self.pixel, self.sample, self.seed, self.dimension = pixel, sample, seed, dimension

    def pair(self) -> tuple[np.ndarray, np.ndarray]:
        d = self.dimension
        self.dimension += 2
        return self._sequence(1000) if d == 0 else (self._number(d), self._number(d + 1))

    def single(self) -> np.ndarray:
        self.dimension += 1
        return self._number(self.dimension - 1)

    def pair_for_lights(self) -> tuple[np.ndarray, np.ndarray]:
        """As the first pair of numbers is: spread evenly over the samples of a pixel's own place; later ones are `pair`s."""
        return self.pair() if self.dimension >= _DEEPER else self._sequence(1002)

    def _number(self, dimension: int) -> np.ndarray:
        return uniform(self.pixel, self.sample, dimension, self.seed)

    def _sequence(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """Sobol's first two dimensions, scrambled by numbers of the pixel's own: every 2^k samples from a multiple of that on
        are even."""
        first, second = self.sample & 0xFFFFFFFF, 0
        for k in range(32):
            if self.sample >> k & 1:
                second ^= _SECOND[k]
        low, high = np.uint32(first), np.uint32(_reversed_bits(second))
        x = scrambled(low, self.pixel, _mixed(0, shift, self.seed))
        return x, scrambled(high, self.pixel, _mixed(0, shift + 1, self.seed))

    def of(self, rows: np.ndarray) -> Sampler:
        return Sampler(self.pixel[rows], self.sample, self.seed, self.dimension + _DEEPER)


def tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (n, 3) that make a right-handed frame with the unit normals (n, 3)."""
    u = normalise(
        np.cross(
            np.where(np.abs(normals[:, :1]) > 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]), normals
        )
    )
    return u, np.cross(normals, u)


def in_disc(d: np.ndarray, size_deg: float, draw: Sampler) -> np.ndarray:
    """(n, 3) unit directions to points of a light's disc around d (3,)."""
    return np.asarray(disc_about(d, float(np.tan(np.radians(size_deg / 2))), *draw.pair()))


def cosine_directions(normals: np.ndarray, draw: Sampler) -> np.ndarray:
    """(n, 3) unit, with a density as their cosine to the normals (n, 3)."""
    return np.asarray(cosine_about(np.ascontiguousarray(normals), *draw.pair()))


def cosine_density(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) per steradian of `cosine_directions`."""
    return np.asarray(np.maximum(dots(normals, directions), 0) / np.pi)


def lambertian(normals: np.ndarray) -> Reflectance:
    """What `Tracer.sampled_lights` asks of a white diffuse surface: cosine over pi, both times."""

    def value(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = cosine_density(normals, directions)
        return density[:, None], density

    return value


def towards_ball(
    points: np.ndarray, normals: np.ndarray, centre: np.ndarray, radius: float, draw: Sampler
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(unit directions (n, 3), their density (n,), whether near (n,)) from points (n, 3): even over the cone that holds a ball;
    about the normals (n, 3) as `cosine_directions` where the ball is so near that the cone is wide."""
    found: tuple[np.ndarray, np.ndarray, np.ndarray] = cone_of_ball(
        points, normals, np.append(centre, radius), NEAR, *draw.pair()
    )
    return found


class Gloss:
    """GGX lobes about unit normals n, seen along unit v: rows (k, 3). f0 (k, 3);  roughness (k,) or one"""

    def __init__(
        self, n: np.ndarray, v: np.ndarray, f0: np.ndarray, roughness: np.ndarray | float
    ) -> None:
        self.n, self.f0 = n, f0
        self.a = np.broadcast_to(np.clip(roughness, SMOOTHEST, 1) ** 2, len(n)).astype(float)
        self._u, self._w = tangents(n)
        local = np.stack([(v * self._u).sum(1), (v * self._w).sum(1), (v * n).sum(1)], -1)
        local[:, 2] = np.clip(
            local[:, 2], 1e-4, None
        )  # normals of a mesh may look away from what sees it
        self._v = normalise(local)

    def of(self, rows: np.ndarray) -> Gloss:
        """Some of the lobes."""
        part = copy(self)
        for name, value in vars(self).items():
            setattr(part, name, value[rows])
        return part

    def directions(self, draw: Sampler) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(rows (m,) that leave the surface, unit directions (m, 3), weights (m, 3), densities (m,))."""
        u, w = draw.pair()
        v, a = self._v, self.a[:, None]
        stretched = normalise(np.concatenate([a * v[:, :2], v[:, 2:]], 1))
        flat = np.hypot(stretched[:, 0], stretched[:, 1])
        across = np.stack(
            [
                -divide(stretched[:, 1], flat),
                divide(stretched[:, 0], flat, where_zero=1.0),
                0 * flat,
            ],
            -1,
        )
        across[flat < 1e-9] = [1, 0, 0]
        up = np.cross(stretched, across)
        r, phi = np.sqrt(u), 2 * np.pi * w
        x, y = r * np.cos(phi), r * np.sin(phi)
        s = (1 + stretched[:, 2]) / 2
        y = (1 - s) * np.sqrt(np.clip(1 - x**2, 0, None)) + s * y
        z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
        h = x[:, None] * across + y[:, None] * up + z[:, None] * stretched
        h = normalise(np.concatenate([a * h[:, :2], np.clip(h[:, 2:], 1e-9, None)], 1))
        d = 2 * (v * h).sum(1, keepdims=True) * h - v
        rows = np.flatnonzero(d[:, 2] > 1e-5)
        value, density = self._at(rows, d[rows], h[rows])
        return (
            rows,
            in_frame_of(self.n[rows], *np.ascontiguousarray(d[rows].T)),
            divide(value, density[:, None]),
            density,
        )

    def at(
        self, rows: np.ndarray | EllipsisType, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(reflected share times cosine (m, 3), density (m,)) of unit directions (m, 3); 0 from below. rows (m,), or all"""
        u, w, n = self._u[rows], self._w[rows], self.n[rows]
        d = np.stack(
            [(directions * u).sum(1), (directions * w).sum(1), (directions * n).sum(1)], -1
        )
        value, density = self._at(rows, d, normalise(d + self._v[rows]))
        above = d[:, 2] > 1e-5
        return value * above[:, None], density * above

    def _at(
        self, rows: np.ndarray | EllipsisType, d: np.ndarray, h: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        v, a2 = self._v[rows], self.a[rows] ** 2
        nl, nv, nh = np.clip(d[:, 2], 1e-5, None), v[:, 2], h[:, 2]
        vh = np.clip((v * h).sum(1), 0, 1)
        spread = divide(a2, np.pi * (nh**2 * (a2 - 1) + 1) ** 2)
        seen, lit = np.sqrt(a2 + (1 - a2) * nv**2), np.sqrt(a2 + (1 - a2) * nl**2)
        fresnel = self.f0[rows] + (1 - self.f0[rows]) * ((1 - vh) ** 5)[:, None]
        # D G2 / (4 nv), G2 height-correlated; and D G1(v) / (4 nv)
        value = fresnel * divide(spread * nl, 2 * (nl * seen + nv * lit))[:, None]
        return value, np.asarray(divide(spread, 2 * (nv + seen)))


class Lights:
    """Samples of environment and emitting triangles. bright, glows : whether there is a need for either"""

    def __init__(self, rays: RayScene, surroundings: Surroundings) -> None:
        self._rays, self._surroundings, self._turn, self._size = (
            rays,
            surroundings,
            surroundings.turn,
            surroundings.cube.shape[1],
        )
        grey = np.asarray(surroundings.cube, float) @ _GREY
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
        face, u, v = on_cube(directions @ self._turn.T)
        n = self._size
        column, row = (np.clip(((t + 1) / 2 * n).astype(int), 0, n - 1) for t in (u, v))
        return np.asarray(
            self._chance[(face * n + row) * n + column] * n**2 / 4 * (1 + u**2 + v**2) ** 1.5
        )

    def environment(
        self, directions: np.ndarray, density: np.ndarray | None, rows: np.ndarray, wide: np.ndarray
    ) -> np.ndarray:
        """(m, 3) radiance from directions[rows], weighted as `balance_weight`."""
        weight = balance_weight(density, rows, self.environment_density(directions[rows]))
        return self._surroundings.environment(directions[rows], wide[rows]) * weight

    def to_environment(self, count: int, draw: Sampler) -> tuple[np.ndarray, np.ndarray]:
        """(unit directions (n, 3), density (n,))."""
        x, y = draw.pair_for_lights()
        n = self._size
        texel, x = _pick(self._up_to, x)
        face, row, column = texel // n**2, texel // n % n, texel % n
        u, v = (column + x) / n * 2 - 1, (row + y) / n * 2 - 1
        directions = _cube_directions(face, u, v) @ self._turn
        return directions, self.environment_density(directions)

    def emitter_density(self, hit: Hit, directions: np.ndarray) -> np.ndarray:
        """(n,) per steradian with which `to_emitters` takes what was hit; 0 for what does not glow."""
        facing = np.abs(dots(hit.face_normal, directions))
        return np.where(facing > 1e-6, hit.light_density * divide(hit.distance**2, facing), 0.0)

    def to_emitters(self, points: np.ndarray, draw: Sampler) -> tuple[np.ndarray, np.ndarray]:
        """(unit directions (n, 3), distance (n,)) from points (n, 3) to places on what glows."""
        x, y = draw.pair_for_lights()
        triangle, x = _pick(self._triangle_up_to, x)
        a, b, c = self._rays.corners_of(triangle)
        root = np.sqrt(x)[:, None]
        position = (1 - root) * a + root * (1 - y[:, None]) * b + root * y[:, None] * c
        d = position - points
        distance = np.linalg.norm(d, axis=1)
        return divide(d, distance[:, None]), distance


def balance_weight(density: np.ndarray | None, rows: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(m, 1) weight of samples drawn with `density[rows]`, where `other` (m,) might have drawn them too; 1 for mirrors (None)"""
    if density is None:
        return np.ones((len(other), 1))
    return divide(density[rows], density[rows] + other, where_zero=1.0)[:, None]


def _pick(up_to: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index (n,) into chances whose sums are `up_to`, what is left of x (n,) within it, 0..1)."""
    total = up_to[-1]
    index = np.minimum(np.searchsorted(up_to, x * total, side="right"), len(up_to) - 1)
    below = np.where(index > 0, up_to[index - 1], 0.0)
    return index, np.clip(divide(x * total - below, up_to[index] - below), 0, 1 - 1e-9)


def _cube_directions(face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions of places u, v on the cube's faces; the inverse of core.cube.on_cube."""
    sign = np.where(face % 2 == 0, 1.0, -1.0)
    axis = face // 2
    x, y, z = (np.choose(axis, parts) for parts in ((sign, u, u), (v, sign, v), (-u, -v, sign)))
    d = np.stack([x, y, z], -1)
    return d / np.sqrt(1 + u**2 + v**2)[:, None]
