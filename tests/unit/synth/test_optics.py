"""Blur by motion and by the lens, rolling shutter, exposure and noise: their widths and
variances as theory gives them.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.colour import SRGB
from arfx.synth.picture import expose, gain_at, unit_noise
from tests.unit.synth.little_scenes import (
    NO_NOISE,
    from_above,
    little_scene,
    picture_of,
)

BLACK = {"kind": "plain", "colour": [0, 0, 0]}
WHITE = {"kind": "plain", "colour": [1, 1, 1]}
FLOOR = {
    "name": "floor",
    "size_m": [20, 20],
    "position_m": [0, 0, -0.001],
    "texture": BLACK,
}
HALF = {
    "name": "half",
    "size_m": [4, 8],
    "position_m": [2, 0, 0],
    "texture": WHITE,
}  # white where x > 0

PIXEL = (
    1 / 6
)  # variance that a pixel's box and the difference of two neighbours add to a line spread function


def edge(profile: np.ndarray) -> tuple[float, float]:
    """(place, variance) in pixels of a dark-to-light edge's line spread function."""
    weight = np.diff(profile)
    at = np.arange(len(weight)) + 0.5
    place = float((weight * at).sum() / weight.sum())
    return place, float((weight * (at - place) ** 2).sum() / weight.sum())


def test_motion_blur_is_as_long_as_the_way_during_the_shutter_and_centred() -> None:
    """An edge at 0.5 m/s, 1 m away, under a shutter of 0.4 s, f = 55.5 px: smeared evenly
    over 11.1 px.
    """
    keys = [
        {"time_s": t, "position_m": [2 + 0.5 * t, 0, 0]}
        for t in (-1.0, 0.0, 1.0, 2.0)
    ]
    moving = {**HALF, "motion": {"kind": "keys", "keys": keys}}
    lens = {"fov_deg": 71.6, "shutter_s": 0.4}
    world, picture = picture_of(
        little_scene(
            80,
            16,
            frames=3,
            path=from_above(),
            plane=[FLOOR, moving],
            lens=lens,
            samples=8,
        )
    )
    place, variance = edge(picture.radiance(1)[8, :, 0])
    f = world.camera.matrix[0, 0]
    assert place == pytest.approx(39.5 + f * 0.05, abs=0.05), (
        "the shutter's middle is the frame's time"
    )
    assert variance - PIXEL == pytest.approx((0.5 * 0.4 * f) ** 2 / 12, rel=0.03)


def test_rolling_shutter_slants_what_moves() -> None:
    keys = [
        {"time_s": t, "position_m": [2 + 0.5 * t, 0, 0]}
        for t in (-1.0, 0.0, 1.0, 2.0)
    ]
    moving = {**HALF, "motion": {"kind": "keys", "keys": keys}}
    scene = little_scene(
        80,
        96,
        frames=2,
        path=from_above(),
        plane=[FLOOR, moving],
        lens={"fov_deg": 71.6},
        hidden={"rolling_shutter_s": 0.08},
        samples=8,
    )
    world, picture = picture_of(scene)
    made = picture.radiance(0)[..., 0]
    places = np.array([edge(row)[0] for row in made])
    slope = np.polyfit(np.arange(96), places, 1)[0]
    assert slope * 96 == pytest.approx(
        0.5 * 0.08 * world.camera.matrix[0, 0], rel=0.15
    ), "in steps of bands of rows"
    assert places.mean() == pytest.approx(39.5, abs=0.05), (
        "the middle row is exposed at the frame's time"
    )


