"""A Gauss-Markov chain: Kalman filter, Rauch-Tung-Striebel smoother, and the evidence for
its noise.

State: 6 position-like and 6 velocity-like numbers. The first six are measured.
Covariance form: regular for a density of nearly zero, and for directions that no
measurement fixes. Source: docs/methods/pose.md#smoothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.analyse.pose.kernels import filter_chain

DIM = 12
# What is known before the first frame: nothing. Standard deviations of 10 (radians, or
# e-folds of distance) and of 100 per second lie beyond anything filmed, and their squares
# times the information of a corner still leave digits.
_START = np.diag([1e2] * 6 + [1e4] * 6)


class Chain(NamedTuple):
    """What was measured of each state, and how it follows from the one before:
    x_k+1 = move_k x_k + shift_k + noise_k, noise through `gate_k`.

    rows (n, 6, 6), values (n, 6) : independent measurements of unit noise, rows_k x_k[:6] =
    values_k; a row of zeros measures nothing
    move, gate : (n - 1, 12, 12);  shift : (n - 1, 12);  dt_s : (n - 1,)
    shake : (n - 1, 6, 6) covariance, per unit of its density, of what turns and moves the
    marker at once
    Only the turns' blocks (3 x 3, of angles and of their velocities) are free: the other
    axes have constant velocity."""

    rows: np.ndarray
    values: np.ndarray
    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    dt_s: np.ndarray
    shake: np.ndarray

    def part(self, first: int, end: int) -> Chain:
        """The states first .. end - 1."""
        links = (a[first : end - 1] for a in self[2:])
        return Chain(self.rows[first:end], self.values[first:end], *links)


def linked(
    rows: np.ndarray,
    values: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    offset: np.ndarray,
    dt_s: np.ndarray,
    shake: np.ndarray,
) -> Chain:
    """With links by residuals before_k x_k + after_k x_k+1 + offset_k = noise_k.

    after : 1 but for the turns
    """
    gate = after.copy()
    gate[:, :3, :3] = np.linalg.inv(after[:, :3, :3])
    shift = -np.einsum("nij,nj->ni", gate, offset)
    return Chain(rows, values, -gate @ before, gate, shift, dt_s, shake)


def smooth_chain(chain: Chain, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, 12) and covariance (n, 12, 12) of every state given all measurements.

    density : (n - 1, 7), or (7,) for all links
    """
    _, ahead_x, ahead_p, means, covs = _filter(chain, density)
    # gain^T = ahead^-1 move p, each axis scaled to its own size first
    size = 1 / np.sqrt(np.einsum("nii->ni", ahead_p[1:]))
    scaled = ahead_p[1:] * size[:, :, None] * size[:, None]
    gain = size[:, :, None] * np.linalg.solve(
        scaled, size[:, :, None] * (chain.move @ covs[:-1])
    )
    for k in range(len(means) - 2, -1, -1):
        means[k] += (means[k + 1] - ahead_x[k + 1]) @ gain[k]
        covs[k] += gain[k].T @ (covs[k + 1] - ahead_p[k + 1]) @ gain[k]
    if not (np.isfinite(means).all() and np.isfinite(covs).all()):
        raise np.linalg.LinAlgError("the smoother's chain is singular")
    return means, covs


def evidence(chain: Chain, density: np.ndarray) -> float:
    """Log evidence, up to a constant, of noise densities, as of smooth_chain."""
    return _filter(chain, density)[0]


def _filter(
    chain: Chain, density: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Log evidence, and states before and after their measurements; see `filter_chain`.

    The noise is white acceleration over each link."""
    dt = chain.dt_s[:, None, None]
    white = density[..., :6, None] * np.eye(6) + density[..., 6, None, None] * chain.shake
    gate = chain.gate[:, :6, :6]
    place = gate @ white
    both = place * dt**2 / 2
    noise = np.block(
        [
            [place @ np.swapaxes(gate, 1, 2) * dt**3 / 3, both],
            [np.swapaxes(both, 1, 2), white * dt],
        ]
    )
    rows, values, move, _, shift, *_ = chain
    n = len(rows)
    states = [np.empty((n, *shape)) for shape in 2 * ((DIM,), (DIM, DIM))]
    return filter_chain(_START, move, shift, noise, rows, values, *states), *states
