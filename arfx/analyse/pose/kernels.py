"""Compiled loops of smooth.py, for one chain of small matrices. Float64 throughout.

Every link of a chain has the form [[F, G], [0, 1]] with 3 x 3 blocks for the turns and
constant velocity for the other axes: only those blocks are multiplied."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

DIM = 12
# share of an axis's information below which what the other axes leave of it is rounding
_UNFIXED = 1e-14


class Chain(NamedTuple):
    """Of n states. measured (n, 6, 6), info_vector (n, 6) : as of smooth_chain;  move ...
    dt (n - 1, ...) : of its links
    start : standard deviations of the first state"""

    measured: np.ndarray
    info_vector: np.ndarray
    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    shake: np.ndarray
    dt: np.ndarray
    start: np.ndarray


@numba.njit(cache=True, nogil=True)
def sort(v):  # pragma: no cover - compiled
    """In place (Shell 1959), for some hundred numbers at most; none of them NaN. numpy's
    own sort takes a second to compile.
    """
    gap = 1
    while gap < len(v) // 9:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, len(v)):
            x, j = v[i], i - gap
            while j >= 0 and v[j] > x:
                v[j + gap] = v[j]
                j -= gap
            v[j + gap] = x
        gap //= 3


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve_in_place(a, b):  # pragma: no cover - compiled
    """b becomes a^-1 b for a (n, n), b (n, m); a is used up. Returns log |det a|; a
    singular a leaves NaN.
    """
    n, m = b.shape
    log_det = 0.0
    for c in range(n):
        pivot, size = c, abs(a[c, c])
        for r in range(c + 1, n):
            if abs(a[r, c]) > size:
                pivot, size = r, abs(a[r, c])
        if pivot != c:
            for k in range(c, n):
                a[c, k], a[pivot, k] = a[pivot, k], a[c, k]
            for k in range(m):
                b[c, k], b[pivot, k] = b[pivot, k], b[c, k]
        log_det += np.log(size)
        for r in range(c + 1, n):
            fraction = a[r, c] / a[c, c]
            if fraction != 0.0:
                for k in range(c + 1, n):
                    a[r, k] -= fraction * a[c, k]
                for k in range(m):
                    b[r, k] -= fraction * b[c, k]
    for c in range(n - 1, -1, -1):
        for r in range(c + 1, n):
            fraction = a[c, r]
            for k in range(m):
                b[c, k] -= fraction * b[r, k]
        for k in range(m):
            b[c, k] /= a[c, c]
    return log_det


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _copy_state(x, p, means, covs):  # pragma: no cover - compiled
    """Copy a state; in loops, because slices of arrays take seconds to compile."""
    for i in range(DIM):
        means[i] = x[i]
        for j in range(DIM):
            covs[i, j] = p[i, j]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _predict(x, p, move, gate, shift, shake, q, dt, w, v):  # pragma: no cover - compiled
    """Predict state x (12,) and covariance p (12, 12) over one link, in place; q (7,) densities.

    shake (6, 6) : of the last density;  w (6, 12) : filled with the upper half of move p, p
    being that of before
    v (6, 6) : work space"""
    for i in range(3):
        for j in range(DIM):
            turned = 0.0
            for k in range(3):
                turned += move[i, k] * p[k, j] + move[i, k + 6] * p[k + 6, j]
            w[i, j] = turned
            w[i + 3, j] = p[i + 3, j] + dt * p[i + 9, j]
    for i in range(6):
        for j in range(3):
            turned = 0.0
            for k in range(3):
                turned += w[i, k] * move[j, k] + w[i, k + 6] * move[j, k + 6]
            p[i, j] = turned
            p[i, j + 3] = w[i, j + 3] + dt * w[i, j + 9]
        for j in range(6, DIM):
            p[i, j] = w[i, j]
    for i in range(6):
        for j in range(6):
            noise = q[6] * shake[i, j]
            if i == j:
                noise += q[i]
            p[i + 6, j + 6] += noise * dt
            v[i, j] = noise
    for j in range(6):  # through the gate, which is 1 but for the turns
        a, b, c = v[0, j], v[1, j], v[2, j]
        for i in range(3):
            v[i, j] = gate[i, 0] * a + gate[i, 1] * b + gate[i, 2] * c
    for i in range(6):
        for j in range(6):
            p[i, j + 6] += v[i, j] * dt**2 / 2
        a, b, c = v[i, 0], v[i, 1], v[i, 2]
        for j in range(3):
            p[i, j] += (a * gate[j, 0] + b * gate[j, 1] + c * gate[j, 2]) * dt**3 / 3
        for j in range(3, 6):
            p[i, j] += v[i, j] * dt**3 / 3
    for i in range(6):
        for j in range(6):
            p[j + 6, i] = p[i, j + 6]
    a, b, c = x[0], x[1], x[2]
    for i in range(3):
        turn = move[i, 0] * a + move[i, 1] * b + move[i, 2] * c
        x[i] = turn + move[i, 6] * x[6] + move[i, 7] * x[7] + move[i, 8] * x[8] + shift[i]
        x[i + 3] += dt * x[i + 9] + shift[i + 3]
    for i in range(6, DIM):
        x[i] += shift[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _whitened(measured, info_vector, roots, values):  # pragma: no cover - compiled
    """Measurements as independent ones of unit noise: roots (n, 6, 6) lower triangular,
    values (n, 6), of measured = roots roots^T, info_vector = roots values. Of a direction
    that nothing fixes the column is 0."""
    for f in range(len(measured)):
        m, root = measured[f], roots[f]
        for j in range(6):
            rest, missed = m[j, j], info_vector[f, j]
            for k in range(j):
                rest -= root[j, k] ** 2
                missed -= root[j, k] * values[f, k]
            known = rest > _UNFIXED * m[j, j]
            size = np.sqrt(rest) if known else 1.0
            values[f, j] = missed / size if known else 0.0
            for i in range(6):
                root[i, j] = 0.0
            for i in range(j if known else 6, 6):
                total = m[i, j]
                for k in range(j):
                    total -= root[i, k] * root[j, k]
                root[i, j] = total / size


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _update(x, p, root, value, t):  # pragma: no cover - compiled
    """Take in a frame's measurements one after the other, in place. Returns their log
    evidence, up to a constant.

    One by one nothing is inverted: the errors of rounding stay those of p, however strongly
    its axes are bound together.
    root (6, 6), value (6,) : of `_whitened`;  t (12,) : work space"""
    log = 0.0
    for j in range(6):
        if root[j, j] == 0.0:
            continue
        for i in range(DIM):
            total = 0.0
            for k in range(j, 6):
                total += p[i, k] * root[k, j]
            t[i] = total
        spread, missed = 1.0, value[j]
        for k in range(j, 6):
            spread += root[k, j] * t[k]
            missed -= root[k, j] * x[k]
        log -= 0.5 * (np.log(spread) + missed * missed / spread - value[j] * value[j])
        for i in range(DIM):
            fraction = t[i] / spread
            x[i] += fraction * missed
            for k in range(i + 1):
                p[i, k] -= fraction * t[k]
                p[k, i] = p[i, k]
    return log


@numba.njit(cache=True, nogil=True, error_model="numpy")
def filter_and_smooth(chain: Chain, density, means, covs):  # pragma: no cover - compiled
    """Fill means (n, 12) and covs (n, 12, 12) of every state given all measurements; the
    rest as for smooth_chain.
    """
    measured, info_vector, move, gate, shift, shake, dt, start = chain
    n = len(measured)
    x, p, none = np.zeros(DIM), np.empty((DIM, DIM)), np.zeros(DIM)
    _copy_state(none, start, x, p)
    upper = np.empty((max(n - 1, 0), 6, DIM))
    predicted_x, predicted_p = np.empty((n, DIM)), np.empty((n, DIM, DIM))
    roots, values, v, t = (
        np.empty((n, 6, 6)),
        np.empty((n, 6)),
        np.empty((6, 6)),
        np.empty(DIM),
    )
    _whitened(measured, info_vector, roots, values)
    for k in range(n):
        if k:
            _predict(
                x,
                p,
                move[k - 1],
                gate[k - 1],
                shift[k - 1],
                shake[k - 1],
                density[k - 1],
                dt[k - 1],
                upper[k - 1],
                v,
            )
        _copy_state(x, p, predicted_x[k], predicted_p[k])
        _update(x, p, roots[k], values[k], t)
        _copy_state(x, p, means[k], covs[k])
    size, scaled, gain, change = (
        np.empty(DIM),
        np.empty((DIM, DIM)),
        np.empty((DIM, DIM)),
        np.empty((DIM, DIM)),
    )
    for k in range(n - 2, -1, -1):
        # gain^T = ahead^-1 move p, each axis scaled to its own size first
        for i in range(DIM):
            size[i] = 1 / np.sqrt(predicted_p[k + 1, i, i])
        for i in range(DIM):
            for j in range(DIM):
                scaled[i, j] = predicted_p[k + 1, i, j] * size[i] * size[j]
                gain[i, j] = size[i] * (upper[k, i, j] if i < 6 else covs[k, i, j])
        solve_in_place(scaled, gain)
        for i in range(DIM):
            for j in range(DIM):
                gain[i, j] *= size[i]
                scaled[i, j] = covs[k + 1, i, j] - predicted_p[k + 1, i, j]
        for i in range(DIM):
            moved = means[k, i]
            for j in range(DIM):
                moved += gain[j, i] * (means[k + 1, j] - predicted_x[k + 1, j])
                total = 0.0
                for m in range(DIM):
                    total += gain[m, i] * scaled[m, j]
                change[i, j] = total
            means[k, i] = moved
        for i in range(DIM):
            for j in range(i + 1):
                total = covs[k, i, j]
                for m in range(DIM):
                    total += change[i, m] * gain[m, j]
                covs[k, i, j] = covs[k, j, i] = total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def log_evidence(chain: Chain, density, out):  # pragma: no cover - compiled
    """Fill out (c,): log evidence, up to a constant, of c candidates of density (c, n - 1, 6)."""
    measured, info_vector, move, gate, shift, shake, dt, start = chain
    x, p, none, upper = (
        np.empty(DIM),
        np.empty((DIM, DIM)),
        np.zeros(DIM),
        np.empty((6, DIM)),
    )
    n = len(measured)
    roots, values, v, t = (
        np.empty((n, 6, 6)),
        np.empty((n, 6)),
        np.empty((6, 6)),
        np.empty(DIM),
    )
    _whitened(measured, info_vector, roots, values)
    for c in range(len(density)):
        _copy_state(none, start, x, p)
        total = 0.0
        for k in range(n):
            if k:
                _predict(
                    x,
                    p,
                    move[k - 1],
                    gate[k - 1],
                    shift[k - 1],
                    shake[k - 1],
                    density[c, k - 1],
                    dt[k - 1],
                    upper,
                    v,
                )
            total += _update(x, p, roots[k], values[k], t)
        out[c] = total
