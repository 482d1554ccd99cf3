"""The light map M(n): irradiance by normal, on the vertices of an icosphere, folded from observation to observation.

`paper` is eq. (7) and (8) as printed: a weight with a cusp, whose condition excludes nothing. `corrected` weights with the
Gaussian exp(-theta^2 / 2 s^2) where n.n' > 0 and updates by precision: a vertex's variance grows with time, so that light
may change, and never falls below what an observation of another normal can tell (x sin theta / sqrt 3).
Where the clip is known, `smooth` joins a forward and a backward fold. A step of the light (`changes`) cuts both, so that
it is neither foreseen nor smeared; a single frame that disagrees with those before and after is left out.
Source: Tan, Chen, Sun 2010, eq. (7), (8); SYSTEMS.md S1. Cost: some 5 us per observation at level 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse import light_map_kernels as kernels
from arfx.analyse.icosphere import icosphere
from arfx.analyse.light_map_kernels import NEVER_S, STEADY, STEP, STRAY, UNKNOWN
from arfx.core.numerics import arccos, divide

__all__ = ["NEVER_S", "STEADY", "STEP", "STRAY", "UNKNOWN", "LightMap", "Observation", "Params", "changes", "smooth", "weight"]
_FORMULAS = ("corrected", "paper")


@dataclass(frozen=True)
class Params:
    """formula : "corrected" or "paper";  level : of the icosphere, 2 to 5;  blur_rad : s of eq. (8)
    drift_per_s : relative change of the light that is expected over one second (grows with the square root of time)
    step_sigma : deviations from which an observation contradicts the map;  step_least : and relative difference"""

    formula: str = "corrected"
    level: int = 3
    blur_rad: float = 0.2
    drift_per_s: float = 0.05
    step_sigma: float = 5.0
    step_least: float = 0.03


@dataclass(frozen=True, eq=False)
class Observation:
    """What one frame tells. normals : (k, 3) unit;  irradiance, variance : (k, 3); what is not finite is left out."""

    time_s: float
    normals: np.ndarray
    irradiance: np.ndarray
    variance: np.ndarray


def weight(cosine: np.ndarray, blur_rad: float, formula: str = "corrected") -> np.ndarray:
    """f(n) of eq. (8) for n.n' = cosine. "paper": without the square and with cos(n.n') > 0, which always holds."""
    theta = arccos(cosine)
    if formula == "paper":
        return np.where(np.cos(cosine) > 0, np.exp(-theta / (2 * blur_rad**2)), 0.0)
    return np.where(np.asarray(cosine) > 0, np.exp(-(theta**2) / (2 * blur_rad**2)), 0.0)


class LightMap:
    """value, variance : (v, 3) per vertex of icosphere(level), variance UNKNOWN where nothing was seen (value 0)
    age_s : (v,) since it was last seen, NEVER_S at first;  ignored : observations that were not finite"""

    def __init__(self, params: Params = Params()) -> None:
        if params.formula not in _FORMULAS:
            raise ValueError(f"light map formula {params.formula!r} is not one of {', '.join(_FORMULAS)}")
        self.params = params
        self.sphere = icosphere(params.level)
        count = len(self.sphere.vertices)
        self.value, self.variance = np.zeros((count, 3)), np.full((count, 3), UNKNOWN)
        self.age_s = np.full(count, NEVER_S)
        self.ignored = 0

    def wait(self, seconds: float, step: bool = False) -> None:
        """Time passes, either way. step : the light has changed at once, and nothing older binds."""
        kernels.wait(self.value, self.variance, self.age_s, float(seconds), self._drift, step)

    def add(self, normals: np.ndarray, irradiance: np.ndarray, variance: np.ndarray) -> None:
        """normals, irradiance, variance : (k, 3). One after the other, in their order."""
        n, x, v = (np.ascontiguousarray(a, float).reshape(-1, 3) for a in (normals, irradiance, variance))
        p = self.params
        self.ignored += kernels.add(
            self.sphere.vertices, self.value, self.variance, self.age_s, n, x, v, 0, len(n), p.blur_rad, p.formula == "paper"
        )

    @property
    def _drift(self) -> float:
        """What makes older values less certain; the paper knows nothing of the kind."""
        return self.params.drift_per_s if self.params.formula == "corrected" else -1.0

    def at(self, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(value (..., 3), variance (..., 3)) at unit normals (..., 3), between the vertices."""
        return self.sphere.interpolate(self.value, normals), self.sphere.interpolate(self.variance, normals)


