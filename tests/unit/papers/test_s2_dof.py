"""Zhao et al. 2012 as printed: the paper's numbers, the poles of its limits, bleed and blend."""

from __future__ import annotations

import math

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.lens import Lens, circle_of_confusion_mm
from arfx.errors import ConfigError, InputError
from arfx.papers.s2_dof import PrintedDof, PrintedDofParams, blur_factor, eq8_bleed, hyperfocal, printed_limits
from arfx.stages.dof.optics import circle_of_confusion
from tests.scenes import facts, scene
from tests.unit.stages.dof_scenes import blurred, shot

EXAMPLE = Lens(200.0, 11.0, 2500.0)
COC = 0.035


def test_numbers_of_the_paper() -> None:
    d = printed_limits(EXAMPLE, COC)
    assert d.front_mm is not None and d.back_mm is not None
    assert d.front_mm == pytest.approx(58.7428, abs=1e-4) and d.back_mm == pytest.approx(61.6394, abs=1e-4)
    assert d.front_mm + d.back_mm == pytest.approx(120.3822, abs=1e-4)
    assert d.total_mm == pytest.approx(120.3125, abs=1e-4)
    assert d.hyperfocal_mm == pytest.approx(103_896.10, abs=0.01)
    assert d.coc_at_infinity_mm == pytest.approx(1.58103, abs=1e-5)
    assert (2500 - d.front_mm) / 1e3 == pytest.approx(2.4413, abs=1e-4)
    assert (2500 + d.back_mm) / 1e3 == pytest.approx(2.5616, abs=1e-4)


@pytest.mark.parametrize("step", [-1e-9, 0.0, 1e-9])
def test_around_the_hyperfocal_distance(step: float) -> None:
    h = hyperfocal(11.0, COC, 200.0)
    printed = printed_limits(Lens(200.0, 11.0, h * (1 + step)), COC)
    assert printed.front_mm == pytest.approx(h / 2, rel=1e-8)
    assert printed.back_mm is None if step > 0 else printed.back_mm is None or printed.back_mm > 1e12


def test_a_closed_aperture_has_no_limit_behind() -> None:
    for fnumber in (1e12, math.inf):
        d = printed_limits(Lens(50.0, fnumber, 1000.0), COC)
        assert d.front_mm == pytest.approx(1000.0) and d.back_mm is None and d.total_mm is None
    with pytest.raises(InputError, match="circle of confusion"):
        printed_limits(EXAMPLE, 0.0)


def test_settings_say_what_would_be_right() -> None:
    for setting, words in (({"mean_px": 4}, "odd"), ({"near_m": -1.0}, "between 0 and"), ({"coc_mm": 0.0}, "above 0")):
        with pytest.raises(ConfigError, match=words):
            PrintedDofParams(**setting)  # type: ignore[arg-type]


def test_bleed_as_printed() -> None:
    """Centre 100 among 100, 120, 90, 180, 100, 60, 100, 140: weights 1/7, 4/7, 2/7 of the brighter ones."""
    grey = np.array([[100, 120, 90], [180, 100, 100], [60, 100, 140]], np.float32)
    colour = np.repeat(grey[..., None], 3, -1)
    even = np.ones((3, 3), np.float32)
    np.testing.assert_allclose(eq8_bleed(colour, even)[1, 1], 160.0, rtol=1e-5)
    dark = np.where(grey == 100, grey, 50).astype(np.float32)
    assert (eq8_bleed(np.repeat(dark[..., None], 3, -1), even)[1, 1] == 100).all()
    nearer = even.copy()
    nearer[1, 0] = 2.0  # 180 stands in front: it does not flow into what is behind
    np.testing.assert_allclose(eq8_bleed(colour, nearer)[1, 1], (20 * 120 + 40 * 140) / 60, rtol=1e-5)


def test_blend_factor_as_printed() -> None:
    s = scene()
    params = PrintedDofParams(focal_mm=200.0, fnumber=11.0, focus="2500mm", coc_mm=0.035)
    at = circle_of_confusion(params, facts(s), s)
    a = blur_factor(np.array([1 / 2.5, 1 / 2.52, 1 / 5.0, 1 / 100.0]), (1 / 100.0, 1 / 2.0), at, params.coc_mm)
    circle = circle_of_confusion_mm(np.array([2500.0, 2520.0, 5000.0, 1e5]), Lens(200.0, 11.0, 2500.0))
    assert circle[1] < 0.035 < circle[2]
    np.testing.assert_allclose(a, circle / circle[3] * [1, 2 / 3, 1, 1], rtol=1e-9)


def test_the_printed_formula_blurs_by_two_thirds_or_not_at_all() -> None:
    at = shot()
    frame, image = at.scene.camera.rect, at.layers[Layer.IMAGE]
    out = blurred(at, "standard", made=PrintedDof, aperture_px=20.0, focus="object")
    assert np.isfinite(out).all() and 0.002 < np.abs(out - image).mean() < 0.1
    np.testing.assert_array_equal(blurred(at, "standard", made=PrintedDof, fnumber=1e9), image)
    stage = PrintedDof(PrintedDofParams(aperture_px=20.0, focus="object"))
    assert stage.demand(at.facts, at.scene, frame).rect == frame
