"""The thin lens: numbers of docs/methods/dof.md#numbers, and every place where a formula
might have a pole.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from arfx.core.lens import Lens, circle_of_confusion_mm, depth_of_field, hyperfocal_mm
from arfx.errors import InputError

EXAMPLE = Lens(200.0, 11.0, 2500.0)
COC = 0.035


def test_numbers_as_they_should_be() -> None:
    d = depth_of_field(EXAMPLE, COC)
    assert d.front_mm == pytest.approx(
        54.1451, abs=1e-4
    ) and d.back_mm == pytest.approx(56.5967, abs=1e-4)
    assert (
        d.front_mm is not None
        and d.back_mm is not None
        and d.total_mm == d.front_mm + d.back_mm
    )
    assert d.hyperfocal_mm == pytest.approx(104_096.10, abs=0.01)
    # consistent with the circle itself, which the printed limits are not
    at = circle_of_confusion_mm([2500 - d.front_mm, 2500 + d.back_mm], EXAMPLE)
    np.testing.assert_allclose(at, COC, rtol=0, atol=1e-9)
    f2 = 200.0**2  # equation 6 with all of its factors squared is the sum of 4 and 5
    k = 11 * COC * 2500
    assert 2 * f2 * k * 2500 / (f2**2 - k**2) == pytest.approx(120.3822, abs=1e-4)


def test_circle_is_the_printed_equation_3() -> None:
    distance = np.array([300.0, 900.0, 2400.0, 2600.0, 9000.0, 1e9])
    printed = 200.0**2 * np.abs(distance - 2500) / ((2500 - 200) * 11 * distance)
    np.testing.assert_allclose(
        circle_of_confusion_mm(distance, EXAMPLE), printed, rtol=1e-12
    )
    assert circle_of_confusion_mm(np.inf, EXAMPLE) == pytest.approx(1.58103, abs=1e-5)
    assert circle_of_confusion_mm(2500.0, EXAMPLE) == 0.0


@pytest.mark.parametrize("distance", [0.0, -1.0, -np.inf, np.nan])
def test_no_surface_has_no_circle(distance: float) -> None:
    assert circle_of_confusion_mm(distance, EXAMPLE) == 0.0


def test_circle_is_bounded_towards_the_lens() -> None:
    near = circle_of_confusion_mm(np.array([2.0, 1.0, 1e-6, 5e-324]), EXAMPLE)
    assert np.isfinite(near).all() and (near == near[0]).all()
    assert np.isfinite(circle_of_confusion_mm(5e-324, Lens(50, 2, math.inf)))


@pytest.mark.parametrize("focus", [200.0, 100.0, 0.0, -5.0, math.nan])
def test_focus_within_the_focal_length_is_an_input_error(focus: float) -> None:
    with pytest.raises(InputError, match="cannot be focused"):
        Lens(200.0, 11.0, focus)


@pytest.mark.parametrize("beyond", [1e-3, 1e-9, 1e-12])
def test_focus_down_to_the_focal_length_stays_finite(beyond: float) -> None:
    lens = Lens(200.0, 11.0, 200.0 + beyond)
    assert np.isfinite(
        circle_of_confusion_mm([1e-3, 200.0, 200.0 + beyond, 1e9, np.inf], lens)
    ).all()
    d = depth_of_field(lens, COC)
    assert (
        d.front_mm is not None
        and 0 <= d.front_mm < lens.focus_mm
        and d.back_mm is not None
        and math.isfinite(d.back_mm)
    )


def test_focus_at_infinity() -> None:
    lens = Lens(200.0, 11.0, math.inf)
    assert lens.coc_at_infinity_mm == 0.0
    assert circle_of_confusion_mm(np.inf, lens) == 0.0
    assert circle_of_confusion_mm(10_000.0, lens) == pytest.approx(
        200.0**2 / 11 / 10_000
    )
    far = float(circle_of_confusion_mm(10_000.0, Lens(200.0, 11.0, 1e12)))
    assert far == pytest.approx(
        float(circle_of_confusion_mm(10_000.0, lens)), rel=1e-6
    )


@pytest.mark.parametrize("step", [-1e-9, 0.0, 1e-9])
def test_around_the_hyperfocal_distance(step: float) -> None:
    h = hyperfocal_mm(200.0, 11.0, COC)
    d = depth_of_field(Lens(200.0, 11.0, h * (1 + step)), COC)
    assert d.front_mm == pytest.approx(h / 2, rel=1e-8)
    assert d.back_mm is not None and d.back_mm > 1e12 and not math.isnan(d.back_mm)
    assert step < 0 or d.back_mm > 1e17


def test_a_closed_aperture_is_a_pinhole() -> None:
    for fnumber in (1e12, math.inf):
        lens = Lens(50.0, fnumber, 1000.0)
        assert circle_of_confusion_mm([1.0, 500.0, np.inf], lens).max() < 1e-6
        d = depth_of_field(lens, COC)
        assert d.front_mm == pytest.approx(1000.0) and d.back_mm == math.inf


@pytest.mark.parametrize("coc", [0.0, -1.0, math.nan, math.inf])
def test_a_circle_without_size_is_an_input_error(coc: float) -> None:
    with pytest.raises(InputError, match="circle of confusion"):
        depth_of_field(EXAMPLE, coc)


@pytest.mark.parametrize(
    ("focal", "fnumber"),
    [(0.0, 2.0), (-1.0, 2.0), (math.inf, 2.0), (50.0, 0.0), (50.0, math.nan)],
)
def test_impossible_lenses_are_input_errors(focal: float, fnumber: float) -> None:
    with pytest.raises(InputError):
        Lens(focal, fnumber, 1e4)
