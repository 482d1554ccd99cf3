"""Steps of the light, found with a map of irradiance by normal on the vertices of an
icosphere, and brightness over time.

An observation weighs exp(-theta^2 / 2 s^2) where n.n' > 0, and updates by precision: a
vertex's variance grows with time, so that light may change, and never falls below what an
observation of another normal can tell (x sin theta / sqrt 3).

To the compiled functions observations of all frames lie one after the other: normals,
irradiance, variance (k, 3), starts (t + 1,) by frame. The map: vertices, value, variance
(v, 3).
Source: Tan, Chen, Sun 2009, eq. (7), (8); docs/methods/light.md#update. Cost: some 5 us per
observation at level 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.pose.kernels import sort

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


def changes(seen: Sequence[Observation]) -> np.ndarray:
    """(t,) per frame STEADY, STEP (the light changed just before it) or OUTLIER (it
    disagrees alone, and is to be left out).

    A frame that contradicts the map of those before it begins a step if the next one with
    observations contradicts that map too, to the same side; the last frame is believed."""
    if not len(seen):
        return np.zeros(0, int)
    sphere = icosphere(LEVEL)
    n, x, v = (
        np.concatenate([np.asarray(a, float).reshape(-1, 3) for a in column])
        for column in zip(
            *((o.normals, o.irradiance, o.variance) for o in seen), strict=True
        )
    )
    starts = np.cumsum([0, *(np.size(o.normals) // 3 for o in seen)])
    face, weights = sphere.locate(np.where(np.isfinite(n), n, 0))
    corners = sphere.faces[np.maximum(face, 0)]
    times = np.array([o.time_s for o in seen], float)
    return _changes(
        sphere.vertices, corners, weights, times, starts, n, x, v, BLUR_RAD, DRIFT_PER_S
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def wait(value, variance, seconds, drift_per_s, step):  # pragma: no cover - compiled
    """Time passes. step : the light has changed at once"""
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
        fine = (
            fine
            and np.isfinite(x[c])
            and np.isfinite(v[c])
            and v[c] >= 0
            and v[c] < UNKNOWN
        )
    return length if fine else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add(
    vertices, value, variance, normals, x, v, first, last, blur_rad
):  # pragma: no cover - compiled
    """Observations first..last-1, one after the other."""
    sharp = 1 / (2 * blur_rad * blur_rad)
    # beyond this cosine the Gaussian is below REACH
    least = max(np.cos(min(np.sqrt(-np.log(REACH) / sharp), np.pi / 2)), 0.0)
    for k in range(first, last):
        length = usable(normals[k], x[k], v[k])
        if not length > 0:
            continue
        nx, ny, nz = normals[k, 0] / length, normals[k, 1] / length, normals[k, 2] / length
        for i in range(len(vertices)):
            cosine = vertices[i, 0] * nx + vertices[i, 1] * ny + vertices[i, 2] * nz
            if cosine <= least:
                continue
            cosine = min(max(cosine, -1.0), 1.0)
            theta = np.arccos(cosine)
            f = np.exp(-theta * theta * sharp)
            if f <= REACH:
                continue
            for c in range(3):
                blind = (
                    (1 - cosine * cosine) * x[k, c] ** 2 / 3
                )  # what another normal may receive beside x
                noise = v[k, c] / f + blind
                old = variance[i, c]
                if old >= UNKNOWN:
                    value[i, c] = x[k, c]
                    variance[i, c] = noise
                    continue
                gain = old / (old + noise) if old + noise > 0 else 0.0
                value[i, c] += gain * (x[k, c] - value[i, c])
                variance[i, c] = max((1 - gain) * old, min(old, blind))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _contradiction(
    value, variance, corners, weights, normals, x, v, first, last
):  # pragma: no cover - compiled
    """-1 or 1: darker or brighter than the map beyond its and the frame's uncertainty; 0:
    neither, or nothing known.

    corners, weights (k, 3) : of the map's triangle that holds each observation's normal"""
    most = np.empty(last - first)
    n = 0
    for k in range(first, last):
        fine = True
        for c in range(3):
            fine = (
                fine
                and np.isfinite(normals[k, c])
                and np.isfinite(x[k, c])
                and np.isfinite(v[k, c])
            )
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
            if abs(off) > STEP_LEAST * max(abs(expected), abs(x[k, c])) and abs(z) > abs(
                far
            ):
                far = z
        if sure:
            most[n] = far
            n += 1
    if n == 0:
        return 0
    sort(most[:n])
    middle = (most[(n - 1) // 2] + most[n // 2]) / 2
    return (1 if middle > 0 else -1) if abs(middle) > STEP_SIGMA else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _changes(
    vertices, corners, weights, times_s, starts, normals, x, v, blur_rad, drift_per_s
):  # pragma: no cover - compiled
    """(t,) STEADY, STEP or OUTLIER: see `changes`."""
    frames, count = len(times_s), len(vertices)
    value, variance = np.zeros((count, 3)), np.empty((count, 3))
    for i in range(count):
        for c in range(3):
            variance[i, c] = UNKNOWN
    kinds = np.zeros(frames, np.int64)
    for i in range(frames):
        wait(
            value,
            variance,
            times_s[i] - times_s[i - 1] if i else 0.0,
            drift_per_s,
            np.bool_(False),
        )
        a, b = starts[i], starts[i + 1]
        side = _contradiction(value, variance, corners, weights, normals, x, v, a, b)
        if side != 0:
            later = side
            for j in range(i + 1, min(i + 3, frames)):
                if starts[j + 1] > starts[j]:
                    later = _contradiction(
                        value,
                        variance,
                        corners,
                        weights,
                        normals,
                        x,
                        v,
                        starts[j],
                        starts[j + 1],
                    )
                    break
            kinds[i] = STEP if later == side else OUTLIER
            if kinds[i] == OUTLIER:
                continue
            wait(value, variance, 0.0, drift_per_s, np.bool_(True))
        add(vertices, value, variance, normals, x, v, a, b, blur_rad)
    return kinds


@numba.njit(cache=True, nogil=True, error_model="numpy")
def kalman_pass(
    times_s, value, variance, begins, order, drift_per_s, mean, spread
):  # pragma: no cover - compiled
    """A Kalman filter of a random walk through `order`: mean and spread (n, 3) before each
    value is taken in.

    value, variance (n, 3), UNKNOWN = not seen;  begins (n,) : the walk begins anew there"""
    m, s = np.zeros(3), np.array([UNKNOWN, UNKNOWN, UNKNOWN])
    for i in range(len(order)):
        k = order[i]
        for c in range(3):
            if begins[k]:
                s[c] = UNKNOWN
            elif i:
                s[c] = min(
                    s[c]
                    + drift_per_s**2
                    * abs(times_s[k] - times_s[order[i - 1]])
                    * m[c]
                    * m[c],
                    UNKNOWN,
                )
            mean[k, c], spread[k, c] = m[c], s[c]
            if variance[k, c] < UNKNOWN:
                total = s[c] + variance[k, c]
                gain = s[c] / total if total > 0 else 0.0
                m[c] += gain * (value[k, c] - m[c])
                s[c] = gain * variance[k, c]
