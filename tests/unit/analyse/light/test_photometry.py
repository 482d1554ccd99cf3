"""Bias and light out of patches: the numbers of docs/methods/light.md#numbers, both
formulas, and what cannot be solved.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from arfx.analyse.light.patches import WHITE, of_one_scale
from arfx.analyse.light.photometry import (
    DEGENERATE,
    EXACT,
    INK,
    MEASURED,
    PAPER,
    UNKNOWN_VARIANCE,
    Photometry,
    Tolerances,
    solve,
)
from arfx.papers.s1_gain import eq6_smallest_vector, gain_and_bias

RHO = np.where(WHITE, PAPER, INK)


def clip(
    frames: int = 40, bias: float = 0.02, noise: float = 0.0, seed: int = 0, low: float = 0.2, high: float = 0.9,
    rho: np.ndarray = RHO,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(intensity (t, p, 3), light (t, 3))"""
    rng = np.random.default_rng(seed)
    y = rng.uniform(low, high, (frames, 3))
    return rho[None, :, None] * y[:, None] + bias + rng.normal(0, noise, (frames, len(rho), 3)) if noise else (
        rho[None, :, None] * y[:, None] + bias
    ), y  # fmt: skip


def finite(p: Photometry) -> bool:
    arrays = (p.y, p.var_y_own, p.bias, p.bias_95, p.condition, p.misfit)
    return all(np.isfinite(a).all() for a in arrays)


@pytest.mark.parametrize(
    ("albedos", "nullity"),
    [([0.5], 2), ([0.5, 0.5, 0.5], 2), ([0.05, 0.88], 1), ([0.05, 0.88, 0.5], 1)],
)
@pytest.mark.parametrize("frames", [1, 2, 30])
@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("dense", [0, 100])
def test_nullity_of_the_papers_system(
    albedos: list[float], nullity: int, frames: int, constant: bool, dense: int
) -> None:
    rho = np.array(albedos)
    y = np.full(frames, 120.0) if constant else np.linspace(60, 200, frames)
    assert eq6_smallest_vector(y[:, None] * rho + 12, rho, dense).nullity == nullity


@pytest.mark.parametrize("scale", [255.0, 1.0])
def test_bias_without_noise_is_exact_in_both_formulas(scale: float) -> None:
    y = np.random.default_rng(0).uniform(60, 230, (25, 3))
    grey = (RHO[None, :, None] * y[:, None] + 12) * scale / 255
    for p in (solve(grey, None, RHO), gain_and_bias(grey, RHO)):
        assert p.verdict == MEASURED and finite(p)
        assert np.abs(p.bias * 255 / scale - 12).max() < 1e-9
        assert np.abs(p.y * 255 / scale - y).max() < 1e-8
    one = solve(grey[:1], None, RHO)  # a single frame is enough
    assert (
        one.verdict == MEASURED and np.abs(one.bias * 255 / scale - 12).max() < 1e-9
    )
    printed = gain_and_bias(grey, RHO, printed_bias=True)  # 1/b' in place of b'/g'
    assert np.abs(printed.bias * 255 / scale - 12).min() > 1


def test_the_papers_vector_is_biased_by_noise_and_by_the_units_and_least_squares_is_not() -> (
    None
):
    rho = np.linspace(0.45, 0.55, 8)
    found: dict[str, list[float]] = {"255": [], "1": []}
    for seed in range(120):
        rng = np.random.default_rng(seed)
        grey = rho * rng.uniform(100, 200, (6, 1)) + 12 + rng.normal(0, 2, (6, 8))
        found["255"].append(eq6_smallest_vector(grey, rho).bias)
        found["1"].append(255 * eq6_smallest_vector(grey / 255, rho).bias)
    in_255, in_1 = np.median(found["255"]), np.median(found["1"])
    assert 2.5 < in_255 < 4.5  # 3.4
    assert 5.4 < in_1 < 7.4  # 6.4
    many = []
    for rng in map(np.random.default_rng, range(60)):
        grey = rho * rng.uniform(80, 200, (60, 1)) + 12 + rng.normal(0, 2, (60, 8))
        many.append(float(solve(np.repeat(grey[..., None], 3, 2), None, rho).bias[0]))
    assert 11 < np.median(many) < 13  # 11.9


