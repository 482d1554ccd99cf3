"""Solving for other compiled code, in float64."""

from __future__ import annotations

import numba


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
