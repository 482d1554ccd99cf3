"""The light map: the weights of docs/methods/light.md#numbers, constant and stepping light,
what is not finite.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.light.light_map import (
    OUTLIER,
    STEADY,
    STEP,
    UNKNOWN,
    LightMap,
    Observation,
    changes,
)
from arfx.core.numerics import normalise
from arfx.papers.s1_light import LightMap as PrintedMap
from arfx.papers.s1_light import eq8_weight

UP = np.array([[0.0, 0, 1]])


def weight(cosine: np.ndarray, blur_rad: float) -> np.ndarray:
    """Of an observation of no light: the variance of the vertices that it reaches is 1 over it."""
    vertices = np.stack([0 * cosine, 0 * cosine, cosine], -1)
    light = LightMap(vertices, blur_rad)
    light.add(Observation(0.0, UP, np.zeros((1, 3)), np.ones((1, 3))))
    variance = light.variance[:, 0]
    return np.asarray(np.where(variance < UNKNOWN, 1 / variance, 0))


def shot(
    t: float, value: float | np.ndarray, normals: np.ndarray = UP, deviation: float = 1e-3
) -> Observation:
    n = np.asarray(normals, float)
    return Observation(
        t,
        n,
        np.broadcast_to(np.asarray(value, float), (len(n), 3)).copy(),
        np.full((len(n), 3), deviation**2),
    )


def clip(values: list[float], noise: float = 0.0, fps: float = 30.0) -> list[Observation]:
    rng = np.random.default_rng(0)
    return [
        shot(i / fps, v + noise * rng.normal(size=(1, 3)), deviation=max(noise, 1e-3))
        for i, v in enumerate(values)
    ]


@pytest.mark.parametrize(
    ("f", "table"),
    [
        (eq8_weight, [1, 0.8040, 0.3359, 0.1129, 0.0127, 0.0014]),
        (weight, [1, 0.9962, 0.9092, 0.6833, 0.2180, 0.0325]),
    ],
)
def test_weights_are_those_of_the_table(f: Callable, table: list[float]) -> None:
    angles = np.radians([0, 1, 5, 10, 20, 30])
    assert np.abs(f(np.cos(angles), 0.2) - table).max() < 5.1e-5


def test_only_the_corrected_condition_excludes_normals_that_turn_away() -> None:
    cosine = np.cos(np.radians([89.0, 91, 135, 180]))
    assert (eq8_weight(cosine, 2.0) > 0).all()
    assert (weight(cosine, 2.0) > 0).tolist() == [True, False, False, False]


def test_constant_light_stays_constant_for_1000_updates() -> None:
    light, printed, first = LightMap(), PrintedMap(3, 0.2), np.ones(3)
    for i in range(1000):
        light.wait(1 / 30 if i else 0)
        light.add(shot(0.0, 0.7))
        printed.add(UP[0], np.full(3, 0.7))
        if i % 100 in (0, 99):
            here = np.array(
                [
                    light.value[icosphere(3).nearest(UP[0])],
                    printed.M[printed.n[:, 2].argmax()],
                ]
            )
            first = here if i == 0 else first
            assert np.abs(here / first - 1).max() < 1e-6
    assert np.abs(light.value[light.variance[:, 0] < UNKNOWN] / 0.7 - 1).max() < 1e-6
    assert (changes(clip([0.7] * 1000)) == STEADY).all()
    near = printed.n[:, 2] > np.cos(np.radians(10))
    assert (
        near.sum() > 9 and np.abs(printed.M[near] / 0.7 - 1).max() < 1e-6
    )  # it starts at black, and has long filled up


def test_the_paper_replaces_and_the_correction_averages() -> None:
    light, printed, out = LightMap(), PrintedMap(3, 0.2), []
    on_vertex = light.vertices[:1]
    for i in range(60):
        seen = shot(i / 30, 0.7 + 0.05 * (-1) ** i, on_vertex, 0.05)
        light.wait(1 / 30 if i else 0)
        light.add(seen)
        printed.add(UP[0], seen.irradiance[0])
        out.append((light.value[0, 0], printed.M[printed.n[:, 2].argmax(), 0]))
    corrected, replaced = np.std(out[20:], axis=0)
    assert replaced > 0.049  # f = 1: nothing older is left
    assert corrected < 0.015


def test_what_was_not_seen_is_unknown_and_what_was_is_less_certain_later() -> None:
    light = LightMap()
    light.add(shot(0.0, 0.5))
    below = light.vertices[:, 2] < -0.1
    assert (light.variance[below] == UNKNOWN).all() and (light.value[below] == 0).all()
    near = light.vertices[:, 2] > 0.99
    before = light.variance[near].copy()
    light.wait(2.0)
    assert (light.variance[near] > before).all()


def test_an_observation_does_not_bind_other_normals_beyond_what_it_can_tell() -> None:
    """1,000 observations of one normal: 20 degrees off the light may differ by x sin(20) /
    sqrt 3, however often it is seen.
    """
    light = LightMap()
    for _ in range(1000):
        light.add(shot(0.0, 1.0))
    off = np.array([[np.sin(np.radians(20)), 0, np.cos(np.radians(20))]])
    assert 0.1 < float(np.sqrt(light.variance[icosphere(3).nearest(off)].max())) < 0.5


@pytest.mark.parametrize(
    "where", ["normal", "value", "variance", "negative variance", "no normal"]
)
def test_what_is_not_finite_is_left_out(where: str) -> None:
    light = LightMap()
    light.add(shot(0.0, 0.5))
    value, variance = light.value.copy(), light.variance.copy()
    n, x, v = UP.copy(), np.full((1, 3), 0.9), np.full((1, 3), 1e-6)
    {"normal": n, "value": x, "variance": v, "negative variance": v, "no normal": n}[where][
        0, 1
    ] = -1.0 if where == "negative variance" else 0.0 if where == "no normal" else np.nan
    if where == "no normal":
        n[:] = 0
    light.add(Observation(0.0, n, x, v))
    assert (light.value == value).all() and (light.variance == variance).all()
    assert not len(Observation(0.0, n, x, v).usable[0])


def test_a_frame_of_nan_or_without_observations_is_bridged() -> None:
    seen = clip([0.4] * 30)
    seen[10] = shot(10 / 30, np.nan)
    seen[11] = Observation(11 / 30, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    assert (changes(seen) == STEADY).all()


def test_a_single_frame_and_none() -> None:
    assert changes(clip([0.3])).tolist() == [STEADY]
    assert changes([]).tolist() == []


def test_black_light_is_known_black() -> None:
    assert (changes(clip([0.0] * 20)) == STEADY).all()


@pytest.mark.parametrize(("low", "high"), [(0.1, 0.8), (0.0, 0.8), (0.5, 0.6)])
def test_light_switched_off_and_on_is_cut_at_its_frames(low: float, high: float) -> None:
    truth = np.array([high] * 20 + [low] * 25 + [high] * 17)
    seen = clip(truth.tolist(), 0.003)
    kinds = changes(seen)
    assert (
        np.flatnonzero(kinds == STEP).tolist() == [20, 45] and not (kinds == OUTLIER).any()
    )


def test_one_frame_that_disagrees_is_left_out() -> None:
    truth = [0.5] * 30
    values = truth.copy()
    values[12] = 0.9  # a flash, or a misread marker
    seen = clip(values, 0.002)
    kinds = changes(seen)
    assert np.flatnonzero(kinds).tolist() == [12] and kinds[12] == OUTLIER


@pytest.mark.parametrize("phase", range(4))
def test_exposure_that_pumps_while_the_surface_turns_is_no_step(phase: int) -> None:
    turn = 2 * np.pi * np.arange(32) / 16 / 1.2
    normals = normalise(
        np.stack(
            [
                0.35 + 0.2 * np.cos(turn + phase),
                0.25 * np.sin(turn + phase),
                0 * turn + 0.88,
            ],
            1,
        )
    )
    values = 0.33 * (1 + 0.4 * np.cos(turn))
    seen = [
        shot(i / 16, value, normal[None], deviation=2e-3)
        for i, (value, normal) in enumerate(zip(values, normals, strict=True))
    ]
    assert (changes(seen) == STEADY).all()


def test_slow_change_is_no_step() -> None:
    truth = 0.5 + 0.2 * np.sin(np.arange(150) / 30 * 2 * np.pi / 5)
    seen = clip(truth.tolist(), 0.004)
    assert (changes(seen) == STEADY).all()
