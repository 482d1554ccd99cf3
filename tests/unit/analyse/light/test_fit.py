"""Lights from irradiance: what is claimed, what is refused, and that nothing non-finite leaves."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.light.brightness import steps
from arfx.analyse.light.fit import MOST_SIZE_DEG, LightFit, fit
from arfx.analyse.light.hypotheses import LIKELY, MEASURED, REFUSED, Params
from arfx.analyse.light.over_time import (
    CONSTANT,
    SEGMENTS,
    SWITCHED,
    WINDOWS,
    fit_over_time,
    switches,
)
from arfx.analyse.light.photometry import UNKNOWN_VARIANCE
from arfx.core.numerics import angle_between, normalise
from arfx.papers.s1_light import eq9_lights, hemisphere

AMBIENT = np.array([0.2, 0.21, 0.24])
LAMP = np.array([0.6, 0.56, 0.5])
EXACT = Params(gamma_sigma=0.0)


def at(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def cap(half_deg: float, count: int = 160, seed: int = 0) -> np.ndarray:
    """Normals evenly over a cap around z."""
    rng = np.random.default_rng(seed)
    z = 1 - rng.random(count) * (1 - np.cos(np.radians(half_deg)))
    phi = 2 * np.pi * rng.random(count)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def seen(
    n: np.ndarray, *lamps: tuple[np.ndarray, float], ambient: float = 1.0
) -> np.ndarray:
    out = np.repeat(ambient * AMBIENT[None], len(n), 0)
    for d, strength in lamps:
        out = out + strength * np.clip(n @ d, 0, None)[:, None] * LAMP
    return out


def finite(f: LightFit) -> bool:
    parts = [
        f.ambient_rgb,
        f.seen_rgb,
        [f.model_error],
        *(li.rgb for li in f.lights),
    ]
    return all(np.isfinite(p).all() for p in parts) and all(
        np.isfinite(li.direction).all() for li in f.lights
    )


def test_one_lamp_is_found_with_its_colour_and_the_ambient_light() -> None:
    n, d = cap(70), at(30, 40)
    found = fit(n, seen(n, (d, 1.0)), params=EXACT)
    assert found.verdict == MEASURED and len(found.lights) == 1
    assert np.degrees(angle_between(found.lights[0].direction, d)) < 0.2
    assert found.lights[0].rgb[0] == pytest.approx(
        LAMP, rel=0.02
    ) and found.ambient_rgb[0] == pytest.approx(AMBIENT, rel=0.02)
    assert found.light().radiance(n) == pytest.approx(seen(n, (d, 1.0)), rel=0.02)


@pytest.mark.parametrize("apart_deg", [30, 60, 80])
def test_two_equal_lamps_are_never_their_middle(apart_deg: float) -> None:
    """The paper's peaks of M find one light in the middle; the fit claims a true lamp or
    nothing.
    """
    first, second = at(-apart_deg / 2, 35), at(apart_deg / 2, 35)
    middle = normalise(first + second)
    candidates = hemisphere(4)
    printed = eq9_lights(
        seen(candidates, (first, 1.0), (second, 1.0)), candidates, 0.0, 30.0
    )
    # the one peak lies within a triangle of the middle
    assert (
        len(printed) == 1
        and np.degrees(angle_between(candidates[printed[0]], middle)) < 5
    )
    n = cap(75, 220)
    found = fit(
        n,
        seen(n, (first, 1.0), (second, 1.0))
        * (1 + 0.002 * np.random.default_rng(1).normal(size=(220, 3))),
    )
    assert found.verdict in (MEASURED, REFUSED)
    for li in found.lights:
        if li.confidence_deg < 90:
            off = min(
                np.degrees(angle_between(li.direction, d)) for d in (first, second)
            )
            assert off < max(2 * li.confidence_deg, 3)


@pytest.mark.parametrize(
    ("normals", "says"),
    [
        (np.array([[0.0, 0, 1]] * 50), "one normal"),
        (
            normalise(
                np.array(
                    [[1e-6 * np.cos(k), 1e-6 * np.sin(k), 1.0] for k in range(50)]
                )
            ),
            "one normal",
        ),
        (np.eye(3)[np.arange(60) % 3], "3 normals only"),
        (np.array([[0.0, 0, 1]]), "one normal"),
        (cap(8), "one normal"),  # poses that are some degrees off make as many of one
    ],
)
def test_too_few_normals_are_refused_in_words(normals: np.ndarray, says: str) -> None:
    found = fit(normals, seen(normals, (at(20, 50), 1.0)))
    assert (
        found.verdict == REFUSED
        and says in found.reason
        and ("give `--light`" in found.reason) == (says == "one normal")
        and not found.lights
        and finite(found)
    )
    assert found.ambient_rgb[0] == pytest.approx(
        seen(normals, (at(20, 50), 1.0)).mean(0), rel=0.05
    )


@pytest.mark.parametrize("elevation_deg", [-60.0, -10.0, 0.0, 10.0])
def test_a_lamp_at_the_horizon_or_behind_is_never_claimed_wrongly(
    elevation_deg: float,
) -> None:
    n, d = cap(50), at(70, elevation_deg)
    found = fit(n, seen(n, (d, 1.0)))
    assert finite(found)
    for li in found.lights:
        if li.confidence_deg < 90:
            assert np.degrees(angle_between(li.direction, d)) < max(
                2 * li.confidence_deg, 3
            )
    if elevation_deg < -50:  # no normal sees it
        assert found.verdict == REFUSED


def test_even_and_black_light_are_refused() -> None:
    n = cap(60)
    for light in (seen(n), np.zeros((len(n), 3))):
        found = fit(n, light)
        assert found.verdict == REFUSED and finite(found)


def test_readings_of_which_nothing_is_known_are_left_out() -> None:
    n, d = cap(70), at(-50, 45)
    light, variance = seen(n, (d, 1.0)), np.zeros(n.shape)
    light[3:5], variance[3:5] = 9.0, UNKNOWN_VARIANCE
    found = fit(n, light, variance, params=EXACT)
    assert found.verdict == MEASURED
    assert np.degrees(angle_between(found.lights[0].direction, d)) < 0.5
    nothing = fit(n, light, UNKNOWN_VARIANCE)
    assert nothing.verdict == REFUSED and finite(nothing)


def test_who_knows_that_there_is_one_lamp_needs_less() -> None:
    """Four faces of a cube, one of them in the shade: two lamps would do as well."""
    faces = np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]])
    n, d = np.repeat(faces, 20, 0), at(-20, 48)
    light = seen(n, (d, 1.0)) * (
        1 + 0.003 * np.random.default_rng(2).normal(size=(80, 3))
    )
    assert fit(n, light).verdict != MEASURED
    one = fit(n, light, params=Params(most_lights=1))
    assert (
        one.verdict == MEASURED
        and np.degrees(angle_between(one.lights[0].direction, d)) < 3
    )


def test_amplitudes_are_never_negative() -> None:
    n = cap(60)
    found = fit(
        n,
        np.clip(0.5 - 0.6 * np.clip(n @ at(0, 60), 0, None), 0, None)[:, None]
        * np.ones(3),
    )
    assert (found.ambient_rgb >= 0).all() and all(
        (li.rgb >= 0).all() for li in found.lights
    )


def clip(n: np.ndarray, light: np.ndarray, breaks_s: list[float]) -> tuple[str, list]:
    times = np.arange(len(n)) / 25
    return fit_over_time(times, n, light, np.full(light.shape, 1e-6), breaks_s, EXACT)


def turned(count: int) -> np.ndarray:
    """One marker that is turned by hand: a slow curve of normals over 70 degrees to either side."""
    t = np.linspace(0, 2 * np.pi, count)
    tilt = np.radians(70) * np.stack([np.sin(2 * t), np.cos(3 * t)], -1) / np.sqrt(2)
    return normalise(np.column_stack([np.sin(tilt), np.cos(tilt).prod(1)]))


def test_spans_cover_the_clip_without_gaps() -> None:
    n = turned(150)
    account, spans = clip(n, seen(n, (at(40, 40), 1.0)), [])
    assert account == CONSTANT and len(spans) == 1
    assert (
        spans[0].start_s == 0
        and spans[0].stop_s == pytest.approx(149 / 25)
        and spans[0].fit.verdict == MEASURED
    )


def switched(on: np.ndarray, gain: np.ndarray) -> tuple[str, list, np.ndarray]:
    """A marker turned by hand before a lamp that is on and off, exposed by a gain, both (180,)."""
    n, d = turned(180), at(40, 40)
    light = gain[:, None] * (
        AMBIENT + on[:, None] * np.clip(n @ d, 0, None)[:, None] * LAMP
    )
    return *clip(n, light, [60 / 25, 110 / 25]), d


def test_a_lamp_that_is_switched_keeps_its_direction_and_the_ambient_light() -> None:
    on = np.ones(180)
    on[60:110] = 0
    account, spans, d = switched(on, np.ones(180))
    assert account == SWITCHED and len(spans) == 3
    assert [s.stop_s for s in spans[:-1]] == [s.start_s for s in spans[1:]]
    assert not spans[1].fit.lights and spans[1].fit.verdict == MEASURED
    for s in spans:
        assert s.fit.ambient_rgb[0] == pytest.approx(AMBIENT, rel=0.02)
        assert all(
            np.degrees(angle_between(li.direction, d)) < 1 for li in s.fit.lights
        )


def test_exposure_that_jumps_is_not_taken_for_a_lamp() -> None:
    gain = np.ones(180)
    gain[60:110] = 0.4
    account, spans, d = switched(np.ones(180), gain)
    assert account == SEGMENTS and len(spans) == 3
    assert spans[1].fit.lights[0].rgb[spans[1].group] == pytest.approx(
        0.4 * LAMP, rel=0.05
    )
    assert np.degrees(angle_between(spans[0].fit.lights[0].direction, d)) < 2


def test_steps_that_do_not_go_down_and_up_in_turn_are_no_switch() -> None:
    t, starts = np.arange(100) / 25, [0, 25, 50]
    down = np.where(t < 1, 1.0, np.where(t < 2, 0.6, 0.3))[:, None] * np.ones(3)
    assert switches(t, down, starts) is None and switches(t, down, [0]) is None
    assert switches(
        t, np.where(t[:, None] < 2, down, 1.0 - down), starts
    ).tolist() == [
        1,
        0,
        1,
    ]  # type: ignore[union-attr]


def test_a_lamp_that_swings_before_one_marker_is_refused() -> None:
    n = turned(150)
    t = np.arange(150) / 25
    lamps = np.array([at(60 * np.sin(2 * np.pi * s / 1.3), 45) for s in t])
    light = AMBIENT + np.clip((n * lamps).sum(1), 0, None)[:, None] * LAMP
    account, spans = clip(n, light, [])
    for s in spans:
        assert s.fit.verdict == REFUSED, account


@pytest.mark.parametrize("seed", range(6))
def test_a_light_that_fades_before_one_marker_is_not_claimed_elsewhere(
    seed: int,
) -> None:
    """Brightness and direction trade places where a frame shows one normal: nothing that is
    off may be claimed.
    """
    rng = np.random.default_rng(seed)
    n, d = turned(200), at(rng.uniform(0, 360), rng.uniform(25, 60))
    fade = np.linspace(0.5, 1, 200)[:, None]
    light = fade * seen(n, (d, 1.0)) * (1 + 0.003 * rng.normal(size=(200, 3)))
    _, spans = clip(n, light, [])
    for s in spans:
        for li in s.fit.lights:
            if li.confidence_deg < 90:
                assert (
                    s.fit.verdict == LIKELY
                    or np.degrees(angle_between(li.direction, d)) < 5
                )
                assert np.degrees(angle_between(li.direction, d)) < max(
                    5, li.confidence_deg
                )


def print_turned(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(times (k,), normals (k, 3), lamp (3,), ambient share) of a print turned about,
    tilted by 8-20 to 30-50 degrees.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(72) / 24
    low, high = np.radians(rng.uniform([8, 30], [20, 50]))
    tilt = low + (high - low) * (
        0.5 - 0.5 * np.cos(2 * np.pi * rng.uniform(0.3, 0.6) * t + rng.uniform(0, 6))
    )
    turn = rng.uniform(0, 6) + 2 * np.pi * rng.uniform(0.8, 1.5) * t / t[-1]
    n = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1
    )
    return t, n, at(rng.uniform(0, 360), rng.uniform(30, 70)), rng.uniform(0.3, 0.8)


def test_a_print_turned_by_hand_before_one_lamp_is_claimed_with_the_lamp_in_the_cone() -> (
    None
):
    claimed, off = [], []
    for seed in range(8):
        t, n, d, ambient = print_turned(seed)
        E = (ambient + np.clip(n @ d, 0, None)) * (
            1 + 0.003 * np.random.default_rng(seed).normal(size=72)
        )
        _, spans = fit_over_time(
            t, n, 0.5 * np.repeat(E[:, None], 3, 1), np.full((72, 3), 2e-6)
        )
        f = spans[0].fit
        if f.claimed:
            claimed.append(f.verdict)
            off.append(np.degrees(angle_between(f.lights[0].direction, d)))
            assert off[-1] < f.lights[0].confidence_deg
            if f.verdict == LIKELY:
                assert "would look the same" in f.reason or "may shift it" in f.reason
                assert 5 < f.lights[0].angular_size_deg <= MOST_SIZE_DEG
    assert len(claimed) >= 7 and LIKELY in claimed and np.median(off) < 1, (
        claimed,
        off,
    )


def test_a_pair_that_looks_the_same_makes_a_likely_light_whose_cone_holds_both() -> (
    None
):
    """Two equal lamps that every normal faces are one lamp's light exactly."""
    n, lamps = cap(40), [at(-60, 65), at(60, 65)]
    E = seen(n, (lamps[0], 0.5), (lamps[1], 0.5)) * (
        1 + 0.002 * np.random.default_rng(1).normal(size=(160, 1))
    )
    found = fit(n, E)
    assert (
        found.verdict == LIKELY
        and len(found.lights) == 1
        and "two lamps up to" in found.reason
    )
    (light,) = found.lights
    assert np.degrees(angle_between(light.direction, lamps[0] + lamps[1])) < 2
    for lamp in lamps:
        assert (
            np.degrees(angle_between(light.direction, lamp))
            < light.confidence_deg
            <= 60
        )
    assert light.angular_size_deg == MOST_SIZE_DEG
    strict = fit(n, E, params=Params(likely=False))
    assert (
        strict.verdict == REFUSED
        and not strict.lights
        and "two lamps up to" in strict.reason
    )


