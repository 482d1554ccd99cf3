"""Brightness of every frame beside one light that rests, and what speaks against light that
rests.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.light import over_time
from arfx.analyse.light.fit import FittedLight, LightFit
from arfx.analyse.light.hypotheses import LIKELY, MEASURED, REFUSED, Params
from arfx.analyse.light.over_time import (
    SHARED,
    WINDOWS,
    Span,
    drift,
    fit_over_time,
    gains,
    matched,
    window_starts,
)
from arfx.analyse.light.static_frame import span_report, used_spans
from arfx.core.light import harmonics
from arfx.core.numerics import angle_between, normalise

LAMP = normalise(np.array([0.5, -0.3, 0.8]))
FRAMES = 40
TIMES = np.arange(FRAMES) / 25
TILTS = normalise(np.array([[0.0, 0, 1], [0.7, 0, 0.7], [-0.4, 0.6, 0.7]]))


def turned(frames: int = FRAMES) -> np.ndarray:
    """(frames, 3, 3) rotations of a board that is turned by hand."""
    a = 2 * np.pi * np.arange(frames) / frames
    z = normalise(
        np.stack([0.5 * np.sin(a), 0.5 * np.cos(1.7 * a), np.ones(frames)], -1)
    )
    x = normalise(np.cross([0.0, 1, 0], z))
    return np.stack([x, np.cross(z, x), z], -1)


def board(
    gain: np.ndarray, tilts: np.ndarray = TILTS, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times (k,), normals (k, 3), irradiance (k, 3)) of several tilted markers in every frame."""
    n = (turned() @ tilts.T).transpose(0, 2, 1).reshape(-1, 3)
    light = (0.2 + 0.6 * np.clip(n @ LAMP, 0, None)) * np.repeat(gain, len(tilts))
    light = light * (1 + noise * np.random.default_rng(0).normal(size=len(light)))
    return np.repeat(TIMES, len(tilts)), n, np.repeat(light[:, None], 3, 1)


def test_the_gain_of_every_frame_is_found_where_frames_show_several_normals() -> None:
    gain = 1 + 0.4 * np.sin(2 * np.pi * 1.3 * TIMES)
    found = gains(*board(gain))
    assert found is not None
    assert (
        np.abs(found / np.median(found) - np.repeat(gain, 3) / np.median(gain)).max()
        < 0.03
    )
    noisy = gains(*board(gain, noise=0.005))
    assert (
        noisy is not None
        and np.abs(
            noisy / np.median(noisy) - np.repeat(gain, 3) / np.median(gain)
        ).max()
        < 0.06
    )


@pytest.mark.parametrize(
    "tilts", [TILTS[:1], normalise(np.array([[0, 0, 1.0], [0.1, 0, 1]]))]
)
def test_no_gain_is_claimed_where_a_frame_shows_one_normal(tilts: np.ndarray) -> None:
    assert gains(*board(1 + 0.4 * np.sin(9 * TIMES), tilts)) is None


def test_no_gain_is_claimed_where_frames_are_black() -> None:
    gain = np.ones(FRAMES)
    gain[5:20] = 0
    assert gains(*board(gain)) is None


def test_factors_bring_a_model_to_the_light_and_have_the_median_1() -> None:
    frame = np.repeat(np.arange(5), 2)
    g = np.array([0.5, 0.8, 1.0, 1.2, 3.0])
    model = np.linspace(0.2, 1, 10)
    assert matched(frame, model, 2 * g[frame] * model) == pytest.approx(g)
    assert np.isfinite(matched(frame, 0 * model, model)).all()


