"""The light map M(n): irradiance by normal, on the vertices of an icosphere, folded from observation to observation.

An observation weighs exp(-theta^2 / 2 s^2) where n.n' > 0, and updates by precision: a vertex's variance grows with time, so that
light may change, and never falls below what an observation of another normal can tell (x sin theta / sqrt 3).
Where the clip is known, `smooth` joins a forward and a backward fold. A step of the light (`changes`) cuts both, so that
it is neither foreseen nor smeared; a single frame that disagrees with those before and after is left out.

To the compiled functions (`walked` folds the frames' brightness, for static_frame.py) observations of all frames lie one
after the other: normals, irradiance, variance (k, 3), starts (t + 1,) by frame. The map: vertices, value, variance (v, 3),
age_s (v,).
Source: Tan, Chen, Sun 2009, eq. (7), (8); docs/methods/light.md#update. Cost: some 5 us per observation at level 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.sorting import sort
from arfx.core.numerics import arccos, divide

UNKNOWN = 1e12  # variance of what no observation has reached
NEVER_S = 1e9  # age of a vertex that none has reached
REACH = 1e-6  # weight below which an observation does not count
SEEN = 0.5  # weight from which a vertex counts as seen, for its age
STEADY, STEP, STRAY = 0, 1, 2


@dataclass(frozen=True)
class Params:
    """level : of the icosphere, 2 to 5;  blur_rad : s of eq. (8)
    drift_per_s : relative change of the light that is expected over one second (grows with the square root of time)
    step_sigma : deviations from which an observation contradicts the map;  step_least : and relative difference"""

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


def weight(cosine: np.ndarray, blur_rad: float) -> np.ndarray:
    """f(n) of eq. (8), with the square, for n.n' = cosine."""
    return np.where(np.asarray(cosine) > 0, np.exp(-(arccos(cosine) ** 2) / (2 * blur_rad**2)), 0.0)


class _Map(NamedTuple):
    """As of `LightMap`; vertices of its icosphere."""

    vertices: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    age_s: np.ndarray


class _Seen(NamedTuple):
    """Observations, (k, 3) each."""

    normals: np.ndarray
    irradiance: np.ndarray
    variance: np.ndarray


class _Triangles(NamedTuple):
    """corners, weights (k, 3) : of the map's triangle that holds each observation's normal"""

    corners: np.ndarray
    weights: np.ndarray


class LightMap:
    """value, variance : (v, 3) per vertex of icosphere(level), variance UNKNOWN where nothing was seen (value 0)
    age_s : (v,) since it was last seen, NEVER_S at first;  ignored : observations that were not finite"""

    def __init__(self, params: Params = Params()) -> None:
        self.params = params
        self.sphere = icosphere(params.level)
        count = len(self.sphere.vertices)
        self.value, self.variance = np.zeros((count, 3)), np.full((count, 3), UNKNOWN)
        self.age_s = np.full(count, NEVER_S)
        self.ignored = 0

    def wait(self, seconds: float, step: bool = False) -> None:
        """Time passes, either way. step : the light has changed at once, and nothing older binds."""
        wait(self._map, float(seconds), self.params.drift_per_s, step)

    def add(self, normals: np.ndarray, irradiance: np.ndarray, variance: np.ndarray) -> None:
        """normals, irradiance, variance : (k, 3). One after the other, in their order."""
        seen = _Seen(*(np.ascontiguousarray(a, float).reshape(-1, 3) for a in (normals, irradiance, variance)))
        self.ignored += add(self._map, seen, 0, len(seen.normals), self.params.blur_rad)

    @property
    def _map(self) -> _Map:
        return _Map(self.sphere.vertices, self.value, self.variance, self.age_s)

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
        _changes(
            sphere.vertices, _Triangles(corners, weights), np.array([o.time_s for o in seen], float), starts, _Seen(n, x, v),
            params.blur_rad, params.drift_per_s, params.step_sigma, params.step_least,
        )
    )  # fmt: skip


