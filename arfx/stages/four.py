"""Four channels at once: read before any is written, so that the compiler's SLP pass makes one
vector of them.

Nothing here looks whether a place is inside of its array; indices are unsigned, which spares a
test for negative ones."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

_U = np.uintp


@numba.njit(nogil=True)
def add_four(out, cell, a, b, c, d):  # pragma: no cover - compiled
    """out[cell] += (a, b, c, d), in cells of four. out : flat"""
    i = _U(4) * _U(cell)
    a, b, c, d = out[i] + a, out[i + _U(1)] + b, out[i + _U(2)] + c, out[i + _U(3)] + d
    out[i], out[i + _U(1)], out[i + _U(2)], out[i + _U(3)] = a, b, c, d


@numba.njit(nogil=True)
def put_four(out, at, a, b, c, d):  # pragma: no cover - compiled
    """out[at : at + 4] = a, b, c, d. out : flat. Three and one to be overwritten are quicker
    written than three."""
    i = _U(at)
    out[i], out[i + _U(1)], out[i + _U(2)], out[i + _U(3)] = a, b, c, d


@numba.njit(nogil=True, fastmath=True)
def mean_of_rows(rows, i, j, k, a, b, c):  # pragma: no cover - compiled
    """a rows[i] + b rows[j] + c rows[k], a tuple. rows : (n, 4);  rounded as the compiler likes"""
    return (
        rows[i, 0] * a + rows[j, 0] * b + rows[k, 0] * c,
        rows[i, 1] * a + rows[j, 1] * b + rows[k, 1] * c,
        rows[i, 2] * a + rows[j, 2] * b + rows[k, 2] * c,
        rows[i, 3] * a + rows[j, 3] * b + rows[k, 3] * c,
    )
