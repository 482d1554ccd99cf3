"""Compiled loops: the Kalman filter along one chain; and sorting and solving for
other compiled code. Float64 throughout."""

from __future__ import annotations

import numba
import numpy as np


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
    """b becomes a^-1 b for a (n, n) symmetric and positive, which needs no pivots, b (n, m); a
    is used up. A singular a leaves NaN.
    """
    n, m = b.shape
    for c in range(n):
        for r in range(n):
            if r != c:
                fraction = a[r, c] / a[c, c]
                for k in range(c, n):
                    a[r, k] -= fraction * a[c, k]
                for k in range(m):
                    b[r, k] -= fraction * b[c, k]
    for c in range(n):
        for k in range(m):
            b[c, k] /= a[c, c]


@numba.njit(cache=True, nogil=True)
def _dot(a, b):  # pragma: no cover - compiled
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@numba.njit(cache=True, nogil=True)
def _multiply(a, b, out):  # pragma: no cover - compiled
    """out = a b^T; numpy's own product takes seconds to compile."""
    for i in range(len(a)):
        for j in range(len(b)):
            out[i, j] = _dot(a[i], b[j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def filter_chain(
    start, move, shift, noise, rows, values, ahead_x, ahead_p, means, covs
):  # pragma: no cover - compiled
    """Kalman filter along n states of s numbers. Returns the log evidence, up to a constant.

    start (s, s) : covariance of the first state;  move, noise (n - 1, s, s), shift (n - 1, s)
    rows (n, m, r), values (n, m) : measurements of a state's first r numbers, independent and
    of unit noise; a row of zeros measures nothing
    ahead_x, means (n, s), ahead_p, covs (n, s, s) : filled with the states before and after
    their own measurements

    Measurements are taken in one after the other: nothing is inverted, and the errors of
    rounding stay those of p, however strongly its axes are bound together."""
    x, p = np.zeros(len(start)), start.copy()
    moved, shared = np.empty_like(x), np.empty_like(x)
    turned = np.empty_like(p)
    log = 0.0
    for k in range(len(means)):
        if k:
            _multiply(move[k - 1], p, turned)
            _multiply(move[k - 1], turned, p)
            p += noise[k - 1]
            for i in range(len(x)):
                moved[i] = _dot(move[k - 1, i], x) + shift[k - 1, i]
            x[:] = moved
        ahead_x[k], ahead_p[k] = x, p
        for j in range(values.shape[1]):
            row, value = rows[k, j], values[k, j]
            for i in range(len(x)):
                shared[i] = _dot(row, p[i])
            spread = 1.0 + _dot(row, shared)
            missed = value - _dot(row, x)
            log -= 0.5 * (np.log(spread) + missed**2 / spread - value**2)
            for i in range(len(x)):
                x[i] += shared[i] * (missed / spread)
                for m in range(len(x)):
                    p[i, m] -= shared[i] * shared[m] / spread
        means[k], covs[k] = x, p
    return log
