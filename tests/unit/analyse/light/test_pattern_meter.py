"""A print of known picture as a light meter: which of its cells are read, as what, and the
light and bias that they tell.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.light import frames as light_frames
from arfx.analyse.light.patches import (
    SOFT,
    Patches,
    meter_for,
    pattern_meter,
    read_print,
    stack,
)
from arfx.analyse.light.photometry import Photometry, solve
from arfx.analyse.params import LightParams
from arfx.core.marker import PatternSpec
from arfx.core.rect import Rect
from arfx.papers import FORMULAS
from arfx.papers.s1_gain import gain_and_bias
from tests.observed import Observed
from tests.unit.analyse.synthetic import background, camera, hung, poster, tilted

INK, PAPER = 0.05, 0.88
PRINT, PRINTED = PatternSpec(Path("poster.png"), 0.22, 0.15), poster(220, 150, seed=4)
ALBEDO = INK + (PAPER - INK) * PRINTED
QUAD = np.array([[20.0, 15], [300, 30], [280, 205], [10, 190]])
CAM = camera(320, 240, 330.0)
BIAS = np.array([0.006, 0.004, 0.008])
LIGHTS = 0.25 + 0.6 * np.linspace(0, 1, 9)[:, None] * np.array([1.0, 0.9, 0.7])


def seen_under(light: np.ndarray, scale: bool = True) -> Patches:
    """The print read in a picture of it under a light (3,), with the camera's bias."""
    meter = pattern_meter(PRINTED, INK, PAPER)
    w, h = PRINTED.shape[1], PRINTED.shape[0]
    quad = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
    linear = (ALBEDO * light + BIAS).astype(np.float32)
    return read_print(linear, quad, meter if scale else meter._replace(scale=None))


def test_every_quarter_has_bright_and_dark_cells() -> None:
    meter = pattern_meter(PRINTED, INK, PAPER)
    half = len(meter.cells) // 2
    quarters = [
        meter.cells[r : r + half, c : c + half] for r in (0, half) for c in (0, half)
    ]
    assert all((q == 1).sum() == (q == 0).sum() == 8 for q in quarters)
    assert meter.albedo is not None and meter.albedo.shape == (8, 3)
    assert (meter.albedo[4:].mean(-1) > 2 * meter.albedo[:4].mean(-1)).all()
    assert (meter.albedo >= INK).all() and (meter.albedo <= PAPER).all()


@pytest.mark.parametrize("formula", ["corrected", "paper"])
def test_light_and_bias_come_out_of_its_patches(formula: str) -> None:
    patches = [seen_under(light) for light in LIGHTS]
    grey, variance, _, rho = stack(patches, INK, PAPER)
    solved: Photometry
    if formula == "corrected":
        solved = solve(grey, variance, rho)
    else:
        solved = gain_and_bias(grey, albedo=rho)
    assert solved.determined.all()
    np.testing.assert_allclose(solved.y, LIGHTS, rtol=0.012)
    np.testing.assert_allclose(solved.bias, BIAS, atol=0.003)


def test_the_map_is_blurred_as_the_print_is() -> None:
    meters = [pattern_meter(PRINTED, INK, PAPER, soft) for soft in SOFT]
    assert (
        meter_for(meters, 1000.0, 0.7) is meters[0]
        and meter_for(meters, 80.0, 0.7) is meters[2]
    )
    assert meter_for(meters[:1], 80.0, 0.7) is meters[0], "a marker has one"
    w, h = 88, 60
    small = cv2.GaussianBlur(
        cv2.resize(ALBEDO, (w, h), interpolation=cv2.INTER_AREA), (0, 0), 0.7
    )
    quad = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
    off = []
    for meter in (meters[0], meter_for(meters, (w + h) / 2, 0.7)):
        p = read_print(small.astype(np.float32), quad, meter, blur_px=0.7)
        assert meter.albedo is not None and (p.count > 0).all()
        off.append(np.abs(p.mean - meter.albedo)[:4].mean())
    assert off[1] < 0.7 * off[0]


def test_texture_within_a_patch_is_no_noise() -> None:
    even, rough = seen_under(LIGHTS[-1]), seen_under(LIGHTS[-1], scale=False)
    assert np.median(even.variance) < 0.25 * np.median(rough.variance)


def test_quarters_of_other_albedos_are_no_shadow() -> None:
    """Nor does a quarter tell any whose bright cells are dark."""
    meter = pattern_meter(PRINTED, INK, PAPER)
    assert meter.albedo is not None
    half = (0.4 + 0.6 * (np.arange(PRINTED.shape[1]) < 110))[:, None]
    assert seen_under(LIGHTS[-1]).cells is None
    assert seen_under(half * LIGHTS[-1]).cells is not None
    dim = np.where(np.arange(8)[:, None] == 4, 0.1, meter.albedo)
    w, h = PRINTED.shape[1], PRINTED.shape[0]
    quad = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
    linear = (ALBEDO * half * LIGHTS[-1]).astype(np.float32)
    assert read_print(linear, quad, meter._replace(albedo=dim)).cells is None


class Picture:
    """A frame's linear colours."""

    rect = Rect.of(320, 240)

    def __init__(self, pixels: np.ndarray) -> None:
        self.pixels = pixels.astype(np.float32)

    def linear(self, rect: Rect) -> np.ndarray:
        return self.pixels[rect.slices]

    def reduced(self, width: int) -> np.ndarray:
        return np.ascontiguousarray(self.pixels[::4, ::4])


@pytest.mark.parametrize("formula", ["corrected", "paper"])
def test_the_whole_analysis_reads_the_light_from_a_print(
    formula: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A light whose brightness changes, above a print that turns: each frame's brightness
    and the camera's bias.
    """
    method, params = None, LightParams()
    if formula == "paper":
        printed = FORMULAS["paper"]["light"]
        method, params = printed.with_light, printed.Params()
    solved: list[np.ndarray] = []
    kept = light_frames.Readings

    def readings(*a: Any) -> object:
        solved.append(a[4])
        return kept(*a)

    monkeypatch.setattr(light_frames, "Readings", readings)
    prints = {PRINT.key: PRINTED}
    job = AnalysisJob((PRINT,), CAM, light=params, light_method=method, prints=prints)
    analyser, back = (
        Observed(job, {"light"}),
        np.repeat(0.5 * background(320, 240)[..., None], 3, 2),
    )
    for k, light in enumerate(LIGHTS):
        view = (
            hung(
                CAM,
                ALBEDO,
                PRINT.corners_m,
                tilted([0.4 - 0.1 * k, 0.2, 0], [0, 0, 0.4]),
                back,
            )
            * light
            + BIAS
        )
        luma = (255 * np.clip(view.mean(-1), 0, 1) ** (1 / 2.2)).astype(np.uint8)
        analyser.step(AnalysisFrame(k, k / 25, luma, Picture(view)))
    clip = analyser.finish()
    assert clip.summary["light"]["photometry"]["readings_used"] == len(LIGHTS)
    # a bias that is not certain, of up to .012, is in the light
    np.testing.assert_allclose(solved[0], LIGHTS, rtol=0.04)
    np.testing.assert_allclose(clip.summary["light"]["bias"], BIAS, atol=0.003)
