"""Yao, Tao, Wu 2018 as printed: the sign of the difference, and what it cannot do."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.fold import AnalysisJob
from arfx.analyse.light.fold import folded
from arfx.config.load import load
from arfx.core.layers import Layer
from arfx.errors import ConfigError
from arfx.papers.s4_gi import PrintedGiParams, step3_environment
from arfx.run.parameters import fold_classes, parameters
from tests.unit.stages.gi_scenes import (
    BLACK,
    CAMERA,
    LAMP,
    MATT_RED,
    box,
    from_above,
    ground_points,
    on_plane,
    plain_plate,
    run_gi,
)


def test_the_planes_albedo_is_a_share() -> None:
    with pytest.raises(ConfigError, match="plane_albedo must be between 0 and 1"):
        PrintedGiParams(plane_albedo=-1.0)


@pytest.mark.parametrize("gi", ["corrected", "paper"])
def test_the_environment_is_folded_as_gis_formula_says_whatever_the_lights(gi: str) -> None:
    light = {"paper": "corrected", "corrected": "paper"}[gi]
    config = load(None, {"gi": {"formula": gi}, "light": {"formula": light}}, parameters())
    assert (folded(AnalysisJob((), CAMERA, kinds=fold_classes(config))) is step3_environment) == (gi == "paper")


def test_the_sign_of_the_difference() -> None:
    """V_rho - V_mu, added as its name suggests, takes red light from the plane beside a red box; it has to be subtracted."""
    params = PrintedGiParams()
    s, pose = on_plane(box(MATT_RED), LAMP, CAMERA), from_above()
    made = run_gi(s, pose=pose, params=params)
    near = (made[Layer.COVERAGE] == 0) & (np.hypot(*np.moveaxis(ground_points(s, pose)[..., :2], -1, 0)) < 0.1)
    printed = -made[Layer.VIRTUAL][near]  # what the stage subtracts
    plate = plain_plate()[near]
    assert (plate + printed)[:, 0].mean() < plate[:, 0].mean() - 0.02, "as printed the red box makes the plane less red"
    assert (plate - printed)[:, 0].mean() > plate[:, 0].mean() + 0.02
    assert ((plate - printed)[:, 0] - (plate - printed)[:, 1]).mean() > 0.02


def test_paper_adds_a_difference_and_cannot_darken() -> None:
    """The printed formulas: a lone plane gets no light from itself, so a black object leaves it as it is."""
    params = PrintedGiParams()
    s, tinted = (on_plane(box(material), LAMP, CAMERA) for material in (BLACK, MATT_RED))
    black, red = run_gi(s, params=params), run_gi(tinted, params=params)
    assert (black[Layer.SHADOW] == 1).all() and np.abs(black[Layer.VIRTUAL]).max() == 0
    near = (black[Layer.COVERAGE] == 0) & (np.hypot(*np.moveaxis(ground_points(s, from_above())[..., :2], -1, 0)) < 0.1)
    assert red[Layer.VIRTUAL][near][:, 0].mean() > 0.02 and (red[Layer.SHADOW] == 1).all()
    corrected = run_gi(s)
    assert corrected[Layer.SHADOW][near].mean() < 0.93