def test_light_that_rests_does_not_drift_and_light_that_changes_does() -> None:
    """Of one normal at several times; noise of single frames is little in a quarter of a second."""
    n = np.repeat(TILTS, 60, 0)
    times = np.tile(np.arange(60) / 25, 3)
    light = (harmonics(n) @ np.array([1.5, 0, 0.5, 0.2, 0, 0, 0, 0, 0]))[
        :, None
    ] * np.ones(3)
    noise = 1 + 0.01 * np.random.default_rng(1).normal(size=(180, 1))
    assert drift(times, n, light) < 1e-9 and drift(times, n, light * noise) < 0.006
    wave = 1 + 0.1 * np.sin(2 * np.pi * 0.5 * times)[:, None]
    assert 0.03 < drift(times, n, light * wave) < 0.12
    step = np.where(times < 1.2, 1.0, 0.6)
    assert drift(times, n, light * step[:, None]) > 0.1
    assert (
        drift(times, n, light * step[:, None], (times < 1.2).astype(int)) < 1e-9
    )  # each on its own side
    assert drift(times, n, 0 * light) == 0.0


def test_a_clip_with_gaps_of_years_takes_no_more_memory() -> None:
    times, normals, irradiance = board(np.ones(FRAMES))
    late = np.where(times > TIMES[20], times + 1e9, times)
    assert 0 <= drift(late, normals, irradiance) < 0.02
    assert len(window_starts(late, [5.0, 1e8], 0.2)) == len(
        window_starts(times, [], 0.2)
    )


def test_windows_are_even_between_breaks_and_never_empty() -> None:
    times = np.append(np.arange(50) / 10, 1e6 + np.arange(5) / 10)
    starts = window_starts(times, [2.0, np.inf, -1.0, 2.05], 1.0)
    assert starts == sorted(set(starts)) and starts[0] == 0
    assert {20, 21, 50} <= {*starts}
    held = [np.ptp(part) for part in np.split(times, starts[1:])]
    assert max(held) <= 1.0 and all(len(part) for part in np.split(times, starts[1:]))
    assert window_starts(times[:1], [0.0], 1.0) == [0]


def test_one_normal_seen_once_says_nothing_of_drift() -> None:
    n = normalise(np.random.default_rng(0).normal((0, 0, 1.5), size=(30, 3)))
    assert (
        drift(np.arange(30) / 5, n, np.random.default_rng(1).random((30, 3))) < 0.25
    )


def told(
    off_deg: float, tilts: np.ndarray, monkeypatch: pytest.MonkeyPatch, params: Params = Params(),  # noqa: B008 - frozen
) -> tuple[str, LightFit]:  # fmt: skip
    """(account, fit) of a clip whose brightness wanders, where fits of its first and its
    second half stand off_deg to either side of the whole's. The fits are made up: this is
    about what is made of them."""

    def made_up(n: np.ndarray, E: np.ndarray, *args: object, **_: object) -> LightFit:
        late = (E.mean(1) > 1.5).mean()
        turn = np.radians(off_deg * (1 if late == 1 else -1 if late == 0 else 0))
        light = FittedLight(
            np.array([np.sin(turn), 0.0, np.cos(turn)]), np.ones((9, 3)), 1.0
        )
        one = len(np.unique(args[1])) == 1
        error = (
            0.02 if one else 0.001
        )  # one light for all explains less than one a window
        if one and len(n) < 200 * len(tilts):
            return LightFit(
                REFUSED, "too little of the clip", np.ones((1, 3)), np.ones((1, 3))
            )
        return LightFit(
            MEASURED,
            "made up",
            np.ones((9, 3)),
            np.ones((9, 3)),
            (light,),
            model_error=error,
        )

    monkeypatch.setattr(over_time, "fit", made_up)
    times = np.repeat(np.arange(200) / 25, len(tilts))
    normals = np.tile(tilts, (200, 1))
    light = np.where(times > 3.98, 2.0, 1.0)[:, None] * np.ones(3)
    account, spans = fit_over_time(times, normals, light, 0 * light, (), params)
    return account, spans[0].fit


