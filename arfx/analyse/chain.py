"""A Gauss-Markov chain over one shot: Kalman filter, Rauch-Tung-Striebel smoother and the evidence for its noise.

State per frame: 6 position-like and 6 velocity-like numbers. Between frames white noise accelerates each axis with
its own density q (units^2 / s^3), covariance q (dt^3/3, dt^2/2; dt^2/2, dt): exact for irregular frame times; a seventh
density accelerates several axes at once (Links.shake).
Measurements come as information on the first six numbers, zero where nothing was seen. Covariance form: stays regular
for a density of nearly zero (a marker at rest) and for directions that no measurement fixes.
Source: Barfoot, State Estimation for Robotics, 2nd ed., sections 3.1-3.3 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.analyse import chain_kernels as kernels
from arfx.analyse.chain_kernels import DIM

# What is known before the first frame: nothing. Standard deviations of 10 (radians, or e-folds of distance) and of
# 100 per second lie beyond anything filmed, and their squares times the information of a corner still leave digits.
_START = np.diag([1e2] * 6 + [1e4] * 6)


@dataclass(frozen=True)
class Links:
    """How a state follows from the one before: x_k+1 = move_k x_k + shift_k + noise_k, noise through `gate_k`.

    move, gate : (n - 1, 12, 12);  shift : (n - 1, 12);  dt_s : (n - 1,)
    shake : (n - 1, 6, 6) covariance, per unit of its density, of what turns and moves the marker at once
    Only the turns' blocks (3 x 3, of angles and of their velocities) are free: the other axes have constant velocity.
    """

    move: np.ndarray
    gate: np.ndarray
    shift: np.ndarray
    dt_s: np.ndarray
    shake: np.ndarray

    def part(self, first: int, end: int) -> Links:
        """The links between frames first .. end - 1."""
        s = slice(first, end - 1)
        return Links(self.move[s], self.gate[s], self.shift[s], self.dt_s[s], self.shake[s])


def link(before: np.ndarray, after: np.ndarray, offset: np.ndarray, dt_s: np.ndarray, shake: np.ndarray) -> Links:
    """Links from residuals before_k x_k + after_k x_k+1 + offset_k = noise_k."""
    gate = np.linalg.inv(after) if len(after) else after
    return Links(-gate @ before, gate, -np.einsum("nij,nj->ni", gate, offset), dt_s, shake)


def smooth_chain(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, 12) and covariance (n, 12, 12) of every state given all measurements.

    measured : (n, 6, 6) information;  pull : (n, 6) information times measured value;  density : (n - 1, 7)
    """
    n = len(measured)
    means, covs = np.empty((n, DIM)), np.empty((n, DIM, DIM))
    m, g, move, gate, shift, shake, dt, q = _arrays(measured, pull, links, density)
    kernels.filter_and_smooth(m, g, move, gate, shift, shake, dt, q, _START, means, covs)
    if not (np.isfinite(means).all() and np.isfinite(covs).all()):
        raise np.linalg.LinAlgError("the smoother's chain is singular")
    return means, covs


def evidence(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> np.ndarray:
    """(c,) log evidence, up to a constant, of c candidates of noise density (c, n - 1, 7) on one chain."""
    out = np.empty(len(density))
    m, g, move, gate, shift, shake, dt, q = _arrays(measured, pull, links, density)
    kernels.log_evidence(m, g, move, gate, shift, shake, dt, q, _START, out)
    return out


def _arrays(measured: np.ndarray, pull: np.ndarray, links: Links, density: np.ndarray) -> list[np.ndarray]:
    """Copies, all of one type to the compiler: contiguous and writable."""
    given = (measured, pull, links.move, links.gate, links.shift, links.shake, links.dt_s, density)
    return [np.array(a, float, order="C") for a in given]