@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_the_interval_of_the_bias_holds_the_truth(noise: float) -> None:
    hit, wide = [], []
    for seed in range(150):
        grey, _ = clip(frames=6, noise=noise, seed=seed)
        p = solve(grey, np.full(grey.shape, noise**2), RHO, tolerances=EXACT)
        assert p.verdict == MEASURED
        hit += list((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02))
        wide.append(np.ptp(p.bias_95, axis=1).mean())
    assert 0.92 < np.mean(hit) <= 1
    assert np.mean(wide) < 6 * noise / np.sqrt(24)  # not by being vague


def test_the_inks_tolerance_is_in_the_interval() -> None:
    """Light that rests cannot tell the ink from the bias: the interval is as wide as what
    is known of inks.
    """
    grey, _ = clip(
        rho=np.where(WHITE, 0.87, 0.044), noise=1e-4, low=0.6, high=0.6
    )  # other print than assumed
    p = solve(
        grey,
        np.full(grey.shape, 1e-8),
        RHO,
        tolerances=Tolerances(transfer=0, steps=0, blur=0),
    )
    assert ((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02)).all()
    assert (
        np.abs(p.bias - 0.02).max() > 1e-3
        and 0.01 < np.ptp(p.bias_95, axis=1).max() < 0.04
    )
    exact = solve(grey, np.full(grey.shape, 1e-8), RHO, tolerances=EXACT)
    assert not ((exact.bias_95[:, 0] < 0.02) & (exact.bias_95[:, 1] > 0.02)).all()


def test_another_ink_is_in_the_interval_where_the_light_changes_too() -> None:
    for known in (True, False):
        grey, _ = clip(rho=np.where(WHITE, PAPER, 0.067), noise=5e-4)
        p = solve(
            grey,
            np.full(grey.shape, 2.5e-7) if known else None,
            RHO,
            tolerances=Tolerances(transfer=0, steps=0, blur=0),
        )
        assert ((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02)).all() and np.ptp(
            p.bias_95, axis=1
        ).max() < 0.02


def test_a_curve_of_another_exponent_is_in_the_interval() -> None:
    for exponent in (0.93, 1.07):
        grey, _ = clip(rho=np.where(WHITE, 0.85, 0.06), noise=2e-4)
        p = solve(np.abs(grey) ** exponent, np.full(grey.shape, 1e-7), RHO)
        assert ((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02)).all(), exponent
        narrow = solve(
            np.abs(grey) ** exponent,
            np.full(grey.shape, 1e-7),
            RHO,
            tolerances=Tolerances(transfer=0, steps=0, blur=0),
        )
        assert not (
            (narrow.bias_95[:, 0] < 0.02) & (narrow.bias_95[:, 1] > 0.02)
        ).any()


def test_a_codecs_steps_are_in_the_interval() -> None:
    grey, _ = clip(noise=2e-4)
    off = (
        grey + np.array([-0.0012, 0.0, 0.0012]) * ~WHITE[:, None]
    )  # chroma off by half a step in every dark cell
    p = solve(
        off,
        np.full(grey.shape, 4e-8),
        RHO,
        tolerances=Tolerances(ink_sigma=0, transfer=0),
    )
    assert (
        np.abs(p.bias - 0.02).max() > 1e-3
        and ((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02)).all()
    )
    narrow = solve(off, np.full(grey.shape, 4e-8), RHO, tolerances=EXACT)
    assert not ((narrow.bias_95[:, 0] < 0.02) & (narrow.bias_95[:, 1] > 0.02)).all()


DEGENERATES = {
    "one albedo": lambda g: np.where(WHITE[None, :, None], g, np.nan),
    "ink alone": lambda g: np.where(WHITE[None, :, None], np.nan, g),
    "single frame with one patch": lambda g: np.where(
        (np.arange(8) == 5)[None, :, None], g[:1], np.nan
    ),
    "all clipped": lambda g: np.full_like(g, np.nan),
    "black": lambda g: np.zeros_like(g),
    "no frames": lambda g: g[:0],
    "no contrast": lambda g: (
        np.full_like(g, 0.3) + np.random.default_rng(0).normal(0, 0.1, g.shape)
    ),
    "dark brighter": lambda g: g[:, ::-1],
    "infinite": lambda g: np.full_like(g, np.inf),
}


