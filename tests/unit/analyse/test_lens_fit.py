"""The lens from measured blur: recovered where the footage tells, refused where it does not."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.lens import MIN_EDGES, lens_from_blur


def edges(
    distance_m: np.ndarray,
    px_per_dioptre: float,
    focus_m: float,
    sharp_px: float,
    noise_px: float,
    seed: int = 0,
) -> np.ndarray:
    """Standard deviations of edges that such a lens blurs, px."""
    radius = px_per_dioptre * np.abs(1 / distance_m - 1 / focus_m)
    clean = np.sqrt(sharp_px**2 + radius**2 / 4)
    return clean + noise_px * np.random.default_rng(seed).normal(size=len(distance_m))


def test_exact_without_noise() -> None:
    z = np.linspace(0.3, 2.0, 40)
    fit = lens_from_blur(1 / z, edges(z, 6.0, 0.7, 0.6, 0.0))
    assert (
        fit.known
        and fit.px_per_dioptre == pytest.approx(6, rel=1e-9)
        and 1 / fit.focus == pytest.approx(0.7, rel=1e-9)
    )
    assert fit.sharp_px == pytest.approx(0.6, rel=1e-6)


def test_its_interval_holds_the_truth() -> None:
    z = np.linspace(0.35, 1.5, 120)
    inside = 0
    for seed in range(60):
        fit = lens_from_blur(1 / z, edges(z, 5.0, 0.6, 0.7, 0.08, seed), 0.08)
        assert fit.known
        inside += abs(fit.focus - 1 / 0.6) < fit.focus_ci95
    assert inside >= 51, (
        "95 % of 60 is 57; fewer than 51 has a chance below 1 in 1,000"
    )


def test_frames_blurred_by_motion_do_not_move_it() -> None:
    z = np.linspace(0.35, 1.5, 200)
    s = edges(z, 5.0, 0.6, 0.7, 0.05)
    s[::9] += 4.0
    fit = lens_from_blur(1 / z, s, 0.05)
    assert fit.known and fit.focus == pytest.approx(1 / 0.6, rel=0.05)


@pytest.mark.parametrize(
    ("z", "s", "words"),
    [
        (np.linspace(0.3, 2, MIN_EDGES - 1), np.ones(MIN_EDGES - 1), "at least"),
        (np.full(50, 0.6), np.full(50, 1.0), "any focus explains"),
        (np.linspace(0.6, 0.61, 50), np.full(50, 1.0), "differ by 1.5 %"),
        (
            np.linspace(0.3, 2, 50),
            edges(np.linspace(0.3, 2, 50), 0.0, 1.0, 0.8, 0.05),
            "does not grow",
        ),
        (
            np.repeat([0.5, 1.0], 30),
            np.repeat([1.0, 2.0], 30),
            "a parabola from a line",
        ),
        (np.linspace(0.3, 2, 50), np.full(50, np.nan), "0 edges"),
        (np.linspace(-2, -1, 50), np.full(50, 1.0), "0 edges"),
    ],
)
def test_refused_where_the_footage_does_not_tell(
    z: np.ndarray, s: np.ndarray, words: str
) -> None:
    fit = lens_from_blur(1 / z, s, 0.05)
    assert not fit.known and words in fit.reason
    assert fit.focus_ci95 == np.inf