def test_halves_of_a_light_that_wanders_before_one_normal_have_to_agree(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within 3 degrees: brightness that changes bends a direction by some, and no cone
    knows of it.
    """
    account, found = told(2.0, TILTS[:1], monkeypatch)
    assert (
        account == SHARED
        and found.verdict == MEASURED
        and found.lights[0].confidence_deg == pytest.approx(2.0)
    )
    _, found = told(4.0, TILTS[:1], monkeypatch)
    assert (
        found.verdict == LIKELY
        and found.lights[0].confidence_deg == pytest.approx(8.0)
        and "4 degrees" in found.reason
    )
    assert (
        told(4.0, TILTS[:1], monkeypatch, Params(likely=False))[1].verdict == REFUSED
    )
    _, found = told(20.0, TILTS[:1], monkeypatch)
    assert (
        found.verdict == REFUSED
        and not found.lights
        and "no two parts" in found.reason
    )


def test_halves_may_differ_more_where_frames_show_several_normals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    account, found = told(4.0, TILTS, monkeypatch)
    assert (
        account == SHARED
        and found.verdict == MEASURED
        and found.lights[0].confidence_deg == pytest.approx(4.0)
    )
    assert told(20.0, TILTS, monkeypatch)[1].verdict == REFUSED


def rocked(times: np.ndarray, stops: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
    """(normals, irradiance) of one print that is rocked in light whose exposure drifts."""
    tilt, turn = 0.8 * np.sin(2 * np.pi * times / 2.3), 2 * np.pi * times / 9
    n = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1
    )
    gain = 2 ** (stops * np.sin(2 * np.pi * times / 17))
    light = gain * (0.15 + 0.6 * np.clip(n @ LAMP, 0, None))
    noise = 1 + 0.002 * np.random.default_rng(1).normal(size=(len(times), 3))
    return n, light[:, None] * noise


@pytest.mark.parametrize("late_s", [60.0, 3600.0, 86400.0])
def test_frames_long_after_the_clip_take_nothing_from_its_light(
    late_s: float,
) -> None:
    times = np.append(np.arange(0, 20, 1 / 6), late_s + np.arange(3) / 6)
    n, light = rocked(times)
    variance = np.full(light.shape, 1e-6)
    account, spans = fit_over_time(
        times, n, light, variance, (), Params(most_lights=1)
    )
    assert account == SHARED and len(spans) < 15
    first = spans[0].fit.lights[0]
    assert (
        np.degrees(angle_between(first.direction, LAMP)) < first.confidence_deg < 10
    )


def test_two_frames_of_a_board_claim_no_light() -> None:
    """Three normals that hardly turn fit any light."""
    times, n, light = board(np.ones(FRAMES))
    early = times < TIMES[2]
    other = normalise(np.array([-0.6, 0.3, 0.7]))
    light[early] = 0.3 + 0.4 * np.clip(n[early] @ other, 0, None)[:, None]
    account, spans = fit_over_time(
        times, n, light, np.full(light.shape, 1e-6), [TIMES[2]]
    )
    assert account == WINDOWS
    assert [s.fit.claimed for s in spans] == [False, True]


def test_a_span_that_is_refused_takes_the_light_around_it_only_where_that_agrees() -> (
    None
):
    def span(start_s: float, direction: np.ndarray | None) -> Span:
        lights = (
            ()
            if direction is None
            else (FittedLight(direction, np.ones((1, 3)), 1.0),)
        )
        verdict, rgb = (REFUSED if direction is None else MEASURED), np.ones((1, 3))
        return Span(
            start_s, start_s + 1, LightFit(verdict, "why", rgb, rgb, lights), 0
        )

    alike, other = normalise(LAMP + np.array([0.05, 0, 0])), np.array([-0.6, 0, 0.8])
    lamps = [None, LAMP, None, None, alike, None, other, None]
    spans = [span(k, lamp) for k, lamp in enumerate(lamps)]
    used = used_spans(spans)
    assert used.tolist() == [-1, 1, 1, 1, 4, -1, 6, -1]
    told = (
        span_report(spans[2], bool(used[2] >= 0)),
        span_report(spans[5], bool(used[5] >= 0)),
        span_report(spans[1], True),
    )
    assert [t["verdict"] for t in told] == ["refused", "refused", "measured"] and [
        len(t["lights"]) for t in told
    ] == [0, 0, 1]
    assert (
        "the light before it" in told[0]["reason"]
        and "soft light" in told[1]["reason"]
    )
