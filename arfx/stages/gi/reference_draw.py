"""Random numbers and directions of the reference's rays, with their densities.

Numbers are keyed by pixel, sample and dimension. Gloss: microfacet normals that the viewer sees (GGX), whose weight never
exceeds 1, unlike those of all normals, which now and then weigh hundreds.
Source: O'Neill 2014 (PCG); Cranley and Patterson 1976; Heitz 2014 (Smith's G), 2018 (visible normals).
"""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import divide, normalise

_DEEPER = 100  # dimensions that a place on a path may use
SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror


def uniform(pixel: np.ndarray, sample: int, dimension: int, seed: int) -> np.ndarray:
    """Numbers in [0, 1) from pixels (n,) uint32: a hash (PCG output permutation of O'Neill 2014) of all arguments."""
    with np.errstate(over="ignore"):
        mix = np.uint32((sample * 0x9E3779B1 + dimension * 0x85EBCA77 + seed * 0xC2B2AE3D) & 0xFFFFFFFF)
        s = (pixel.astype(np.uint32) ^ mix) * np.uint32(747796405) + np.uint32(2891336453)
        s = ((s >> ((s >> np.uint32(28)) + np.uint32(4))) ^ s) * np.uint32(277803737)
        s = (s >> np.uint32(22)) ^ s
        s = (s ^ mix) * np.uint32(747796405) + np.uint32(2891336453)
        s = ((s >> ((s >> np.uint32(28)) + np.uint32(4))) ^ s) * np.uint32(277803737)
        s = (s >> np.uint32(22)) ^ s
    return np.asarray(s / 4294967296.0)


class Draw:
    """Random numbers of some pixels for one sample; every call takes new dimensions. strata : of the first pair"""

    def __init__(self, pixel: np.ndarray, sample: int, samples: int, seed: int, dimension: int = 0) -> None:
        self.pixel, self.sample, self.samples, self.seed, self.dimension = pixel, sample, samples, seed, dimension

    def pair(self) -> tuple[np.ndarray, np.ndarray]:
        d = self.dimension
        self.dimension += 2
        if d:
            return uniform(self.pixel, self.sample, d, self.seed), uniform(self.pixel, self.sample, d + 1, self.seed)
        return self._lattice(1000)

    def second(self) -> tuple[np.ndarray, np.ndarray]:
        """As the first pair of numbers is: spread evenly over the samples of a pixel's own place; later ones are `pair`s."""
        if self.dimension >= _DEEPER:
            return self.pair()
        return self._lattice(1002)

    def _lattice(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        # Fibonacci lattice, shifted by a number of the pixel's own (Cranley and Patterson)
        u = (self.sample + 0.5) / self.samples + uniform(self.pixel, 0, shift, self.seed)
        v = self.sample * 0.6180339887498949 + uniform(self.pixel, 0, shift + 1, self.seed)
        return u % 1, v % 1

    def of(self, rows: np.ndarray) -> Draw:
        return Draw(self.pixel[rows], self.sample, self.samples, self.seed, self.dimension + _DEEPER)


def about(normals: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n, 3) x, y, z (n,) in a frame whose z is the unit normal (n, 3)."""
    side = np.where(np.abs(normals[:, :1]) > 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    u = normalise(np.cross(side, normals))
    v = np.cross(normals, u)
    return np.asarray(x[:, None] * u + y[:, None] * v + z[:, None] * normals)


def cosine_directions(normals: np.ndarray, draw: Draw) -> np.ndarray:
    """(n, 3) unit, with a density as their cosine to the normals (n, 3)."""
    u, v = draw.pair()
    r, phi = np.sqrt(u), 2 * np.pi * v
    return about(normals, r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u))


class Gloss:
    """GGX lobes about unit normals n, seen along unit v: rows (k, 3). f0 (k, 3);  roughness (k,) or one"""

    def __init__(self, n: np.ndarray, v: np.ndarray, f0: np.ndarray, roughness: np.ndarray | float) -> None:
        self.n, self.f0 = n, f0
        self.a = np.broadcast_to(np.clip(roughness, SMOOTHEST, 1) ** 2, len(n)).astype(float)
        side = np.where(np.abs(n[:, :1]) > 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
        self._u = normalise(np.cross(side, n))
        self._w = np.cross(n, self._u)
        local = np.stack([(v * self._u).sum(1), (v * self._w).sum(1), (v * n).sum(1)], -1)
        local[:, 2] = np.clip(local[:, 2], 1e-4, None)  # normals of a mesh may look away from what sees it
        self._v = normalise(local)

    def directions(self, draw: Draw) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(rows (m,) that leave the surface, unit directions (m, 3), weights (m, 3), densities (m,))."""
        u, w = draw.pair()
        v, a = self._v, self.a[:, None]
        stretched = normalise(np.concatenate([a * v[:, :2], v[:, 2:]], 1))
        flat = np.hypot(stretched[:, 0], stretched[:, 1])
        across = np.stack([-divide(stretched[:, 1], flat), divide(stretched[:, 0], flat, where_zero=1.0), 0 * flat], -1)
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
        return rows, self._turned(rows, d[rows]), divide(value, density[:, None]), density

    def at(self, rows: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(reflected share times cosine (m, 3), density (m,)) for lobes `rows` (m,) and unit directions (m, 3); 0 from below."""
        u, w, n = self._u[rows], self._w[rows], self.n[rows]
        d = np.stack([(directions * u).sum(1), (directions * w).sum(1), (directions * n).sum(1)], -1)
        value, density = self._at(rows, d, normalise(d + self._v[rows]))
        above = d[:, 2] > 1e-5
        return value * above[:, None], density * above

    def _at(self, rows: np.ndarray, d: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, a2 = self._v[rows], self.a[rows] ** 2
        nl, nv, nh = np.clip(d[:, 2], 1e-5, None), v[:, 2], h[:, 2]
        vh = np.clip((v * h).sum(1), 0, 1)
        spread = divide(a2, np.pi * (nh**2 * (a2 - 1) + 1) ** 2)
        seen, lit = np.sqrt(a2 + (1 - a2) * nv**2), np.sqrt(a2 + (1 - a2) * nl**2)
        fresnel = self.f0[rows] + (1 - self.f0[rows]) * ((1 - vh) ** 5)[:, None]
        # D G2 / (4 nv), G2 height-correlated; and D G1(v) / (4 nv)
        value = fresnel * divide(spread * nl, 2 * (nl * seen + nv * lit))[:, None]
        return value, np.asarray(divide(spread, 2 * (nv + seen)))

    def _turned(self, rows: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.asarray(d[:, :1] * self._u[rows] + d[:, 1:2] * self._w[rows] + d[:, 2:] * self.n[rows])
