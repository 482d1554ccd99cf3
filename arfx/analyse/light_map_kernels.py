"""The compiled part of light_map.py, and of the frames' brightness in lighting_room.py: folds over the frames of a clip.

Observations of all frames lie one after the other: normals, irradiance, variance (k, 3), starts (t + 1,) by frame.
The map: vertices, value, variance (v, 3), age_s (v,).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

UNKNOWN = 1e12  # variance of what no observation has reached
NEVER_S = 1e9  # age of a vertex that none has reached
REACH = 1e-6  # weight below which an observation does not count
SEEN = 0.5  # weight from which a vertex counts as seen, for its age
STEADY, STEP, STRAY = 0, 1, 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def wait(value, variance, age_s, seconds, drift_per_s, step):  # pragma: no cover - compiled
    """Time passes. drift_per_s < 0 : the variance stays (formula "paper");  step : the light has changed at once"""
    for i in range(len(age_s)):
        age_s[i] = min(age_s[i] + abs(seconds), NEVER_S)
    if drift_per_s < 0:
        return
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
def add(vertices, value, variance, age_s, normals, x, v, first, last, blur_rad, paper):  # pragma: no cover - compiled
    """Observations first..last-1, one after the other; how many of them do not count."""
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
            if not paper and cosine <= least:
                continue
            cosine = min(max(cosine, -1.0), 1.0)
            theta = np.arccos(cosine)
            f = np.exp(-theta * sharp) if paper else np.exp(-theta * theta * sharp)
            if f > SEEN:
                age_s[i] = 0.0
            if paper:
                for c in range(3):
                    value[i, c] += f * (x[k, c] - value[i, c])
                    variance[i, c] = min(variance[i, c], v[k, c] / (f * f)) if f > 1e-150 else variance[i, c]
                continue
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
def _contradiction(value, variance, corners, weights, normals, x, v, first, last, sigma, share):  # pragma: no cover - compiled
    """-1 or 1: darker or brighter than the map beyond its and the frame's uncertainty; 0: neither, or nothing known.

    corners, weights (k, 3) : of the map's triangle that holds each observation's normal
    """
    most = np.empty(last - first)
    n = 0
    for k in range(first, last):
        fine = np.isfinite(normals[k]).all() and np.isfinite(x[k]).all() and np.isfinite(v[k]).all()
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
    middle = np.median(most[:n])
    return (1 if middle > 0 else -1) if abs(middle) > sigma else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def changes(
    vertices, corners, weights, times_s, starts, normals, x, v, blur_rad, paper, drift_per_s, sigma, share
):  # pragma: no cover - compiled
    """(t,) STEADY, STEP or STRAY: see light_map.changes."""
    frames, count = len(times_s), len(vertices)
    value, variance, age_s = np.zeros((count, 3)), np.full((count, 3), UNKNOWN), np.full(count, NEVER_S)
    kinds = np.zeros(frames, np.int64)
    drift = -1.0 if paper else drift_per_s
    for i in range(frames):
        wait(value, variance, age_s, times_s[i] - times_s[i - 1] if i else 0.0, drift, False)
        a, b = starts[i], starts[i + 1]
        side = _contradiction(value, variance, corners, weights, normals, x, v, a, b, sigma, share)
        if side != 0:
            later = side
            for j in range(i + 1, min(i + 3, frames)):
                if starts[j + 1] > starts[j]:
                    later = _contradiction(
                        value, variance, corners, weights, normals, x, v, starts[j], starts[j + 1], sigma, share
                    )
                    break
            kinds[i] = STEP if later == side else STRAY
            if kinds[i] == STRAY:
                continue
            wait(value, variance, age_s, 0.0, drift, True)
        add(vertices, value, variance, age_s, normals, x, v, a, b, blur_rad, paper)
    return kinds


@numba.njit(cache=True, nogil=True, error_model="numpy")
def walked(times_s, value, variance, begins, order, drift_per_s, mean, spread):  # pragma: no cover - compiled
    """A Kalman filter of a random walk through `order`: mean and spread (n, 3) before each value is taken in.

    value, variance (n, 3), UNKNOWN = not seen;  begins (n,) : the walk begins anew there
    """
    m, s = np.zeros(3), np.full(3, UNKNOWN)
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
