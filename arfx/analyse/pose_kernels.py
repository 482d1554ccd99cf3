"""The compiled loop of geometry.refine_poses: Levenberg-Marquardt over the corners of one pose at a time."""

from __future__ import annotations

import numba
import numpy as np

from arfx.analyse.chain_kernels import solve_in_place
from arfx.core.numerics import EPS_ANGLE, EPS_DEPTH_M

HUBER_SIGMA = 3.0  # residuals beyond it count linearly
_SETTLED = 1e-9  # change of the cost, relative to 1 + cost


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine(rotation, translation, points, ideal, px_per_ideal, weight, iterations, cost):  # pragma: no cover - compiled
    """Refine rotation (n, 3, 3) and translation (n, 3) in place and fill cost (n,); the rest as in geometry.Observed."""
    a, g, left, step = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty((6, 1))
    new_r, new_t, turn = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for n in range(len(rotation)):
        r, t = rotation[n], translation[n]
        damping, still = 1e-4, 0
        best = _system(r, t, points[n], ideal[n], px_per_ideal[n], weight[n], a, g, True)
        for _ in range(iterations):
            for i in range(6):
                for j in range(6):
                    left[i, j] = a[i, j]
                left[i, i] += a[i, i] * damping + 1e-12
                step[i, 0] = -g[i]
            solve_in_place(left, step)
            _turn(step, turn)
            for i in range(3):
                for j in range(3):
                    new_r[i, j] = turn[i, 0] * r[0, j] + turn[i, 1] * r[1, j] + turn[i, 2] * r[2, j]
                new_t[i] = turn[i, 0] * t[0] + turn[i, 1] * t[1] + turn[i, 2] * t[2] + step[i + 3, 0]
            now = _system(new_r, new_t, points[n], ideal[n], px_per_ideal[n], weight[n], a, g, False)
            # settled twice in a row: a refused step may by chance cost the same as the place it came from
            still = still + 1 if abs(best - now) < _SETTLED * (1 + best) else 0
            if now < best:
                best = now
                for i in range(3):
                    t[i] = new_t[i]
                    for j in range(3):
                        r[i, j] = new_r[i, j]
                damping = max(damping * 0.2, 1e-9)
            else:
                damping = min(damping * 10, 1e6)
            if still > 1 or not np.isfinite(best):
                break
            if now <= best:
                _system(r, t, points[n], ideal[n], px_per_ideal[n], weight[n], a, g, True)
        cost[n] = best


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _system(r, t, points, ideal, px_per_ideal, weight, a, g, derive):  # pragma: no cover - compiled
    """Cost of a pose with Huber's loss; derive : also its normal matrix a (6, 6) and gradient g (6,)."""
    cost = 0.0
    if derive:
        for i in range(6):
            g[i] = 0.0
            for k in range(6):
                a[i, k] = 0.0
    j = np.empty((2, 6))
    for p in range(len(points)):
        if weight[p] == 0.0:
            continue
        x = r[0, 0] * points[p, 0] + r[0, 1] * points[p, 1] + r[0, 2] * points[p, 2] + t[0]
        y = r[1, 0] * points[p, 0] + r[1, 1] * points[p, 1] + r[1, 2] * points[p, 2] + t[1]
        depth = r[2, 0] * points[p, 0] + r[2, 1] * points[p, 1] + r[2, 2] * points[p, 2] + t[2]
        z = max(depth, EPS_DEPTH_M)
        u, v = x / z - ideal[p, 0], y / z - ideal[p, 1]
        s = px_per_ideal[p]
        rx, ry = s[0, 0] * u + s[0, 1] * v, s[1, 0] * u + s[1, 1] * v
        d2 = (rx * rx + ry * ry) * weight[p]
        w = weight[p]
        if d2 > HUBER_SIGMA**2:
            d = np.sqrt(d2)
            cost += HUBER_SIGMA * d - 0.5 * HUBER_SIGMA**2
            w *= HUBER_SIGMA / d
        else:
            cost += 0.5 * d2
        if not derive:
            continue
        for i in range(2):
            ex, ey = s[i, 0] / z, s[i, 1] / z
            ez = -(s[i, 0] * x + s[i, 1] * y) / z**2
            j[i, 0] = ez * y - ey * depth  # e . (axis x point)
            j[i, 1] = ex * depth - ez * x
            j[i, 2] = ey * x - ex * y
            j[i, 3], j[i, 4], j[i, 5] = ex, ey, ez
        for i in range(6):
            g[i] += w * (j[0, i] * rx + j[1, i] * ry)
            for k in range(6):
                a[i, k] += w * (j[0, i] * j[0, k] + j[1, i] * j[1, k])
    return cost


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _turn(step, out):  # pragma: no cover - compiled
    """Rotation matrix of the rotation vector step[:3, 0]; series near zero as in core.pose."""
    x, y, z = step[0, 0], step[1, 0], step[2, 0]
    t2 = x * x + y * y + z * z
    t = np.sqrt(t2)
    if t < EPS_ANGLE:
        a, b = 1 - t2 / 6, 0.5 - t2 / 24
    else:
        a, b = np.sin(t) / t, (1 - np.cos(t)) / t2
    out[0, 0], out[1, 1], out[2, 2] = 1 - b * (y * y + z * z), 1 - b * (x * x + z * z), 1 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x
