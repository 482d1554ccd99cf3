"""Four channels at once: read before any is written, so that the compiler's SLP pass makes one vector of them.

Nothing here looks whether a place is inside of its array; indices are unsigned, which spares a test for negative ones. Without
contraction, whatever the caller allows: light that is spread over a disc must be taken away again to the last bit."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

_U, _F = np.uintp, np.float32


@numba.njit(nogil=True)
def add_four(out, cell, a, b, c, d):  # pragma: no cover - compiled
    """out[cell] += (a, b, c, d), in cells of four. out : flat"""
    i = _U(4) * _U(cell)
    a, b, c, d = out[i] + a, out[i + _U(1)] + b, out[i + _U(2)] + c, out[i + _U(3)] + d
    out[i], out[i + _U(1)], out[i + _U(2)], out[i + _U(3)] = a, b, c, d


@numba.njit(nogil=True)
def add_between(out, cell, line, p, q, t):  # pragma: no cover - compiled
    """out[cell] += line[p] + (line[q] - line[p]) t, in cells of four. out, line : flat"""
    i, j = _U(4) * _U(p), _U(4) * _U(q)
    a, b, c, d = line[i], line[i + _U(1)], line[i + _U(2)], line[i + _U(3)]
    e, f, g, h = line[j] - a, line[j + _U(1)] - b, line[j + _U(2)] - c, line[j + _U(3)] - d
    add_four(out, cell, a + e * t, b + f * t, c + g * t, d + h * t)


@numba.njit(nogil=True)
def mix_between(out, cell, line, p, q, t, share):  # pragma: no cover - compiled
    """out[cell] += share (line[p] + (line[q] - line[p]) t - out[cell]), in cells of four. out, line : flat"""
    i, j, k = _U(4) * _U(p), _U(4) * _U(q), _U(4) * _U(cell)
    a, b, c, d = line[i], line[i + _U(1)], line[i + _U(2)], line[i + _U(3)]
    e, f, g, h = line[j] - a, line[j + _U(1)] - b, line[j + _U(2)] - c, line[j + _U(3)] - d
    a, b, c, d = a + e * t, b + f * t, c + g * t, d + h * t
    a, b, c, d = a - out[k], b - out[k + _U(1)], c - out[k + _U(2)], d - out[k + _U(3)]
    add_four(out, cell, a * share, b * share, c * share, d * share)


@numba.njit(nogil=True)
def put_mean(out, cell, line, cells, near, far):  # pragma: no cover - compiled
    """out[cell] = the sum of four cells of line, the middle two times `near`, the others times `far`. out, line : flat"""
    i, j, k, m = (
        _U(4) * _U(cells[0]),
        _U(4) * _U(cells[1]),
        _U(4) * _U(cells[2]),
        _U(4) * _U(cells[3]),
    )
    a, b, c, d = (
        line[j] + line[k],
        line[j + _U(1)] + line[k + _U(1)],
        line[j + _U(2)] + line[k + _U(2)],
        line[j + _U(3)] + line[k + _U(3)],
    )
    e, f, g, h = (
        line[i] + line[m],
        line[i + _U(1)] + line[m + _U(1)],
        line[i + _U(2)] + line[m + _U(2)],
        line[i + _U(3)] + line[m + _U(3)],
    )
    put_four(
        out,
        _U(4) * _U(cell),
        a * near + e * far,
        b * near + f * far,
        c * near + g * far,
        d * near + h * far,
    )


@numba.njit(nogil=True)
def add_two_between(out, cell, line, p, t, step):  # pragma: no cover - compiled
    """`add_between` p and p + 1 to `cell` and, with t + step, to the next one."""
    i, u = _U(4) * _U(p), t + step
    a, b, c, d = line[i], line[i + _U(1)], line[i + _U(2)], line[i + _U(3)]
    e, f, g, h = line[i + _U(4)] - a, line[i + _U(5)] - b, line[i + _U(6)] - c, line[i + _U(7)] - d
    add_four(out, cell, a + e * t, b + f * t, c + g * t, d + h * t)
    add_four(out, cell + 1, a + e * u, b + f * u, c + g * u, d + h * u)


@numba.njit(nogil=True)
def put_four(out, at, a, b, c, d):  # pragma: no cover - compiled
    """out[at : at + 4] = a, b, c, d. out : flat. Three and one to be overwritten are quicker written than three."""
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