def test_the_cone_holds_the_lamp_beside_a_sky_that_is_brighter_from_one_side() -> (
    None
):
    for share in (0.3, 0.6, 1.0):
        n, lamp, sky = cap(35), at(30, 50), at(0, 60)
        E = seen(n, (lamp, 0.5)) + share * AMBIENT * ((n @ sky + 1) ** 2 / 4)[:, None]
        found = fit(
            n, E * (1 + 0.002 * np.random.default_rng(1).normal(size=(160, 1)))
        )
        vector = 0.5 * LAMP.sum() * lamp + share * AMBIENT.sum() * sky
        assert found.verdict == LIKELY
        (first, *_) = found.lights
        assert np.degrees(angle_between(first.direction, vector)) < 10
        assert (
            np.degrees(angle_between(first.direction, lamp))
            < first.confidence_deg
            <= 60
        )


def test_a_cube_of_markers_with_one_face_in_the_shade_is_enough_for_a_likely_light() -> (
    None
):
    faces = np.repeat(
        np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]]), 20, 0
    )
    for azimuth_deg, elevation_deg in ((-140, 35), (-100, 50), (-60, 50)):
        d = at(azimuth_deg, elevation_deg)
        found = fit(
            faces,
            seen(faces, (d, 1.0))
            * (1 + 0.003 * np.random.default_rng(2).normal(size=(80, 3))),
        )
        assert (
            found.verdict == LIKELY
            and np.degrees(angle_between(found.lights[0].direction, d)) < 2
        )


