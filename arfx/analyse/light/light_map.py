"""Steps of the light, found with a map of irradiance by normal on the vertices of an
icosphere.

An observation weighs exp(-theta^2 / 2 s^2) where n.n' > 0, and updates by precision: a
vertex's variance grows with time, so that light may change, and never falls below what an
observation of another normal can tell (x sin theta / sqrt 3).

Source: Tan, Chen, Sun 2009, eq. (7), (8); docs/methods/light.md#update. Cost: some 50 us per
reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.light.icosphere import icosphere
from arfx.core.numerics import divide, normalise

UNKNOWN = 1e12  # variance of what no observation has reached
REACH = 1e-6  # weight below which an observation does not count
STEP_SIGMA, STEP_LEAST = (
    5.0,
    0.03,
)  # deviations, and relative difference, from which an observation contradicts the map
STEADY, STEP, OUTLIER = 0, 1, 2
LEVEL = 3  # of the map's icosphere: 8 degrees between directions
BLUR_RAD = 0.2  # s of the update (8)
DRIFT_PER_S = 0.05  # relative change of the light that is expected in one second


@dataclass(frozen=True, eq=False)
class Observation:
    """The readings of one frame.

    normals : (k, 3) unit;  irradiance, variance : (k, 3); what is not finite is left out.
    """

    time_s: float
    normals: np.ndarray
    irradiance: np.ndarray
    variance: np.ndarray

    @property
    def usable(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(unit normals, irradiance, variance) of the readings that are finite and known."""
        n, x, v = normalise(self.normals), self.irradiance, self.variance
        fine = n.any(1) & (np.isfinite(x) & (v >= 0) & (v < UNKNOWN)).all(1)
        return n[fine], x[fine], v[fine]


def changes(seen: Sequence[Observation]) -> np.ndarray:
    """(t,) per frame STEADY, STEP (the light changed just before it) or OUTLIER (it
    disagrees alone, and is to be left out).

    A frame that contradicts the map of those before it begins a step if the next one with
    observations contradicts that map too, to the same side; the last frame is believed."""
    known = LightMap()
    kinds = np.full(len(seen), STEADY)
    for i, now in enumerate(seen):
        known.wait(now.time_s - seen[i - 1].time_s if i else 0.0)
        side = known.contradiction(now)
        if side:
            after = (o for o in seen[i + 1 : i + 3] if len(o.normals))
            later = next(after, now)
            if known.contradiction(later) != side:
                kinds[i] = OUTLIER
                continue
            kinds[i] = STEP
            known.wait(0.0, stepped=True)
        known.add(now)
    return kinds


class LightMap:
    """Irradiance by normal. vertices, value, variance : (v, 3)"""

    def __init__(
        self, vertices: np.ndarray | None = None, blur_rad: float = BLUR_RAD
    ) -> None:
        self.vertices = icosphere(LEVEL).vertices if vertices is None else vertices
        self.value = np.zeros(self.vertices.shape)
        self.variance = np.full(self.vertices.shape, UNKNOWN)
        self.blur_rad = blur_rad

    def wait(self, seconds: float, stepped: bool = False) -> None:
        """Time passes. stepped : the light has changed at once"""
        known = self.variance < UNKNOWN
        level = np.abs(np.where(known, self.value, 0)).max(0)
        growth = DRIFT_PER_S**2 * abs(seconds) + stepped
        later = np.minimum(self.variance + growth * level**2, UNKNOWN / 2)
        self.variance = np.where(known, later, UNKNOWN)

    def add(self, seen: Observation) -> None:
        """One reading after the other; what is not finite, or not known, is left out."""
        for n, x, v in zip(*seen.usable, strict=True):
            cosine = np.clip(self.vertices @ n, -1, 1)
            weight = np.exp(-(np.arccos(cosine) ** 2) / (2 * self.blur_rad**2))
            near = (cosine > 0) & (weight > REACH)
            cosine, weight = cosine[near, None], weight[near, None]
            # what another normal may receive beside this one
            blind = (1 - cosine**2) * x**2 / 3
            noise = v / weight + blind
            old, value = self.variance[near], self.value[near]
            first = old >= UNKNOWN
            gain = np.where(first, 1.0, divide(old, old + noise))
            self.value[near] = value + gain * (x - value)
            sharper = np.maximum((1 - gain) * old, np.minimum(old, blind))
            self.variance[near] = np.where(first, noise, sharper)

    def contradiction(self, seen: Observation) -> int:
        """-1 or 1: darker or brighter than the map beyond its and the frame's uncertainty;
        0: neither, or nothing known.
        """
        n, x, v = seen.usable
        near, share = icosphere(LEVEL).between(n)
        expected = np.einsum("kj,kjc->kc", share, self.value[near])
        spread = np.einsum("kj,kjc->kc", share, self.variance[near])
        off = x - expected
        z = off / np.sqrt(spread + v + 1e-24)
        z[np.abs(off) <= STEP_LEAST * np.maximum(np.abs(expected), np.abs(x))] = 0
        sure = (spread < UNKNOWN / 1e3).all(1)
        if not sure.any():
            return 0
        farthest = np.take_along_axis(z, np.abs(z).argmax(1)[:, None], 1)
        middle = float(np.median(farthest[sure]))
        return int(np.sign(middle)) if abs(middle) > STEP_SIGMA else 0