def smooth(
    seen: Sequence[Observation], params: Params = Params(), kinds: np.ndarray | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """(value (v, 3), variance (v, 3)) of every frame in turn, from all observations. kinds : `changes`, found if absent.

    Two folds joined by precision: forward through the frame, backward to the one after it. Memory grows with the square
    root of the number of frames.
    """
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def wait(light: _Map, seconds, drift_per_s, step):  # pragma: no cover - compiled
    """Time passes. step : the light has changed at once"""
    _, value, variance, age_s = light
    for i in range(len(age_s)):
        age_s[i] = min(age_s[i] + abs(seconds), NEVER_S)
    growth = drift_per_s**2 * abs(seconds) + (1.0 if step else 0.0)
    for c in range(3):
        level = 0.0
        for i in range(len(value)):
            if variance[i, c] < UNKNOWN:
                level = max(level, abs(value[i, c]))
        for i in range(len(value)):
            if variance[i, c] < UNKNOWN:
                variance[i, c] = min(variance[i, c] + growth * level * level, UNKNOWN / 2)
            else:
                variance[i, c] = UNKNOWN


@numba.njit(cache=True, nogil=True, error_model="numpy")
def usable(n, x, v):  # pragma: no cover - compiled
    """Length of the normal, 0 where the observation does not count."""
    length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    fine = np.isfinite(length)
    for c in range(3):
        fine = fine and np.isfinite(x[c]) and np.isfinite(v[c]) and v[c] >= 0 and v[c] < UNKNOWN
    return length if fine else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add(light: _Map, seen: _Seen, first, last, blur_rad):  # pragma: no cover - compiled
    """Observations first..last-1, one after the other; how many of them do not count."""
    vertices, value, variance, age_s = light
    normals, x, v = seen
    ignored = 0
    sharp = 1 / (2 * blur_rad * blur_rad)
    # beyond this cosine the Gaussian is below REACH
    least = max(np.cos(min(np.sqrt(-np.log(REACH) / sharp), np.pi / 2)), 0.0)
    for k in range(first, last):
        length = usable(normals[k], x[k], v[k])
        if not length > 0:
            ignored += 1
            continue
        nx, ny, nz = normals[k, 0] / length, normals[k, 1] / length, normals[k, 2] / length
        for i in range(len(vertices)):
            cosine = vertices[i, 0] * nx + vertices[i, 1] * ny + vertices[i, 2] * nz
            if cosine <= least:
                continue
            cosine = min(max(cosine, -1.0), 1.0)
            theta = np.arccos(cosine)
            f = np.exp(-theta * theta * sharp)
            if f > SEEN:
                age_s[i] = 0.0
            if f <= REACH:
                continue
            for c in range(3):
                blind = (1 - cosine * cosine) * x[k, c] ** 2 / 3  # what another normal may receive beside x
                noise = v[k, c] / f + blind
                old = variance[i, c]
                if old >= UNKNOWN:
                    value[i, c] = x[k, c]
                    variance[i, c] = noise
                    continue
                gain = old / (old + noise) if old + noise > 0 else 0.0
                value[i, c] += gain * (x[k, c] - value[i, c])
                variance[i, c] = max((1 - gain) * old, min(old, blind))
    return ignored


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _contradiction(light: _Map, triangles: _Triangles, seen: _Seen, first, last, sigma, share):  # pragma: no cover - compiled
    """-1 or 1: darker or brighter than the map beyond its and the frame's uncertainty; 0: neither, or nothing known."""
    value, variance, (corners, weights), (normals, x, v) = light.value, light.variance, triangles, seen
    most = np.empty(last - first)
    n = 0
    for k in range(first, last):
        fine = True
        for c in range(3):
            fine = fine and np.isfinite(normals[k, c]) and np.isfinite(x[k, c]) and np.isfinite(v[k, c])
        if not fine:
            continue
        far, sure = 0.0, True
        for c in range(3):
            expected, spread = 0.0, 0.0
            for j in range(3):
                expected += weights[k, j] * value[corners[k, j], c]
                spread += weights[k, j] * variance[corners[k, j], c]
            sure = sure and spread < UNKNOWN / 1e3
            off = x[k, c] - expected
            z = off / np.sqrt(spread + max(v[k, c], 0.0) + 1e-24)
            if abs(off) > share * max(abs(expected), abs(x[k, c])) and abs(z) > abs(far):
                far = z
        if sure:
            most[n] = far
            n += 1
    if n == 0:
        return 0
    sort(most[:n])
    middle = (most[(n - 1) // 2] + most[n // 2]) / 2
    return (1 if middle > 0 else -1) if abs(middle) > sigma else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _changes(
    vertices, triangles: _Triangles, times_s, starts, seen: _Seen, blur_rad, drift_per_s, sigma, share
):  # fmt: skip  # pragma: no cover - compiled
    """(t,) STEADY, STEP or STRAY: see `changes`."""
    frames, count = len(times_s), len(vertices)
    light = _Map(vertices, np.zeros((count, 3)), np.empty((count, 3)), np.empty(count))
    for i in range(count):
        light.age_s[i] = NEVER_S
        for c in range(3):
            light.variance[i, c] = UNKNOWN
    kinds = np.zeros(frames, np.int64)
    for i in range(frames):
        wait(light, times_s[i] - times_s[i - 1] if i else 0.0, drift_per_s, np.bool_(False))
        a, b = starts[i], starts[i + 1]
        side = _contradiction(light, triangles, seen, a, b, sigma, share)
        if side != 0:
            later = side
            for j in range(i + 1, min(i + 3, frames)):
                if starts[j + 1] > starts[j]:
                    later = _contradiction(light, triangles, seen, starts[j], starts[j + 1], sigma, share)
                    break
            kinds[i] = STEP if later == side else STRAY
            if kinds[i] == STRAY:
                continue
            wait(light, 0.0, drift_per_s, np.bool_(True))
        add(light, seen, a, b, blur_rad)
    return kinds


@numba.njit(cache=True, nogil=True, error_model="numpy")
def walked(times_s, value, variance, begins, order, drift_per_s, mean, spread):  # pragma: no cover - compiled
    """A Kalman filter of a random walk through `order`: mean and spread (n, 3) before each value is taken in.

    value, variance (n, 3), UNKNOWN = not seen;  begins (n,) : the walk begins anew there
    """
    m, s = np.zeros(3), np.array([UNKNOWN, UNKNOWN, UNKNOWN])
    for i in range(len(order)):
        k = order[i]
        for c in range(3):
            if begins[k]:
                s[c] = UNKNOWN
            elif i:
                s[c] = min(s[c] + drift_per_s**2 * abs(times_s[k] - times_s[order[i - 1]]) * m[c] * m[c], UNKNOWN)
            mean[k, c], spread[k, c] = m[c], s[c]
            if variance[k, c] < UNKNOWN:
                total = s[c] + variance[k, c]
                gain = s[c] / total if total > 0 else 0.0
                m[c] += gain * (value[k, c] - m[c])
                s[c] = gain * variance[k, c]