def changes(seen: Sequence[Observation], params: Params = Params()) -> np.ndarray:
    """(t,) per frame STEADY, STEP (the light changed just before it) or STRAY (it disagrees alone, and is to be left out).

    A frame that contradicts the map of those before it begins a step if the next one with observations contradicts that
    map too, to the same side; the last frame is believed.
    """
    if not len(seen):
        return np.zeros(0, int)
    sphere = icosphere(params.level)
    n, x, v = (
        np.concatenate([np.asarray(a, float).reshape(-1, 3) for a in column])
        for column in zip(*((o.normals, o.irradiance, o.variance) for o in seen), strict=True)
    )
    starts = np.cumsum([0, *(np.size(o.normals) // 3 for o in seen)])
    face, weights = sphere.locate(np.where(np.isfinite(n), n, 0))
    corners = sphere.faces[np.maximum(face, 0)]
    return np.asarray(
        kernels.changes(
            sphere.vertices, corners, weights, np.array([o.time_s for o in seen], float), starts, n, x, v, params.blur_rad,
            params.formula == "paper", params.drift_per_s, params.step_sigma, params.step_least,
        )
    )  # fmt: skip


def smooth(
    seen: Sequence[Observation], params: Params = Params(), kinds: np.ndarray | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """(value (v, 3), variance (v, 3)) of every frame in turn, from all observations. kinds : `changes`, found if absent.

    Two folds joined by precision: forward through the frame, backward to the one after it. Memory grows with the square
    root of the number of frames. With formula "paper" only forward, as printed.
    """
    if params.formula == "paper":
        light = LightMap(params)
        for o in seen:
            light.add(o.normals, o.irradiance, o.variance)
            yield light.value.copy(), light.variance.copy()
        return
    kinds = changes(seen, params) if kinds is None else kinds
    block = max(1, int(np.ceil(np.sqrt(len(seen)))))
    back, kept = LightMap(params), {}
    for i in range(len(seen) - 1, -1, -1):
        if (i + 1) % block == 0:
            kept[i] = (back.value.copy(), back.variance.copy())
        _take(back, seen, kinds, i, -1)
    ahead, behind = LightMap(params), list[tuple[np.ndarray, np.ndarray]]()
    for i in range(len(seen)):
        if i % block == 0:  # the backward maps of this block, again
            back, end = LightMap(params), min(i + block, len(seen)) - 1
            back.value, back.variance = (a.copy() for a in kept.get(end, (back.value, back.variance)))
            behind = []
            for k in range(end, i - 1, -1):
                behind.append((back.value.copy(), back.variance.copy()))
                _take(back, seen, kinds, k, -1)
        _take(ahead, seen, kinds, i, 1)
        value, variance = behind.pop()
        total = ahead.variance + variance
        share = np.where(ahead.variance >= UNKNOWN, 0.0, np.where(variance >= UNKNOWN, 1.0, divide(variance, total)))
        joint = np.where(np.maximum(ahead.variance, variance) >= UNKNOWN, np.minimum(ahead.variance, variance), 0.0)
        joint = np.where(joint > 0, joint, divide(ahead.variance * variance, total))
        yield value + share * (ahead.value - value), joint


def _take(light: LightMap, seen: Sequence[Observation], kinds: np.ndarray, i: int, way: int) -> None:
    """Fold frame i into the map. way 1: time has passed since i - 1; way -1: it passes after, to where i - 1 looks back."""
    before = seen[i].time_s - seen[i - 1].time_s if i else 0.0
    if way > 0:
        light.wait(before, bool(kinds[i] == STEP))
    if kinds[i] != STRAY:
        light.add(seen[i].normals, seen[i].irradiance, seen[i].variance)
    if way < 0:
        light.wait(before, bool(kinds[i] == STEP))
