"""The light map M(n): irradiance by normal, on the vertices of an icosphere, folded from observation to observation.

`paper` is eq. (7) and (8) as printed: a weight with a cusp, whose condition excludes nothing. `corrected` weights with the
Gaussian exp(-theta^2 / 2 s^2) where n.n' > 0 and updates by precision: a vertex's variance grows with time, so that light
may change, and never falls below what an observation of another normal can tell (x sin theta / sqrt 3).
Where the clip is known, `smooth` joins a forward and a backward fold. A step of the light (`changes`) cuts both, so that
it is neither foreseen nor smeared; a single frame that disagrees with those before and after is left out.
Source: Tan, Chen, Sun 2010, eq. (7), (8); SYSTEMS.md S1. Cost: about .1 ms per observation at level 3.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from arfx.analyse.icosphere import icosphere
from arfx.core.numerics import arccos, divide

UNKNOWN = 1e12  # variance of a vertex that no observation has reached
NEVER_S = 1e9  # its age
_REACH = 1e-6  # weight below which an observation does not count
_SEEN = 0.5  # weight from which a vertex counts as seen, for its age
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
        known = self.variance < UNKNOWN
        if self.params.formula == "corrected" and known.any():
            level = np.where(known, np.abs(self.value), 0).max(0)
            grown = self.variance + (self.params.drift_per_s**2 * abs(seconds) + (1.0 if step else 0.0)) * level**2
            self.variance = np.where(known, np.minimum(grown, UNKNOWN / 2), UNKNOWN)
        self.age_s = np.minimum(self.age_s + abs(seconds), NEVER_S)

    def add(self, normals: np.ndarray, irradiance: np.ndarray, variance: np.ndarray) -> None:
        """normals, irradiance, variance : (k, 3). One after the other, in their order."""
        rows = (np.asarray(a, float).reshape(-1, 3) for a in (normals, irradiance, variance))
        for n, x, v in zip(*rows, strict=True):
            length = float(np.linalg.norm(n))
            fine = np.isfinite(n).all() and np.isfinite(x).all() and np.isfinite(v).all()
            if not (fine and length > 0 and (v >= 0).all() and (v < UNKNOWN).all()):
                self.ignored += 1
                continue
            c = np.clip(self.sphere.vertices @ (n / length), -1, 1)
            f = weight(c, self.params.blur_rad, self.params.formula)
            self.age_s[f > _SEEN] = 0.0
            if self.params.formula == "paper":
                self.value += f[:, None] * (x - self.value)
                self.variance = np.minimum(self.variance, divide(v, f[:, None] ** 2, where_zero=UNKNOWN))
                continue
            near = f > _REACH
            blind = (1 - c[near, None] ** 2) * x**2 / 3  # what another normal may receive beside x
            noise = v / f[near, None] + blind
            old = self.variance[near]
            first = old >= UNKNOWN
            gain = np.where(first, 1.0, divide(old, old + noise))
            self.value[near] += gain * (x - self.value[near])
            new = np.maximum((1 - gain) * old, np.minimum(old, blind))
            self.variance[near] = np.where(first, noise, new)

    def at(self, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(value (..., 3), variance (..., 3)) at unit normals (..., 3), between the vertices."""
        return self.sphere.interpolate(self.value, normals), self.sphere.interpolate(self.variance, normals)

    def state(self) -> dict:
        """JSON-able, exact."""
        data = np.column_stack([self.value, self.variance, self.age_s])
        return {"data": base64.b64encode(zlib.compress(data.tobytes(), 1)).decode(), "ignored": self.ignored}

    def restore(self, state: dict) -> None:
        data = np.frombuffer(zlib.decompress(base64.b64decode(state["data"]))).reshape(-1, 7)
        self.value, self.variance, self.age_s = data[:, :3].copy(), data[:, 3:6].copy(), data[:, 6].copy()
        self.ignored = state["ignored"]


STEADY, STEP, STRAY = 0, 1, 2


def changes(seen: Sequence[Observation], params: Params = Params()) -> np.ndarray:
    """(t,) per frame STEADY, STEP (the light changed just before it) or STRAY (it disagrees alone, and is to be left out).

    A frame that contradicts the map of those before it begins a step if the next one with observations contradicts that
    map too, to the same side; the last frame is believed.
    """
    light, kinds, last = LightMap(params), np.zeros(len(seen), int), 0.0
    for i, o in enumerate(seen):
        light.wait(o.time_s - last if i else 0.0)
        last = o.time_s
        side = _contradiction(light, o, params)
        if side:
            later = next((_contradiction(light, p, params) for p in seen[i + 1 : i + 3] if len(p.normals)), side)
            kinds[i] = STEP if later == side else STRAY
            if kinds[i] == STRAY:
                continue
            light.wait(0.0, step=True)
        light.add(o.normals, o.irradiance, o.variance)
    return kinds


def _contradiction(light: LightMap, o: Observation, params: Params) -> int:
    """-1 or 1: darker or brighter than the map beyond its and the observation's uncertainty; 0: neither, or nothing known."""
    n, x, v = (np.asarray(a, float).reshape(-1, 3) for a in (o.normals, o.irradiance, o.variance))
    fine = np.isfinite(n).all(1) & np.isfinite(x).all(1) & np.isfinite(v).all(1)
    if not fine.any():
        return 0
    expected, variance = light.at(n[fine])
    sure = (variance < UNKNOWN / 1e3).all(1)
    if not sure.any():
        return 0
    off, size = x[fine][sure] - expected[sure], np.maximum(np.abs(expected[sure]), np.abs(x[fine][sure]))
    z = divide(off, np.sqrt(variance[sure] + np.maximum(v[fine][sure], 0) + 1e-24))
    z = np.where(np.abs(off) > params.step_least * size, z, 0)
    most = z[np.arange(len(z)), np.abs(z).argmax(1)]  # of the channels
    middle = float(np.median(most))
    return int(np.sign(middle)) if abs(middle) > params.step_sigma else 0


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
