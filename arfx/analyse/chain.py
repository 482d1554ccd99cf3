"""A Gauss-Markov chain over one shot: Kalman filter, Rauch-Tung-Striebel smoother and the evidence for its noise.

State per frame: 6 position-like and 6 velocity-like numbers. Between frames white noise accelerates each axis with
its own density q (units^2 / s^3): exact for irregular frame times. Measurements come as information on the first six
numbers, zero where nothing was seen. Covariance form: stays regular for a density of nearly zero (a marker at rest)
and for directions that no measurement fixes.
Source: Barfoot, State Estimation for Robotics, 2nd ed., sections 3.1-3.3 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DIM = 12
# What is known before the first frame: nothing. Standard deviations of 10 (radians, or e-folds of distance) and of
# 100 per second lie beyond anything filmed, and their squares times the information of a corner still leave digits.
_START = np.diag([1e2] * 6 + [1e4] * 6)


@dataclass(frozen=True)
class Links:
    """How a state follows from the one before: x_k+1 = move_k x_k + shift_k + noise_k, noise through `gate_k`.

    move, gate : (n - 1, 12, 12);  shift : (n - 1, 12);  dt_s : (n - 1,)
    """

    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    dt_s: np.ndarray

    def part(self, first: int, end: int) -> Links:
        """The links between frames first .. end - 1."""
        s = slice(first, end - 1)
        return Links(self.move[s], self.gate[s], self.shift[s], self.dt_s[s])


def link(before: np.ndarray, after: np.ndarray, offset: np.ndarray, dt_s: np.ndarray) -> Links:
    """Links from residuals before_k x_k + after_k x_k+1 + offset_k = noise_k."""
    gate = np.linalg.inv(after) if len(after) else after
    return Links(-gate @ before, gate, -np.einsum("nij,nj->ni", gate, offset), dt_s)


def noise(density: np.ndarray, dt_s: float) -> np.ndarray:
    """(..., 12, 12) covariance q (dt^3/3, dt^2/2; dt^2/2, dt) per axis. density : (..., 6)."""
    out = np.zeros((*density.shape[:-1], DIM, DIM))
    i = np.arange(6)
    out[..., i, i] = density * dt_s**3 / 3
    out[..., i, i + 6] = out[..., i + 6, i] = density * dt_s**2 / 2
    out[..., i + 6, i + 6] = density * dt_s
    return out


def smooth_chain(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, 12) and covariance (n, 12, 12) of every state given all measurements.

    measured : (n, 6, 6) information;  pull : (n, 6) information times measured value;  density : (n - 1, 6)
    """
    n = len(measured)
    x, p = np.zeros(DIM), _START
    means, covs, ahead_means, ahead_covs = [], [], [], []
    for k in range(n):
        if k:
            q = links.gate[k - 1] @ noise(density[k - 1], float(links.dt_s[k - 1])) @ links.gate[k - 1].T
            x = links.move[k - 1] @ x + links.shift[k - 1]
            p = links.move[k - 1] @ p @ links.move[k - 1].T + q
        ahead_means.append(x)
        ahead_covs.append(p)
        x, p = _update(x, p, measured[k], pull[k])
        means.append(x)
        covs.append(p)
    for k in range(n - 2, -1, -1):
        gain = _gain(covs[k], links.move[k], ahead_covs[k + 1])
        means[k] = means[k] + gain @ (means[k + 1] - ahead_means[k + 1])
        c = covs[k] + gain @ (covs[k + 1] - ahead_covs[k + 1]) @ gain.T
        covs[k] = (c + c.T) / 2
    return np.stack(means), np.stack(covs)


def _update(x: np.ndarray, p: np.ndarray, m: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    narrow = p[:, :6]
    inner = np.eye(6) + m @ narrow[:6]
    p = p - narrow @ np.linalg.solve(inner, m) @ narrow.T
    p = (p + p.T) / 2
    return x + p[:, :6] @ (g - m @ x[:6]), p


def _gain(p: np.ndarray, move: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """p move^T ahead^-1, each axis scaled to its own size first."""
    size = 1 / np.sqrt(np.diag(ahead))
    scaled = ahead * size[:, None] * size[None]
    return np.linalg.solve(scaled, (size[:, None] * (move @ p))).T * size[None]


def evidence(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> np.ndarray:
    """(c,) log evidence, up to a constant, of c candidates of noise density (c, n - 1, 6) on one chain."""
    c = len(density)
    x, p = np.zeros((c, DIM)), np.broadcast_to(_START, (c, DIM, DIM))
    total = np.zeros(c)
    for k in range(len(measured)):
        if k:
            move, gate = links.move[k - 1], links.gate[k - 1]
            x = x @ move.T + links.shift[k - 1]
            p = move @ p @ move.T + gate @ noise(density[:, k - 1], float(links.dt_s[k - 1])) @ gate.T
        m, g = measured[k], pull[k]
        if not m.any():
            continue
        narrow = p[:, :, :6]
        inner = np.eye(6) + m @ narrow[:, :6]
        rest = g - x[:, :6] @ m
        p = p - narrow @ np.linalg.solve(inner, np.broadcast_to(m, inner.shape)) @ np.swapaxes(narrow, 1, 2)
        p = (p + np.swapaxes(p, 1, 2)) / 2
        step = np.einsum("cij,cj->ci", p[:, :, :6], rest)
        total += (x[:, :6] @ g) - 0.5 * np.einsum("ci,ij,cj->c", x[:, :6], m, x[:, :6])
        total += 0.5 * np.einsum("ci,ci->c", rest, step[:, :6]) - 0.5 * np.linalg.slogdet(inner)[1]
        x = x + step
    return total