@pytest.mark.parametrize(
    ("focus_m", "radius_px"), [(1.0, 0.0), (0.5, 2.4), (2.0, 1.2)]
)
def test_a_thin_lens_spreads_a_point_over_its_circle_of_confusion(
    focus_m: float, radius_px: float
) -> None:
    """Circle of confusion on a plane at 1 m: radius f/2 · A · |1/focus - 1/1 m| px; along
    one axis its variance is r²/4.
    """
    aperture = 0.08
    lens = {"fov_deg": 67.4, "aperture_m": aperture, "focus_m": focus_m}
    scene = little_scene(
        80, 200, path=from_above(), plane=[FLOOR, HALF], lens=lens, samples=4
    )
    world, picture = picture_of(scene)
    f = world.camera.matrix[0, 0]
    assert f / 2 * aperture * abs(1 / focus_m - 1) == pytest.approx(
        radius_px, abs=0.05
    )
    place, variance = edge(picture.radiance(0)[..., 0].mean(0))
    assert place == pytest.approx(39.5, abs=0.05)
    if radius_px == 0:
        assert variance < 0.01, "in focus the edge falls between two pixels"
    else:
        assert variance - PIXEL == pytest.approx(radius_px**2 / 4, rel=0.06)


def test_a_lens_of_some_softness_widens_every_edge_by_its_variance() -> None:
    scene = little_scene(
        80,
        16,
        path=from_above(),
        plane=[FLOOR, HALF],
        lens={"fov_deg": 67.4, "softness_px": 0.6},
        samples=4,
    )
    place, variance = edge(picture_of(scene)[1].radiance(0)[8, :, 0])
    assert place == pytest.approx(39.5, abs=0.02) and variance == pytest.approx(
        0.36, rel=0.03
    )


def test_exposure_is_gain_then_bias_then_clipping_then_the_curve() -> None:
    radiance = np.linspace(0, 1.5, 48).reshape(4, 4, 3)
    scene = little_scene(exposure={"gain": 0.7, "bias": 0.02}, noise=NO_NOISE)
    exact = np.minimum(0.7 * radiance + 0.02, 1)
    assert np.allclose(expose(scene, radiance, 0, 0.0), SRGB.encode(exact), atol=1e-6)
    other = little_scene(hidden={"transfer": "gamma:2.2"}, noise=NO_NOISE)
    assert np.allclose(
        expose(other, radiance, 0, 0.0),
        np.minimum(radiance, 1) ** (1 / 2.2),
        atol=1e-6,
    )


def test_drift_swings_by_the_stated_stops() -> None:
    scene = little_scene(
        exposure={"gain": 0.8, "drift_stops": 0.5, "drift_period_s": 2.0}
    )
    gains = [gain_at(scene, t) for t in np.linspace(0, 2, 201)]
    assert max(gains) == pytest.approx(0.8 * 2**0.5, rel=1e-3) and min(
        gains
    ) == pytest.approx(0.8 / 2**0.5, rel=1e-3)
    assert gains[0] == pytest.approx(0.8)


def test_noise_has_the_stated_variance_in_linear_light() -> None:
    level = np.array([0.1, 0.4, 0.7])
    radiance = np.broadcast_to(level, (200, 300, 3))
    scene = little_scene(noise={"read": 0.004, "shot": 2e-4})
    linear = SRGB.decode(expose(scene, radiance, 0, 0.0)).astype(float)
    assert np.allclose(linear.mean((0, 1)), level, atol=2e-4)
    assert np.allclose(linear.var((0, 1)), 0.004**2 + 2e-4 * level, rtol=0.03)
    first, second = (
        expose(scene, radiance, n, 0.0)[..., 1].astype(float) for n in (0, 1)
    )
    assert np.array_equal(first, expose(scene, radiance, 0, 0.0)[..., 1])
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02, (
        "frames have noise of their own"
    )


@pytest.mark.parametrize("sigma_px", [0.0, 0.8, 2.0])
def test_correlated_noise_keeps_its_variance(sigma_px: float) -> None:
    """Neighbours of Gaussian-filtered noise correlate as exp(-1 / (4 sigma²))."""
    n = unit_noise(np.random.default_rng(3), (600, 600, 3), sigma_px).astype(float)
    neighbour = (n[:, 1:] * n[:, :-1]).mean() / (n**2).mean()
    assert (n**2).mean() == pytest.approx(1, abs=0.05)
    assert neighbour == pytest.approx(
        np.exp(-1 / (4 * sigma_px**2)) if sigma_px else 0, abs=0.03
    )