def test_the_cone_holds_what_slow_errors_do_where_normals_hardly_separate_ambient_light() -> (
    None
):
    """A print of nearly one tilt all the way round, its readings off by .3 % as that tilt
    goes to and fro.
    """
    for seed in range(6):
        rng, t = np.random.default_rng(seed), np.arange(96) / 24
        tilt, turn = np.radians(35 + 1.5 * np.sin(2 * t)), 1.2 * t + rng.uniform(0, 6)
        n = np.stack(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)],
            -1,
        )
        d = at(rng.uniform(0, 360), rng.uniform(62, 75))
        E = 0.5 * (0.4 + np.clip(n @ d, 0, None)) * (1 + 0.003 * np.sin(2 * t))
        found = fit(
            n,
            np.repeat(E[:, None], 3, 1),
            np.full((96, 3), 1e-6),
            params=Params(most_lights=1),
        )
        assert (
            found.claimed
            and np.degrees(angle_between(found.lights[0].direction, d))
            < found.lights[0].confidence_deg
        )


@pytest.mark.parametrize("left", [0.0, 0.35])
def test_both_halves_of_a_print_turned_while_a_lamp_is_switched_are_claimed(
    left: float,
) -> None:
    """The step is found from the readings."""
    t, n, d, _ = print_turned(2)
    on = np.where(np.arange(72) < 36, 1.0, left)
    E = (0.4 + on * np.clip(n @ d, 0, None)) * (
        1 + 0.003 * np.random.default_rng(0).normal(size=72)
    )
    light = 0.5 * np.repeat(E[:, None], 3, 1)
    found = steps(t, np.log(light)).tolist()
    account, spans = fit_over_time(t, n, light, np.full((72, 3), 2e-6), found)
    assert account == (SWITCHED if left == 0 else SEGMENTS) and len(spans) == 2
    assert spans[0].stop_s == pytest.approx(t[36]) and all(
        s.fit.verdict_of(s.group)[0] != REFUSED for s in spans
    )
    rgb = [sum(li.rgb[0] for li in s.fit.light(s.group).lights) for s in spans]
    assert rgb[0] == pytest.approx(0.5, rel=0.1) and rgb[1] == pytest.approx(
        0.5 * left, rel=0.1
    )
    for s in spans:
        for li in s.fit.lights:
            assert np.degrees(angle_between(li.direction, d)) < min(
                3, li.confidence_deg
            )


def test_a_lamp_that_is_moved_has_a_direction_of_its_own_on_either_side() -> None:
    t, n, d, _ = print_turned(6)
    lamps = np.where(np.arange(72)[:, None] < 36, d, at(100, 40))
    E = (
        0.5
        * (0.4 + np.clip((n * lamps).sum(1), 0, None))
        * (1 + 0.003 * np.random.default_rng(0).normal(size=72))
    )
    light = np.repeat(E[:, None], 3, 1)
    found = steps(t, np.log(light)).tolist()
    account, spans = fit_over_time(t, n, light, np.full((72, 3), 2e-6), found)
    assert account == WINDOWS and len(spans) == 2
    for s, lamp in zip(spans, (d, at(100, 40)), strict=True):
        assert (
            s.fit.claimed
            and np.degrees(angle_between(s.fit.lights[0].direction, lamp))
            < s.fit.lights[0].confidence_deg
        )
