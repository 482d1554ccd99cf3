"""The compiled part of light_fit.py: E(n) = a + sum_l Omega_l max(n.d_l, 0), amplitudes at least 0, for given directions.

Directions are nonlinear parameters, amplitudes linear ones that are solved exactly for every set of directions (variable
projection): a small non-negative least squares per group of observations and channel. Groups share the directions and
have amplitudes of their own. Several directions may form one light (`column`) with fixed relative `strength`, and turn
together as one `body`: so a light is replaced by a rigid pair, to see whether the data would have noticed.

Arrays: normals (k, 3), mean of unit vectors; value (k, 3); weight (k,); starts (g + 1,) of the groups; dirs (q, 3) unit;
column (q,) int 0..m-1; strength (q,);
soft (q,) sine of the half-angle of its disc, 1 = a sky; body (q,) int, -1 = held; amp (g, 3, m + 1), ambient first.
"""

from __future__ import annotations

import numba
import numpy as np

_SINGULAR = 1e-10  # of a column's own square: what is left of it beside the others


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shade(c, soft):  # pragma: no cover - compiled
    """max(c, 0) for a light whose disc has half-angle asin(soft): rises smoothly over |c| < soft (half a disc's worth of
    light at the horizon: (c + s)^2 / 4 s, exact at both ends and in slope)."""
    if c >= soft:
        return c
    if c <= -soft:
        return 0.0
    return (c + soft) ** 2 / (4 * soft)


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
    """Minimise x.G.x - 2 x.h over x >= 0 (m <= 4) into `best`: all free if that is feasible, else the best of all subsets."""
    m = len(h)
    x = np.zeros(4)
    lowest = 0.0
    best[:] = 0.0
    for mask in range((1 << m) - 1, 0, -1):
        if not _solve_subset(G, h, mask, x):
            continue
        feasible, gain = True, 0.0
        for i in range(m):
            feasible = feasible and x[i] >= 0
            gain -= x[i] * h[i]
        if feasible and gain < lowest:
            lowest = gain
            best[:] = x[:m]
            if mask == (1 << m) - 1:
                return


@numba.njit(cache=True, nogil=True, error_model="numpy")
def evaluate(normals, value, weight, starts, dirs, column, strength, soft, m, amp, residual):  # pragma: no cover - compiled
    """Chi squared of one set of directions with the best amplitudes; amp and residual (k, 3, times sqrt weight) are filled."""
    k = len(normals)
    A = np.empty((k, m + 1))
    for i in range(k):
        A[i, 0] = 1.0
        for j in range(m):
            A[i, j + 1] = 0.0
        for q in range(len(dirs)):
            c = normals[i, 0] * dirs[q, 0] + normals[i, 1] * dirs[q, 1] + normals[i, 2] * dirs[q, 2]
            A[i, column[q] + 1] += strength[q] * shade(c, soft[q])
    G = np.empty((m + 1, m + 1))
    h = np.empty(m + 1)
    total = 0.0
    for g in range(len(starts) - 1):
        G[:] = 0.0
        for i in range(starts[g], starts[g + 1]):
            for p in range(m + 1):
                for q in range(p + 1):
                    G[p, q] += weight[i] * A[i, p] * A[i, q]
        for p in range(m + 1):
            for q in range(p):
                G[q, p] = G[p, q]
        for c in range(3):
            h[:] = 0.0
            for i in range(starts[g], starts[g + 1]):
                for p in range(m + 1):
                    h[p] += weight[i] * A[i, p] * value[i, c]
            _non_negative(G, h, amp[g, c])
            for i in range(starts[g], starts[g + 1]):
                r = value[i, c]
                for p in range(m + 1):
                    r -= A[i, p] * amp[g, c, p]
                r *= np.sqrt(weight[i])
                residual[i, c] = r
                total += r * r
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def scan(normals, value, weight, starts, many, column, strength, soft, m, out):  # pragma: no cover - compiled
    """out (n,) = chi squared of each of `many` (n, q, 3) sets of directions."""
    amp = np.empty((len(starts) - 1, 3, m + 1))
    residual = np.empty((len(normals), 3))
    for n in range(len(many)):
        out[n] = evaluate(normals, value, weight, starts, many[n], column, strength, soft, m, amp, residual)


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
def refine(normals, value, weight, starts, dirs, column, strength, body, soft, m, passes):  # pragma: no cover - compiled
    """Levenberg-Marquardt over the rotations of the bodies, dirs moved in place; returns chi squared.

    The Jacobian is taken by differences of .03 degrees: the kink of max() makes a finer one meaningless.
    """
    k, q = len(normals), len(dirs)
    bodies = 0
    for i in range(q):
        bodies = max(bodies, body[i] + 1)
    n = 3 * bodies
    amp = np.empty((len(starts) - 1, 3, m + 1))
    r0, r1 = np.empty((k, 3)), np.empty((k, 3))
    best = evaluate(normals, value, weight, starts, dirs, column, strength, soft, m, amp, r0)
    if n == 0:
        return best
    J = np.empty((n, k, 3))
    H, g = np.empty((n, n)), np.empty(n)
    trial = np.empty((q, 3))
    w = np.empty(3)
    damping, h = 1e-3, 5e-4
    for _ in range(passes):
        for p in range(n):
            w[:] = 0.0
            w[p % 3] = h
            for i in range(q):
                if body[i] == p // 3:
                    _turn(dirs[i], w, trial[i])
                else:
                    trial[i] = dirs[i]
            evaluate(normals, value, weight, starts, trial, column, strength, soft, m, amp, r1)
            for i in range(k):
                for c in range(3):
                    J[p, i, c] = (r1[i, c] - r0[i, c]) / h
        size = 0.0
        for p in range(n):
            g[p] = (J[p] * r0).sum()
            for s in range(p + 1):
                H[p, s] = (J[p] * J[s]).sum()
                H[s, p] = H[p, s]
            size = max(size, H[p, p])
        if not size > 0:
            return best
        moved = False
        for _ in range(6):
            M = H.copy()
            for p in range(n):
                M[p, p] += damping * H[p, p] + 1e-9 * size
            step = np.linalg.solve(M, -g)
            length = np.sqrt((step**2).sum())
            if length > 0.35:
                step *= 0.35 / length
            for i in range(q):
                if body[i] >= 0:
                    _turn(dirs[i], step[3 * body[i] : 3 * body[i] + 3], trial[i])
                else:
                    trial[i] = dirs[i]
            chi = evaluate(normals, value, weight, starts, trial, column, strength, soft, m, amp, r1)
            if chi < best:
                moved = best - chi > 1e-6 * best + 1e-9
                best = chi
                dirs[:] = trial
                r0[:] = r1
                damping = max(damping / 5, 1e-9)
                break
            damping *= 6
        if not moved:
            return best
    return best
