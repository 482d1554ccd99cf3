"""The smoother's chain against dense Gaussian algebra."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.pose.chain import (
    DIM,
    Chain,
    covariances,
    information_of_noise,
    least_density,
    smooth_chain,
)
from arfx.analyse.pose.smooth import LEAST, LONGEST_STEP_S, MOST, SHORTEST_STEP_S

N = 6
RNG = np.random.default_rng(2)
DT = np.array([0.033, 0.033, 0.1, 0.02, 0.05])


def noise(density: np.ndarray, dt_s: float, shake: np.ndarray) -> np.ndarray:
    """(12, 12) covariance of white acceleration over dt_s."""
    one = np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    together = shake @ shake.T + 1e-8 * np.eye(6)
    return np.kron(one, np.diag(density[:6]) + density[6] * together)


def problem() -> tuple:
    i = np.arange(6)
    after = np.tile(np.eye(DIM), (N - 1, 1, 1))
    after[:, :3, :3] += RNG.normal(0, 0.05, (N - 1, 3, 3))
    before = np.tile(-np.eye(DIM), (N - 1, 1, 1))
    before[:, i, i + 6] = -DT[:, None]
    offset = np.zeros((N - 1, DIM))
    offset[:, :6] = RNG.normal(0, 0.02, (N - 1, 6))
    root = RNG.normal(0, 20, (N, 6, 6))
    measured = root @ np.swapaxes(root, 1, 2)
    measured[2] = 0  # a frame without a marker
    measured[3, :2] = measured[3, :, :2] = 0  # two directions not fixed
    pull = np.einsum("nij,nj->ni", measured, RNG.normal(0, 0.1, (N, 6)))
    density = 10.0 ** RNG.uniform(-3, 1, (N - 1, 7))
    axes = RNG.normal(0, 1, (N - 1, 6, 2))
    return measured, pull, before, after, offset, density, axes


def chain(
    measured: np.ndarray,
    pull: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    offset: np.ndarray,
    dt_s: np.ndarray,
    shake: np.ndarray,
) -> Chain:
    links = np.concatenate([before, after], -1)
    firm = information_of_noise(dt_s)
    return Chain(
        measured, pull, links, offset, firm, shake, least_density(measured, firm)
    )


def dense(measured: np.ndarray, pull: np.ndarray, before: np.ndarray, after: np.ndarray, offset: np.ndarray,
          density: np.ndarray, shake: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:  # fmt: skip
    """Mean, covariance and log evidence of the whole trajectory at once."""
    a, g = np.zeros((N * DIM, N * DIM)), np.zeros(N * DIM)
    start = np.diag([1e-2] * 6 + [1e-4] * 6)
    a[:DIM, :DIM] += start
    log = 0.5 * np.linalg.slogdet(start)[1]
    for k in range(N):
        s = slice(k * DIM, k * DIM + 6)
        a[s, s] += measured[k]
        g[s] += pull[k]
    for k in range(N - 1):
        j = np.zeros((DIM, N * DIM))
        j[:, k * DIM : (k + 1) * DIM], j[:, (k + 1) * DIM : (k + 2) * DIM] = (
            before[k],
            after[k],
        )
        w = np.linalg.inv(noise(density[k], DT[k], shake[k]))
        a += j.T @ w @ j
        g -= j.T @ w @ offset[k]
        log += 0.5 * np.linalg.slogdet(w)[1] - 0.5 * offset[k] @ w @ offset[k]
    cov = np.linalg.inv(a)
    mean = cov @ g
    return (
        mean.reshape(N, DIM),
        cov,
        log + 0.5 * g @ mean - 0.5 * np.linalg.slogdet(a)[1],
    )


def smoothed(seen: Chain, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances."""
    found = smooth_chain(seen, density)
    return found.mean, covariances(found.factor)


def evidence(seen: Chain, density: np.ndarray) -> float:
    return smooth_chain(seen, density).evidence


def test_smoother_and_evidence_are_those_of_the_whole_problem() -> None:
    measured, pull, before, after, offset, density, shake = problem()
    seen = chain(measured, pull, before, after, offset, DT, shake)
    mean, cov = smoothed(seen, density)
    expected, dense_cov, log = dense(
        measured, pull, before, after, offset, density, shake
    )
    np.testing.assert_allclose(mean, expected, rtol=1e-5, atol=5e-6)
    for k in range(N):
        s = slice(k * DIM, (k + 1) * DIM)
        np.testing.assert_allclose(cov[k], dense_cov[s, s], rtol=1e-4, atol=1e-6)
    other = density * 3
    _, _, log_other = dense(measured, pull, before, after, offset, other, shake)
    got = evidence(seen, density) - evidence(seen, other)
    assert got == pytest.approx(log - log_other, rel=1e-5, abs=1e-4)
    one = density[:1]  # for all links
    assert evidence(seen, one[0]) == evidence(seen, one)
    assert evidence(seen, one) == pytest.approx(evidence(seen, one.repeat(N - 1, 0)))


