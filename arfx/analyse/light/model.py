"""The compiled part of fit.py: E(n) = a + sum_l Omega_l max(n.d_l, 0), amplitudes at least
0, for given directions.

Amplitudes are solved exactly for every set of directions (variable projection). Several
directions may form one light (`column`) with fixed relative `strength`, and turn together
as one `body`.

Arrays, k samples long in their last axis, so that the loops over them run in vector
registers: normals (3, k), means of unit vectors; value (3, k) by channel; weight (k,);
starts (g + 1,) of the groups; lit (k,) share of the lamps that is on; dirs (q, 3) unit;
column (q,) int 0..m-1; strength (q,); soft (q,) sine of the half-angle of its disc, 1 = a
dome; body (q,) int, -1 = held; amp (g, 3, m + 1), ambient first; residual (3, k), times
sqrt(weight)."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.analyse.pose.kernels import solve_in_place

_FAST = {"reassoc", "contract", "nsz", "arcp"}
_SINGULAR = 1e-10  # of a column's own square: what is left of it beside the others


class Observations(NamedTuple):
    """What is to be explained."""

    normals: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    starts: np.ndarray
    lit: np.ndarray


class Columns(NamedTuple):
    """Which directions make which light;  lights : how many, m"""

    column: np.ndarray
    strength: np.ndarray
    soft: np.ndarray
    lights: int


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _solve_subset(G, h, mask, x):  # pragma: no cover - compiled
    """x : G x = h on the subset `mask` (bits), 0 elsewhere. False where it is singular."""
    m = len(h)
    L = np.zeros((4, 4))
    at = np.zeros(4, np.int64)
    n = 0
    for i in range(m):
        x[i] = 0.0
        if mask >> i & 1:
            at[n] = i
            n += 1
    z = np.zeros(4)
    for i in range(n):
        for j in range(i + 1):
            s = G[at[i], at[j]]
            for p in range(j):
                s -= L[i, p] * L[j, p]
            if i == j:
                if not s > _SINGULAR * G[at[i], at[i]]:
                    return False
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
        s = h[at[i]]
        for p in range(i):
            s -= L[i, p] * z[p]
        z[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = z[i]
        for p in range(i + 1, n):
            s -= L[p, i] * x[at[p]]
        x[at[i]] = s / L[i, i]
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _non_negative(G, h, best):  # pragma: no cover - compiled
    """Minimise x.G.x - 2 x.h over x >= 0 (m <= 4) into `best`: all free if that is
    feasible, else the best of all subsets.
    """
    m = len(h)
    x = np.zeros(4)
    lowest = 0.0
    for i in range(m):
        best[i] = 0.0
    for mask in range((1 << m) - 1, 0, -1):
        if not _solve_subset(G, h, mask, x):
            continue
        feasible, gain = True, 0.0
        for i in range(m):
            feasible = feasible and x[i] >= 0
            gain -= x[i] * h[i]
        if feasible and gain < lowest:
            lowest = gain
            for i in range(m):
                best[i] = x[i]
            if mask == (1 << m) - 1:
                return


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _fill_columns(
    seen: Observations, dirs, columns: Columns, A
):  # pragma: no cover - compiled
    """A (m + 1, k) : what each column's lights give each normal, of strength 1; the first
    is ambient light.
    """
    normals, lit, (column, strength, soft, _) = seen.normals, seen.lit, columns
    k = normals.shape[1]
    for p in range(len(A)):
        for i in range(k):
            A[p, i] = 0.0 if p else 1.0
    for q in range(len(dirs)):
        x, y, z, size, s = dirs[q, 0], dirs[q, 1], dirs[q, 2], strength[q], soft[q]
        row = A[column[q] + 1]
        if s >= 1:  # a dome: not switched with the lamps
            for i in range(k):
                low = max(
                    normals[0, i] * x + normals[1, i] * y + normals[2, i] * z + 1, 0.0
                )
                row[i] += size * low * low / 4
        elif s > 0:
            scale = 1 / (4 * s)
            for i in range(k):
                c = normals[0, i] * x + normals[1, i] * y + normals[2, i] * z
                low = max(c + s, 0.0)
                row[i] += size * lit[i] * (c if c >= s else low * low * scale)
        else:
            for i in range(k):
                row[i] += (
                    size
                    * lit[i]
                    * max(normals[0, i] * x + normals[1, i] * y + normals[2, i] * z, 0.0)
                )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _dot(a, b):  # pragma: no cover - compiled
    s = 0.0
    for i in range(len(a)):
        s += a[i] * b[i]
    return s


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _solve_amplitudes(
    seen: Observations, A, B, amp, residual
):  # pragma: no cover - compiled
    """Chi squared of the columns A with the best amplitudes; B (m + 1, k) is scratch, amp
    and residual are filled.
    """
    value, weight, starts = seen.value, seen.weight, seen.starts
    m, k = A.shape
    G, h = np.empty((m, m)), np.empty(m)
    for p in range(m):
        for i in range(k):
            B[p, i] = weight[i] * A[p, i]
    total = 0.0
    for g in range(len(starts) - 1):
        a, b = starts[g], starts[g + 1]
        for p in range(m):
            for q in range(p + 1):
                G[p, q] = _dot(B[p, a:b], A[q, a:b])
                G[q, p] = G[p, q]
        for c in range(3):
            for p in range(m):
                h[p] = _dot(B[p, a:b], value[c, a:b])
            _non_negative(G, h, amp[g, c])
            r = residual[c, a:b]
            v = value[c, a:b]
            for i in range(b - a):
                r[i] = v[i]
            for p in range(m):
                size = amp[g, c, p]
                if size != 0:
                    row = A[p, a:b]
                    for i in range(b - a):
                        r[i] -= size * row[i]
            w = weight[a:b]
            for i in range(b - a):
                r[i] *= np.sqrt(w[i])
            total += _dot(r, r)
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def evaluate(
    seen: Observations, dirs, columns: Columns, A, B, amp, residual
):  # pragma: no cover - compiled
    """Chi squared of one set of directions with the best amplitudes.

    Filled: A (m + 1, k), see `_fill_columns`; B, A times weight; amp; residual"""
    _fill_columns(seen, dirs, columns, A)
    return _solve_amplitudes(seen, A, B, amp, residual)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def scan(seen: Observations, many, columns: Columns, out):  # pragma: no cover - compiled
    """out (n,) = chi squared of each of `many` (n, q, 3) sets of directions."""
    k, m = seen.normals.shape[1], columns.lights
    amp, residual = np.empty((len(seen.starts) - 1, 3, m + 1)), np.empty((3, k))
    A, B = np.empty((m + 1, k)), np.empty((m + 1, k))
    for n in range(len(many)):
        out[n] = evaluate(seen, many[n], columns, A, B, amp, residual)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _turn(v, w, out):  # pragma: no cover - compiled
    """out = v turned by the rotation vector w (Rodrigues)."""
    t = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if t < 1e-12:
        a, b, d = 1.0, 1.0, 0.0
    else:
        a, b = np.cos(t), np.sin(t) / t
        d = (1 - a) / t**2 * (w[0] * v[0] + w[1] * v[1] + w[2] * v[2])
    x = a * v[0] + b * (w[1] * v[2] - w[2] * v[1]) + d * w[0]
    y = a * v[1] + b * (w[2] * v[0] - w[0] * v[2]) + d * w[1]
    z = a * v[2] + b * (w[0] * v[1] - w[1] * v[0]) + d * w[2]
    n = np.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = x / n, y / n, z / n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _turn_bodies(dirs, body, step, trial):  # pragma: no cover - compiled
    """trial = dirs, each body's turned by three rows of `step` (n, 1)."""
    for i in range(len(dirs)):
        if body[i] >= 0:
            _turn(dirs[i], step[3 * body[i] : 3 * body[i] + 3, 0], trial[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine(
    seen: Observations, dirs, columns: Columns, body, passes, gain
):  # pragma: no cover - compiled
    """Levenberg-Marquardt over the rotations of the bodies, dirs moved in place; returns
    chi squared.

    Ends after `passes`, or where one gains less than the share `gain`. The
    Jacobian is taken by differences of .03 degrees: the kink of max() makes a finer one
    meaningless."""
    k, q, m = seen.normals.shape[1], len(dirs), columns.lights
    bodies = 0
    for i in range(q):
        bodies = max(bodies, body[i] + 1)
    n = 3 * bodies
    amp = np.empty((len(seen.starts) - 1, 3, m + 1))
    r0, r1 = np.empty((3, k)), np.empty((3, k))
    A, B = np.empty((m + 1, k)), np.empty((m + 1, k))
    best = evaluate(seen, dirs, columns, A, B, amp, r0)
    if n == 0:
        return best
    J = np.empty((n, 3 * k))
    H, g, M, step = np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty((n, 1))
    trial = dirs.copy()
    damping, h = 1e-3, 5e-4
    for _ in range(passes):
        before = r0.reshape(-1)
        for p in range(n):
            for s in range(n):
                step[s, 0] = h if s == p else 0.0
            _turn_bodies(dirs, body, step, trial)
            evaluate(seen, trial, columns, A, B, amp, r1)
            after = r1.reshape(-1)
            row = J[p]
            for i in range(3 * k):
                row[i] = (after[i] - before[i]) / h
        size = 0.0
        for p in range(n):
            g[p] = _dot(J[p], before)
            for s in range(p + 1):
                H[p, s] = _dot(J[p], J[s])
                H[s, p] = H[p, s]
            size = max(size, H[p, p])
        if not size > 0:
            return best
        moved = False
        for _ in range(6):
            for p in range(n):
                for s in range(n):
                    M[p, s] = H[p, s]
                M[p, p] += damping * H[p, p] + 1e-9 * size
                step[p, 0] = -g[p]
            solve_in_place(M, step)
            length = 0.0
            for p in range(n):
                length += step[p, 0] ** 2
            shorter = min(1.0, 0.35 / np.sqrt(length))
            for p in range(n):
                step[p, 0] *= shorter
            _turn_bodies(dirs, body, step, trial)
            chi = evaluate(seen, trial, columns, A, B, amp, r1)
            if chi < best:
                moved = best - chi > gain * best + 1e-9
                best = chi
                for i in range(q):
                    for c in range(3):
                        dirs[i, c] = trial[i, c]
                r0, r1 = r1, r0
                damping = max(damping / 5, 1e-9)
                break
            damping *= 6
        if not moved:
            return best
    return best