@pytest.mark.parametrize("case", DEGENERATES)
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("formula", ["corrected", "paper"])
def test_degenerate_systems_are_reported_and_nothing_non_finite_leaves(
    case: str, known: bool, formula: str
) -> None:
    grey, y = clip(noise=0.001)
    broken = DEGENERATES[case](grey)
    variance = (
        np.full(broken.shape, 1e-6 if case != "no contrast" else 1e-2)
        if known
        else None
    )
    p = (
        solve(broken, variance, RHO)
        if formula == "corrected"
        else gain_and_bias(broken, RHO)
    )
    assert finite(p)
    if formula == "paper" and case in (
        "black",
        "no contrast",
        "dark brighter",
        "no frames",
    ):
        return  # the paper solves anything; what it says is its own affair
    assert p.verdict == DEGENERATE and not p.bias.any() and not p.determined.any()
    assert "bias 0 assumed" in p.reason
    if case == "one albedo":  # the light comes from the bright patches alone
        assert np.abs(p.y - (y + 0.02 / PAPER)).max() < 0.01
        if formula == "corrected":
            assert "one albedo" in p.reason and (p.condition >= 1e12).all()


@pytest.mark.parametrize("difference", [1e-3, 1e-4, 0.0])
def test_albedos_that_hardly_differ_are_degenerate_beside_noise(
    difference: float,
) -> None:
    rho = np.where(WHITE, 0.5 + difference, 0.5)
    for noise, seed in [(n, s) for n in (1e-3, 1e-2) for s in range(20)]:
        grey, _ = clip(rho=rho, noise=noise, seed=seed)
        assert (
            solve(grey, np.full(grey.shape, noise**2), rho, tolerances=EXACT).verdict
            == DEGENERATE
        )
        assert solve(grey, None, rho, tolerances=EXACT).verdict == DEGENERATE
    grey, _ = clip(rho=rho)
    exact = solve(grey, None, rho, tolerances=EXACT)
    if difference:  # without noise they are two equations
        assert exact.verdict == MEASURED and np.abs(exact.bias - 0.02).max() < 1e-8
    else:
        assert exact.verdict == DEGENERATE


def test_a_nan_in_a_patch_costs_that_patch_alone() -> None:
    grey, y = clip(noise=0.0005)
    broken = grey.copy()
    broken[3, 2], broken[5, 6, 1], broken[7] = np.nan, np.inf, np.nan
    p = solve(broken, np.full(grey.shape, 0.0005**2), RHO)
    assert p.verdict == MEASURED and finite(p)
    assert (
        not p.seen[7]
        and (p.var_y_own[7] == UNKNOWN_VARIANCE).all()
        and not p.y[7].any()
    )
    assert np.abs(p.bias - 0.02).max() < 1e-3 and np.abs(p.y - y)[p.seen].max() < 5e-3


def test_one_channel_that_is_clipped_does_not_take_the_others_along() -> None:
    grey, y = clip(noise=0.0005)
    grey[:, WHITE, 0] = np.nan
    p = solve(grey, np.full(grey.shape, 0.0005**2), RHO)
    assert (
        p.verdict == DEGENERATE
        and p.determined.tolist() == [False, True, True]
        and p.reason.startswith("R:")
    )
    assert (
        p.bias[0] == 0
        and np.abs(p.bias[1:] - 0.02).max() < 1e-3
        and np.abs(p.y[:, 1:] - y[:, 1:]).max() < 5e-3
    )


def test_highlights_on_some_patches_do_little() -> None:
    grey, y = clip(frames=60, noise=0.001)
    rng = np.random.default_rng(0)
    hit = (rng.uniform(size=grey.shape[:2]) < 0.12)[..., None]
    p = solve(grey + 0.3 * hit, np.full(grey.shape, 1e-6), RHO)
    plain = [
        np.polyfit(
            np.repeat(y[:, c], 4), (grey + 0.3 * hit)[:, ~WHITE, c].ravel(), 1
        )[1]
        for c in range(3)
    ]
    assert (
        np.abs(p.bias - 0.02).max() < 4e-3
        and np.abs(np.array(plain) - 0.02).max() > 0.02
    )
    assert ((p.bias_95[:, 0] < 0.02) & (p.bias_95[:, 1] > 0.02)).all()


def test_a_highlight_over_a_glossy_print_is_no_light() -> None:
    """It lies on ink and paper alike, in some frames; a finger on one patch is none."""
    grey, y = clip(frames=60, noise=0.001)
    shine = np.zeros(60)
    shine[20:30] = np.linspace(0.02, 0.2, 10)
    p = solve(grey + shine[:, None, None], np.full(grey.shape, 1e-6), RHO)
    assert np.abs(p.bias - 0.02).max() < 1e-3
    assert np.abs(p.y - y).max() < 0.01
    two = np.arange(60) % 3 == 0
    inks = np.where(two[:, None], np.where(WHITE, PAPER, 0.08), RHO)
    calm = 0.4 + 0.1 * y
    mixed = inks[..., None] * calm[:, None] + 0.02
    off = [
        np.abs(
            solve(mixed, np.full(grey.shape, 1e-6), RHO, print_=of).y / calm - 1
        ).max()
        for of in (two.astype(int), None)
    ]
    assert off[0] < 0.01 < off[1], "another print's ink is no highlight"
    grey[40, 1] += 0.1
    covered = solve(grey, np.full(grey.shape, 1e-6), RHO)
    assert np.abs(covered.y[40] - y[40]).max() < 0.02


