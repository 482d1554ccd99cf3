"""Sorting and solving for other compiled code. Float64 throughout."""

from __future__ import annotations

import numba


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
