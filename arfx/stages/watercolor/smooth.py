"""A Gaussian of few taps over rows of three planes, in steps of a vector unit: a third of what cv2.GaussianBlur takes for it.

Cost: O(samples). Borders are replicated.
"""

from __future__ import annotations

import numba
import numpy as np

REACH = 5  # px to each side that the taps go
_FAST = {"contract", "nsz", "arcp"}
_U = np.uint64  # an index of that type is not looked at for a minus: loops stay simple


def taps_of(sigma: float) -> np.ndarray:
    """(REACH + 1,) float32 weights of the middle and of what lies 1 ... REACH px off it; empty where sigma is too large."""
    if sigma > REACH / 3:
        return np.zeros(0, np.float32)
    weight = np.exp(-0.5 * (np.arange(REACH + 1) / sigma) ** 2)
    return (weight / (2 * weight.sum() - weight[0])).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def smoothed(planes, taps, first, last, out):  # pragma: no cover - compiled
    """out (3, last - first, w) : rows first ... last - 1 of the planes (3, h, w), as if there were no others."""
    w, n = planes.shape[2], last - first
    padded, across = np.empty(w + 2 * REACH, np.float32), np.empty((n, w), np.float32)
    for c in range(3):
        for y in range(n):
            _across(planes[c, first + y], padded, taps, across[y])
        for y in range(n):
            to = out[c, y]
            _set(across[y], taps[0], to)
            for k in range(1, REACH + 1):
                _add_both(across[max(y - k, 0)], across[min(y + k, n - 1)], taps[k], to)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _across(row, padded, taps, out):  # pragma: no cover - compiled
    w = row.shape[0]
    padded[:REACH] = row[0]
    padded[REACH : w + REACH] = row
    padded[w + REACH :] = row[w - 1]
    t0, t1, t2, t3, t4, t5 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5]
    for x in range(w):
        i = _U(x)
        s = t0 * padded[i + _U(5)] + t1 * (padded[i + _U(4)] + padded[i + _U(6)])
        s += t2 * (padded[i + _U(3)] + padded[i + _U(7)]) + t3 * (padded[i + _U(2)] + padded[i + _U(8)])
        s += t4 * (padded[i + _U(1)] + padded[i + _U(9)]) + t5 * (padded[i] + padded[i + _U(10)])
        out[x] = s


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _set(a, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] = weight * a[x]


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_both(a, b, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] += weight * (a[x] + b[x])
