"""A Gauss-Markov chain: the mean, the covariance and the evidence of all its states at once.

State: 6 position-like and 6 velocity-like numbers. The first six are measured. The
information of all states is a matrix of 24 diagonals: solved by its banded Cholesky factor,
whose diagonal gives the evidence; covariances by Takahashi's recursion (1973).
Source: docs/methods/pose.md#smoothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

DIM = 12
_UPPER = np.triu(np.ones((DIM, 2 * DIM)))
# What is known before the first frame: nothing. Standard deviations of 10 (radians, or
# e-folds of distance) and of 100 per second lie beyond anything filmed.
_START = np.diag([1e-2] * 6 + [1e-4] * 6)
# of the least measurement's information, what the links' rounding may be at most: 1e-16 of
# theirs for each of a thousand frames
_DIGITS = 1e-13
_MOST = (
    1e12  # no motion is so quick: it is not for its firmness that nothing is found
)
# share of a shake in which its axes go their own ways: 1e-4 of its size
_LOOSE = 1e-8


class Chain(NamedTuple):
    """What was measured of each state, and how it is linked to the next:
    links_k [x_k, x_k+1] + offset_k = noise_k, white acceleration for a while.

    information (n, 6, 6), pull (n, 6) : of the measurements, and this times what they
    measured; zero where there are none
    links : (n - 1, 12, 24);  offset : (n - 1, 12)
    firm : (n - 1, 2, 2) information of noise of unit density about place and velocity
    shake : (n - 1, 6, 2) what turns and moves the marker at once, about two axes
    least : (n - 1, 1) densities below it count as it, see least_density"""

    information: ndarray
    pull: ndarray
    links: ndarray
    offset: ndarray
    firm: ndarray
    shake: ndarray
    least: ndarray

    def part(self, first: int, end: int) -> Chain:
        """The states first .. end - 1."""
        links = (a[first : end - 1] for a in self[2:])
        return Chain(self.information[first:end], self.pull[first:end], *links)


class Smoothed(NamedTuple):
    """mean (n, 12);  factor (25, 12 n) : lower banded Cholesky factor of the information of
    all states;  evidence : its logarithm, up to a constant of the chain"""

    mean: ndarray
    factor: ndarray
    evidence: float


def information_of_noise(dt_s: ndarray) -> ndarray:
    """(n, 2, 2) about place and velocity, of white acceleration of unit density over dt_s
    (n,): inverse of [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]].
    """
    both = -6 / dt_s**2
    return np.moveaxis(np.array([[12 / dt_s**3, both], [both, 4 / dt_s]]), -1, 0)


def typical_information(information: ndarray) -> float:
    """About the direction of a state that is known least, median of those that are seen.
    Arguments as of Chain.
    """
    seen = information[information.any((1, 2))]
    return float(np.median(np.linalg.eigvalsh(seen)[:, 0])) if len(seen) else 1.0


def least_density(information: ndarray, firm: ndarray) -> ndarray:
    """(n - 1, 1) with which rounding leaves digits of the measurements beside the links: a
    motion so slow is smoothed over some 800 frames. Arguments as of Chain.
    """
    return _DIGITS * firm[:, 0, :1] / max(typical_information(information), 1e-9)


def smooth_chain(chain: Chain, density: ndarray) -> Smoothed:
    """Every state given all measurements.

    density : (n - 1, 7) of the noise, or (7,) for all links; where rounding leaves no digits
    of the measurements, so much larger that it does
    Raises LinAlgError for numbers that are not finite."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    n = len(chain.information)
    # the inverse of white noise's covariance by Woodbury's identity: of what the shake frees
    # no digits are lost beside what hardly moves
    own = np.maximum(density[..., :6], chain.least) + _LOOSE * density[..., 6:]
    shake = density[..., 6, None, None]
    axes = chain.shake / own[..., None]
    freed = np.eye(2) + shake * (np.swapaxes(chain.shake, 1, 2) @ axes)
    undone = axes @ np.linalg.solve(freed, np.swapaxes(axes, 1, 2))
    firm = np.eye(6) / own[..., None] - shake * undone
    firm = chain.firm[:, :, None, :, None] * firm[:, None, :, None]
    firm = firm.reshape(-1, DIM, DIM)
    held = firm @ chain.links
    before, after = np.split(np.swapaxes(chain.links, 1, 2), 2, axis=1)
    # a column of the band begins at its diagonal: 24 numbers farther than the one before
    # it, for rows of 25
    band = np.zeros((n, DIM, 2 * DIM + 1))
    rows = band.reshape(n, -1)[:, : 2 * DIM**2].reshape(n, DIM, 2 * DIM)
    rows[:, :6, :6] = chain.information
    rows[0, :, :DIM] += _START
    rows[:-1] += before @ held
    rows[1:, :, :DIM] += after @ held[..., DIM:]
    rows *= _UPPER
    right = np.zeros((n, DIM))
    right[:, :6] = chain.pull
    push = (chain.offset[:, None] @ held)[:, 0]
    right[:-1] -= push[:, :DIM]
    right[1:] -= push[:, DIM:]
    lower = band.reshape(-1, 2 * DIM + 1).T
    try:
        factor = cholesky_banded(
            lower, overwrite_ab=True, lower=True, check_finite=False
        )
    except np.linalg.LinAlgError:
        if chain.least.max() > _MOST:
            raise
        return smooth_chain(chain._replace(least=10 * chain.least), density)
    mean = cho_solve_banded((factor, True), right.ravel(), check_finite=False)
    if not np.isfinite(mean).all():
        raise np.linalg.LinAlgError("the smoother's chain is not finite")
    missed = ((chain.offset[:, None] @ firm)[:, 0] * chain.offset).sum()
    log = (right.ravel() @ mean - missed) / 2
    log -= np.log(factor[0]).sum()
    log -= (np.log(own).sum(-1) + np.linalg.slogdet(freed)[1]).sum()
    return Smoothed(mean.reshape(n, DIM), factor, float(log))


def covariances(factor: ndarray) -> ndarray:
    """(n, 12, 12) of every state given all measurements. factor : of Smoothed"""
    n = factor.shape[1] // DIM
    rows = factor.T.reshape(n, -1)[:, : 2 * DIM**2].reshape(n, DIM, 2 * DIM)
    inverse = np.linalg.inv(rows[..., :DIM])
    gain = inverse @ rows[..., DIM:]
    out = inverse @ np.swapaxes(inverse, 1, 2)
    for k in range(n - 2, -1, -1):
        out[k] += gain[k] @ out[k + 1] @ gain[k].T
    return out