def test_the_large_system_of_the_paper_gives_what_the_dense_one_gives() -> None:
    grey, _ = clip(frames=60, noise=0.002)
    grey[4, 2] = np.nan
    a, b = (eq6_smallest_vector(grey[..., 0], RHO, dense) for dense in (100, 10))
    assert b.bias == pytest.approx(a.bias, abs=1e-8) and b.smallest == pytest.approx(
        a.smallest, rel=1e-6
    )
    assert (
        np.abs(a.y - b.y).max() < 1e-7
        and a.nullity == b.nullity == 0
        and a.rank == b.rank
    )
    exact = eq6_smallest_vector(clip(frames=60)[0][..., 0], RHO, 10)
    assert exact.nullity == 1 and exact.bias == pytest.approx(0.02, abs=1e-6)
    with pytest.raises(ValueError, match="no finite"):
        eq6_smallest_vector(np.full((3, 2), np.nan), np.array([0.1, 0.8]))


@pytest.mark.parametrize("formula", ["corrected", "paper"])
def test_time_is_linear_in_frames(formula: str) -> None:
    def seconds(frames: int) -> float:
        grey, _ = clip(frames=frames, noise=0.001)
        variance = np.full(grey.shape, 1e-6)
        best = np.inf
        for _ in range(3):
            start = time.perf_counter()
            p = (
                solve(grey, variance, RHO)
                if formula == "corrected"
                else gain_and_bias(grey, RHO)
            )
            best = min(best, time.perf_counter() - start)
        assert np.abs(p.bias - 0.02).max() < 1e-3
        return best

    assert seconds(10_000) < 25 * seconds(1000)  # quadratic: 100 times


@pytest.mark.parametrize(
    ("overexposed", "of_ink"), [(0, False), (3, False), (12, False), (27, True)]
)
def test_overexposed_readings_are_read_from_the_ink_on_the_papers_scale(
    overexposed: int, of_ink: bool
) -> None:
    """The ink is .06 in truth: read from it, light is 1.2 times as much. Where too few
    readings show both, all are, and so of one scale."""
    grey, y = clip(30, rho=np.where(WHITE, PAPER, 0.06), bias=0.0, noise=1e-5)
    clipped = np.zeros(grey.shape[:2])
    clipped[:overexposed, WHITE] = 1.0
    grey[:overexposed, WHITE] = np.nan
    variance = np.full(grey.shape, 1e-10)
    p = solve(grey, variance, RHO)
    rho = np.broadcast_to(RHO[:, None], grey.shape)
    light = of_one_scale(p, grey, variance, clipped, rho).y
    for c in range(3):
        line = np.polyfit(y[:, c], light[:, c], 1)
        assert line[0] == pytest.approx(1.2 if of_ink else 1.0, abs=0.03)
        assert np.abs(light[:, c] - np.polyval(line, y[:, c])).max() < 0.005
        if overexposed == 12:  # both kinds together have no one scale
            both = np.polyfit(y[:, c], p.y[:, c], 1)
            assert np.abs(p.y[:, c] - np.polyval(both, y[:, c])).max() > 0.02


def test_overexposed_readings_keep_their_light_where_the_others_have_one() -> None:
    """Readings that show ink and paper, all under one light, tell no scale."""
    rng = np.random.default_rng(3)
    y = np.repeat([[0.9], [1.4]], 20, 0)
    rho = np.broadcast_to(RHO[:, None], (40, 8, 3))
    grey = y[:, None] * rho + 1e-3 * rng.normal(size=rho.shape)
    clipped = np.zeros((40, 8))
    clipped[20:, WHITE] = 1.0
    grey[20:, WHITE] = np.nan
    variance = np.full(grey.shape, 1e-6)
    p = solve(grey, variance, RHO)
    light = of_one_scale(p, grey, variance, clipped, rho).y
    assert np.median(light[20:] / light[:20]) == pytest.approx(1.4 / 0.9, rel=0.1)
