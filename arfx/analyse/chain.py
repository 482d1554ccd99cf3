"""A Gauss-Markov chain over one shot: block-tridiagonal solve, marginal covariances, evidence.

State per frame: 6 position-like and 6 velocity-like numbers. Between frames white noise accelerates each axis with
its own density q (units^2 / s^3): exact for irregular frame times. Solving the information form forwards and
backwards is the Rauch-Tung-Striebel smoother of the linearised problem.
Source: Barfoot, State Estimation for Robotics, 2nd ed., sections 3.1 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DIM = 12
# Information on an unknown first velocity: a standard deviation of 1e3 units/s, beyond anything filmed, keeps the
# system regular where two frames alone leave it open.
_LOOSE = 1e-6


@dataclass(frozen=True)
class ChainSolution:
    """mean : (n, 12);  covariance : (n, 12, 12);  cross : (n - 1, 12, 12) of x_k with x_k+1;
    log_det : of the whole information matrix."""

    mean: np.ndarray
    covariance: np.ndarray
    cross: np.ndarray
    log_det: float


@dataclass(frozen=True)
class Links:
    """The prior's residuals between frames: e_k = before_k x_k + after_k x_k+1 + offset_k.

    before, after : (n - 1, 12, 12);  offset : (n - 1, 12);  dt_s : (n - 1,);  density : (n - 1, 6) q per axis
    """

    before: np.ndarray
    after: np.ndarray
    offset: np.ndarray
    dt_s: np.ndarray
    density: np.ndarray

    def information(self) -> np.ndarray:
        """(n - 1, 12, 12): inverse of q (dt^3/3, dt^2/2; dt^2/2, dt) per axis."""
        out = np.zeros((len(self.dt_s), DIM, DIM))
        dt = self.dt_s[:, None]
        i = np.arange(6)
        out[:, i, i] = 12 / (self.density * dt**3)
        out[:, i, i + 6] = out[:, i + 6, i] = -6 / (self.density * dt**2)
        out[:, i + 6, i + 6] = 4 / (self.density * dt)
        return out


def solve_chain(measured: np.ndarray, pull: np.ndarray, links: Links) -> ChainSolution:
    """Most likely states and their covariances.

    measured : (n, 6, 6) information of the measurement on the first six numbers, zero where nothing was seen
    pull : (n, 6) its right-hand side (information times measured value)
    """
    n = len(measured)
    a = np.zeros((n, DIM, DIM))
    g = np.zeros((n, DIM))
    a[:, :6, :6] = measured
    a[:, np.arange(6, DIM), np.arange(6, DIM)] += _LOOSE
    a[:, np.arange(6), np.arange(6)] += _LOOSE
    g[:, :6] = pull
    info = links.information()
    before_info = np.swapaxes(links.before, 1, 2) @ info
    after_info = np.swapaxes(links.after, 1, 2) @ info
    a[:-1] += before_info @ links.before
    a[1:] += after_info @ links.after
    g[:-1] -= np.einsum("nij,nj->ni", before_info, links.offset)
    g[1:] -= np.einsum("nij,nj->ni", after_info, links.offset)
    b = before_info @ links.after  # couples x_k with x_k+1
    # scaling each axis by its own information keeps metres, radians and seconds from spoiling the condition
    scale = 1 / np.sqrt(np.einsum("nii->ni", a))
    a = a * scale[:, :, None] * scale[:, None, :]
    b = b * scale[:-1, :, None] * scale[1:, None, :]
    g = g * scale
    inverse = np.empty_like(a)
    y = g.copy()
    log_det = -2 * float(np.log(scale).sum())
    s = a[0]
    for k in range(n):
        inverse[k] = np.linalg.inv(s)
        inverse[k] = (inverse[k] + inverse[k].T) / 2
        log_det += float(np.linalg.slogdet(s)[1])
        if k + 1 < n:
            w = b[k].T @ inverse[k]
            s = a[k + 1] - w @ b[k]
            y[k + 1] -= w @ y[k]
    mean, cov, cross = np.empty_like(g), np.empty_like(a), np.empty((max(n - 1, 0), DIM, DIM))
    mean[-1], cov[-1] = inverse[-1] @ y[-1], inverse[-1]
    for k in range(n - 2, -1, -1):
        gain = inverse[k] @ b[k]
        mean[k] = inverse[k] @ y[k] - gain @ mean[k + 1]
        cross[k] = -gain @ cov[k + 1]
        cov[k] = inverse[k] - cross[k] @ gain.T
    both = scale[:, :, None] * scale[:, None, :]
    return ChainSolution(mean * scale, cov * both, cross * scale[:-1, :, None] * scale[1:, None, :], log_det)


def noise_moments(solution: ChainSolution, links: Links) -> np.ndarray:
    """(n - 1, 6) expected density of each axis's noise in each interval, given the data (the E step of EM)."""
    m, c = solution.mean, solution.covariance
    e = np.einsum("nij,nj->ni", links.before, m[:-1]) + np.einsum("nij,nj->ni", links.after, m[1:]) + links.offset
    half = links.before @ solution.cross @ np.swapaxes(links.after, 1, 2)
    spread = (
        links.before @ c[:-1] @ np.swapaxes(links.before, 1, 2)
        + links.after @ c[1:] @ np.swapaxes(links.after, 1, 2)
        + half + np.swapaxes(half, 1, 2)
    )  # fmt: skip
    second = spread + e[:, :, None] * e[:, None, :]
    i, dt = np.arange(6), links.dt_s[:, None]
    pp, pv, vv = second[:, i, i], second[:, i, i + 6], second[:, i + 6, i + 6]
    return np.maximum(12 * pp / dt**3 - 12 * pv / dt**2 + 4 * vv / dt, 0.0) / 2