@pytest.mark.parametrize("dt_s", [SHORTEST_STEP_S, 1 / 30, LONGEST_STEP_S])
@pytest.mark.parametrize("q", [LEAST, 1e-6, 1.0, MOST])
def test_extreme_noise_stays_regular(q: float, dt_s: float) -> None:
    n = 300
    dt = np.full(n - 1, dt_s)
    i = np.arange(6)
    before, after = (
        np.tile(-np.eye(DIM), (n - 1, 1, 1)),
        np.tile(np.eye(DIM), (n - 1, 1, 1)),
    )
    before[:, i, i + 6] = -dt[:, None]
    links = before, after, np.zeros((n - 1, DIM)), dt, np.zeros((n - 1, 6, 2))
    measured = np.tile(np.diag([1e2, 1e4, 1e6, 1e9, 1e9, 1e6]), (n, 1, 1))
    value = np.random.default_rng(0).normal(0, 1, (n, 6)) / np.sqrt(
        np.diag(measured[0])
    )
    pull = np.einsum("nij,nj->ni", measured, value)
    mean, cov = smoothed(chain(measured, pull, *links), np.full((n - 1, 7), q))
    assert np.isfinite(mean).all() and (np.linalg.eigvalsh(cov[:, :6, :6]) > 0).all()
    spread = np.sqrt(np.einsum("nii->ni", cov)[:, :6])
    assert (np.abs(mean[:, :6]) < 6 * spread + 1e-9).all()
    assert (
        spread <= 1 / np.sqrt(np.diag(measured[0])) * 1.0001
    ).all()  # never worse than a frame alone


@pytest.mark.parametrize("tilt", [1e-8, 1e-3, 1.0])
def test_a_tilt_that_no_frame_tells_stays_regular(tilt: float) -> None:
    n, dt_s = 200, np.full(199, SHORTEST_STEP_S)
    before = np.tile(-np.eye(DIM) - SHORTEST_STEP_S * np.eye(DIM, k=6), (n - 1, 1, 1))
    after, shake = np.tile(np.eye(DIM), (n - 1, 1, 1)), np.zeros((n - 1, 6, 2))
    size = np.array([tilt, tilt, 1e4, 1e9, 1e9, 1e4])
    value = np.random.default_rng(0).normal(0, 1, (n, 6)) / np.sqrt(size)
    seen = chain(
        np.tile(np.diag(size), (n, 1, 1)),
        value * size,
        before,
        after,
        after[:, 0] * 0,
        dt_s,
        shake,
    )
    mean, cov = smoothed(seen, np.full(7, LEAST))
    assert np.isfinite(mean).all() and (np.linalg.eigvalsh(cov[:, :6, :6]) > 0).all()
    assert (np.abs(mean[:, :6]) < 6 / np.sqrt(size)).all()
    # a guess far too low: more noise is taken until something is left of the measurements
    bent = seen.links + 0.05 * np.random.default_rng(1).normal(0, 1, seen.links.shape)
    firmer = seen._replace(links=bent, least=seen.least * 1e-15)
    assert np.isfinite(smooth_chain(firmer, np.full(7, 1e-25)).mean).all()


def test_axes_that_are_all_but_bound_together_stay_regular() -> None:
    """A camera turned wildly about itself, and nothing else moves: turn and place are one,
    to nine digits and more.
    """
    n, density = 150, np.array([LEAST] * 6 + [MOST])
    dt, i = np.full(n - 1, 1 / 30), np.arange(6)
    before, after = (
        np.tile(-np.eye(DIM), (n - 1, 1, 1)),
        np.tile(np.eye(DIM), (n - 1, 1, 1)),
    )
    before[:, i, i + 6] = -dt[:, None]
    together = np.array([[1, 0], [0, 1], [0, 0], [0, 1.1], [-1.1, 0], [0.1, -0.2]])
    bound = np.tile(together, (n - 1, 1, 1))
    links = before, after, np.zeros((n - 1, DIM)), dt, bound
    size = np.array([1e2, 1e2, 1e3, 1e5, 1e5, 1e3])  # 1 / standard deviation
    rng = np.random.default_rng(1)
    pan = np.cumsum(rng.normal(0, 0.2, (n, 2)), 0)
    value = pan @ together.T + rng.normal(0, 1, (n, 6)) / size
    measured = np.tile(np.diag(size**2), (n, 1, 1))
    seen = chain(measured, value * size**2, *links)
    mean, cov = smoothed(seen, np.tile(density, (n - 1, 1)))
    assert (np.linalg.eigvalsh(cov[:, :6, :6] * np.outer(size, size)) > 0).all()
    error = (mean[:, :6] - pan @ together.T) * size
    assert (np.abs(error) < 6).all()
    assert (
        np.sqrt((error[:, :2] ** 2).mean()) < 0.3
    )  # a turn is known from the place, not from its own measurement alone
    best = evidence(seen, np.tile(density, (n - 1, 1)))
    assert (
        best < 0.5 * (value**2 * size**2).sum()
    )  # no likelihood exceeds that of a perfect fit


def test_two_short_links_are_one_long_link() -> None:
    def last(dt: list[float]) -> np.ndarray:
        n = len(dt)
        i = np.arange(6)
        before, after = (
            np.tile(-np.eye(DIM), (n, 1, 1)),
            np.tile(np.eye(DIM), (n, 1, 1)),
        )
        before[:, i, i + 6] = -np.array(dt)[:, None]
        links = before, after, np.zeros((n, DIM)), np.array(dt), np.ones((n, 6, 2))
        seen = np.zeros((n + 1, 6, 6))
        seen[0] = np.eye(6) * 1e6
        density = np.tile([1.0, 2, 3, 4, 5, 6, 0.5], (n, 1))
        return smoothed(chain(seen, np.zeros((n + 1, 6)), *links), density)[1][-1]

    short, long = last([0.02, 0.05]), last([0.07])
    size = np.sqrt(np.diag(long))
    np.testing.assert_allclose(
        short / size / size[:, None], long / size / size[:, None], atol=1e-6
    )
