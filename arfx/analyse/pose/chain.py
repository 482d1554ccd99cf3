"""A Gauss-Markov chain: Kalman filter, Rauch-Tung-Striebel smoother, and the evidence for
its noise.

State: 6 position-like and 6 velocity-like numbers. Measurements are information on the
first six. Covariance form: regular for a density of nearly zero, and for directions that no
measurement fixes. Source: docs/methods/pose.md#smoothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.analyse.pose.kernels import filter_chain

DIM = 12
# share of an axis's information below which what the other axes leave of it is rounding
_UNFIXED = 1e-14
# What is known before the first frame: nothing. Standard deviations of 10 (radians, or
# e-folds of distance) and of 100 per second lie beyond anything filmed, and their squares
# times the information of a corner still leave digits.
_START = np.diag([1e2] * 6 + [1e4] * 6)


@dataclass(frozen=True)
class Links:
    """How a state follows from the one before: x_k+1 = move_k x_k + shift_k + noise_k,
    noise through `gate_k`.

    move, gate : (n - 1, 12, 12);  shift : (n - 1, 12);  dt_s : (n - 1,)
    shake : (n - 1, 6, 6) covariance, per unit of its density, of what turns and moves the
    marker at once
    Only the turns' blocks (3 x 3, of angles and of their velocities) are free: the other
    axes have constant velocity."""

    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    dt_s: np.ndarray
    shake: np.ndarray

    def part(self, first: int, end: int) -> Links:
        """The links between frames first .. end - 1."""
        s = slice(first, end - 1)
        return Links(self.move[s], self.gate[s], self.shift[s], self.dt_s[s], self.shake[s])


def link(
    before: np.ndarray,
    after: np.ndarray,
    offset: np.ndarray,
    dt_s: np.ndarray,
    shake: np.ndarray,
) -> Links:
    """Links from residuals before_k x_k + after_k x_k+1 + offset_k = noise_k.

    after : 1 but for the turns
    """
    gate = after.copy()
    gate[:, :3, :3] = np.linalg.inv(after[:, :3, :3])
    return Links(-gate @ before, gate, -np.einsum("nij,nj->ni", gate, offset), dt_s, shake)


def smooth_chain(
    measured: np.ndarray, info_vector: np.ndarray, links: Links, density: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, 12) and covariance (n, 12, 12) of every state given all measurements.

    measured : (n, 6, 6) information;  info_vector : (n, 6) information times measured
    value;  density : (n - 1, 7)
    """
    noise = _noise(links, density)
    _, ahead_x, ahead_p, means, covs = _filter(
        *_whitened(measured, info_vector), links, noise
    )
    # gain^T = ahead^-1 move p, each axis scaled to its own size first
    size = 1 / np.sqrt(np.einsum("nii->ni", ahead_p[1:]))
    scaled = ahead_p[1:] * size[:, :, None] * size[:, None]
    gain = size[:, :, None] * np.linalg.solve(
        scaled, size[:, :, None] * (links.move @ covs[:-1])
    )
    for k in range(len(means) - 2, -1, -1):
        means[k] += (means[k + 1] - ahead_x[k + 1]) @ gain[k]
        covs[k] += gain[k].T @ (covs[k + 1] - ahead_p[k + 1]) @ gain[k]
    if not (np.isfinite(means).all() and np.isfinite(covs).all()):
        raise np.linalg.LinAlgError("the smoother's chain is singular")
    return means, covs


def evidence(
    measured: np.ndarray, info_vector: np.ndarray, links: Links, density: np.ndarray
) -> np.ndarray:
    """(c,) log evidence, up to a constant, of c candidates of noise density (c, n - 1, 7)
    on one chain.
    """
    seen = _whitened(measured, info_vector)
    return np.array([_filter(*seen, links, _noise(links, d))[0] for d in density])


def _whitened(
    measured: np.ndarray, info_vector: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n, 6, 12) and values (n, 6) of independent measurements of unit noise: measured
    = rows^T rows, info_vector = rows^T values (Cholesky). A direction that nothing fixes has
    a row of zeros."""
    rest, missed = measured.copy(), info_vector.copy()
    rows, values = np.zeros((len(rest), 6, DIM)), np.zeros((len(rest), 6))
    for j in range(6):
        pivot = rest[:, j, j].copy()
        known = pivot > _UNFIXED * measured[:, j, j]
        size = np.sqrt(np.where(known, pivot, np.inf))
        row = rest[:, j] / size[:, None]
        row[:, :j] = 0
        rows[:, j, :6], values[:, j] = row, missed[:, j] / size
        rest -= row[:, :, None] * row[:, None]
        missed -= row * values[:, j, None]
    return rows, values


def _noise(links: Links, density: np.ndarray) -> np.ndarray:
    """(n - 1, 12, 12) covariance of white acceleration over each link; density (n - 1, 7)."""
    dt = links.dt_s[:, None, None]
    white = density[:, :6, None] * np.eye(6) + density[:, 6, None, None] * links.shake
    gate = links.gate[:, :6, :6]
    place = gate @ white
    both = place * dt**2 / 2
    return np.block(
        [
            [place @ np.swapaxes(gate, 1, 2) * dt**3 / 3, both],
            [np.swapaxes(both, 1, 2), white * dt],
        ]
    )


def _filter(
    rows: np.ndarray, values: np.ndarray, links: Links, noise: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Log evidence, and states before and after their measurements; see `filter_chain`."""
    n = len(rows)
    states = [np.empty((n, *shape)) for shape in 2 * ((DIM,), (DIM, DIM))]
    log = filter_chain(_START, links.move, links.shift, noise, rows, values, *states)
    return log, *states
