"""Compiled: numbers in order. numpy's own sort and median take a second each to compile."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba


@numba.njit(cache=True, nogil=True)
def sort(v):  # pragma: no cover - compiled
    """In place (Shell 1959), for some hundred numbers at most; none of them NaN."""
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
