"""FLIP, CIEDE2000 and SSIM: known values, their range, and that a mask changes nothing but
the price.
"""

import numpy as np
import pytest

from arfx.measure.difference import MARGIN_PX, delta_e, difference, flip_map, ssim_map

BLACK, WHITE = np.zeros((12, 14, 3), np.uint8), np.full((12, 14, 3), 255, np.uint8)


def pair(h: int, w: int, noise: float = 12) -> tuple[np.ndarray, np.ndarray]:
    r = np.random.default_rng(0)
    a = r.integers(0, 256, (h, w, 3))
    return a.astype(np.uint8), np.clip(
        a + r.normal(0, noise, a.shape), 0, 255
    ).astype(np.uint8)


def test_equal_pictures_differ_by_nothing_and_black_from_white_by_the_most() -> None:
    a, _ = pair(24, 31)
    assert (
        flip_map(a, a).max() < 1e-5
        and delta_e(a, a).max() == 0
        and ssim_map(a, a).min() == 1
    )
    assert flip_map(BLACK, WHITE) == pytest.approx(0.9674, abs=1e-3)
    assert delta_e(BLACK, WHITE) == pytest.approx(100, abs=1e-3)
    assert ssim_map(BLACK, WHITE) == pytest.approx(1e-4, abs=1e-6), (
        "C1 / (255^2 + C1)"
    )


def test_every_figure_grows_with_the_difference() -> None:
    whole = np.ones((40, 40), bool)
    found = [difference(*pair(40, 40, noise), whole) for noise in (3, 12, 50)]
    assert [d.flip for d in found] == sorted(d.flip for d in found) and found[
        0
    ].flip > 0.01
    assert [d.delta_e for d in found] == sorted(d.delta_e for d in found) and found[
        0
    ].delta_e > 0.5
    assert [d.ssim for d in found] == sorted(
        (d.ssim for d in found), reverse=True
    ) and found[0].ssim > 0.9


def test_a_mask_gives_the_numbers_of_the_whole_picture() -> None:
    a, b = pair(70, 80)
    where = np.zeros((70, 80), bool)
    where[25:40, 30:52] = True
    where[30, 35] = False
    d = difference(a, b, where)
    assert d.flip == pytest.approx(flip_map(a, b)[where].mean(), abs=2e-5)
    assert d.ssim == pytest.approx(ssim_map(a, b)[where].mean(), abs=1e-9)
    assert d.delta_e == pytest.approx(delta_e(a, b)[where].mean(), abs=1e-9)
    narrower = flip_map(
        a[28:37, 33:49], b[28:37, 33:49]
    )  # without the surroundings they are others: the reach is needed
    assert (
        np.abs(narrower - flip_map(a, b)[28:37, 33:49]).max() > 1e-2
        and MARGIN_PX >= 10
    )


def test_a_picture_smaller_than_the_filters_has_its_figures_too() -> None:
    d = difference(BLACK[:3, :4], WHITE[:3, :4], np.ones((3, 4), bool))
    assert (
        d.mean == 255
        and 0 <= d.ssim < 0.01
        and d.delta_e == pytest.approx(100, abs=1e-3)
    )
