"""Brightness over time: steady where nothing changes, quick where the picture does."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.light.brightness import (
    WITNESS_PX,
    background_change,
    brightness,
    common_level,
    small_luma,
    steps,
)

FPS = 30.0
NOISE = 0.008  # of a reading's logarithm, as crf 28 leaves it
RNG = np.random.default_rng


def followed(
    luma: np.ndarray,
    prints: int = 1,
    change: np.ndarray | None = None,
    colour: np.ndarray | None = None,
    noise: float = NOISE,
    turn: float = 0.0,
) -> np.ndarray:
    """(t, 3) of prints that all show the logarithms luma (t,) or (t, prints), plus those of
    a colour (t, 3). The first is what the object stands on. turn : radians a frame
    """
    t = len(luma)
    each = np.broadcast_to(np.reshape(luma, (t, -1)), (t, prints))
    frame, print_ = (a.ravel() for a in np.mgrid[:t, :prints])
    level = np.repeat(each.ravel()[:, None], 3, 1)
    level = level + (0 if colour is None else np.repeat(colour, prints, 0))
    level = (
        level + noise * RNG(1).normal(size=(t * prints, 1)) + 0.05 * print_[:, None]
    )
    level = level + 0.003 * RNG(2).normal(size=level.shape)
    seen = np.full(t, np.nan) if change is None else change
    ones = np.ones(t * prints)
    times, turns = np.arange(t) / FPS, np.full(t, turn)
    return brightness(times, frame, print_, level, ones, print_ == 0, seen, turns)


def test_light_that_rests_does_not_flicker() -> None:
    found = followed(np.zeros(90))
    assert np.abs(np.diff(found, axis=0)).max() < 0.002
    assert np.ptp(found) < 0.02


def test_a_step_is_followed_in_its_frame() -> None:
    truth = np.repeat([0.0, -0.22, 0.05], 30)
    for change in (None, np.diff(truth, prepend=0)):
        found = followed(truth, change=change).mean(1)
        assert np.abs(found - truth - np.median(found - truth)).max() < 3 * NOISE


def test_a_ramp_of_one_stop_a_second_is_followed() -> None:
    ramp = np.log(2) / FPS * np.abs((np.arange(90) + 15) % 30 - 15)
    found = followed(ramp).mean(1)
    off = found - ramp
    assert np.abs(off - np.median(off)).max() < 4 * NOISE


def test_a_print_that_turns_under_unknown_lights_is_followed() -> None:
    slow = 0.05 * np.sin(np.arange(90) / 4)
    still = np.zeros(90)  # the background shows nothing: the exposure rests
    off = [
        np.abs(
            followed(slow, change=still, noise=0.002, turn=turn).mean(1) - slow
        ).max()
        for turn in (0.0, 0.03)
    ]
    assert off[1] < 0.007 < off[0] / 2


def test_a_codecs_step_of_chroma_glides() -> None:
    """Of one level in blue, 2 %, at a key frame: the eye sees no step."""
    colour = np.zeros((60, 3))
    colour[30:] = [0.01, 0.0, -0.02]
    found = followed(np.zeros(60), colour=colour)
    chroma = found - found.mean(1, keepdims=True)
    assert np.abs(np.diff(chroma, axis=0)).max() < 0.008


def test_white_balance_that_steps_is_followed_at_once() -> None:
    colour = np.zeros((60, 3))
    colour[30:] = [0.10, 0.0, -0.10]
    found = followed(np.zeros(60), colour=colour)
    chroma = found - found.mean(1, keepdims=True)
    assert np.abs(chroma - chroma.mean(0) - colour + colour.mean(0)).max() < 0.03


def test_a_hand_over_another_print_changes_nothing() -> None:
    each = np.zeros((90, 6))
    each[30:60, 2] = -0.7
    found = followed(each, 6).mean(1)
    assert np.ptp(found) < 0.02


def test_a_hand_over_the_print_that_is_stood_on_darkens() -> None:
    each = np.zeros((90, 6))
    each[30:60, 0] = -0.7
    found = followed(each, 6, np.zeros(90)).mean(1)
    assert found[32:58] - np.median(found[:28]) == pytest.approx(-0.7, abs=3 * NOISE)
    assert found[62:] - np.median(found[:28]) == pytest.approx(0, abs=3 * NOISE)


def test_prints_that_come_and_go_leave_the_level_as_it_is() -> None:
    """Each has a constant error of its own; which ones are seen changes from frame to frame."""
    frame = np.repeat(np.arange(60), 3)
    print_ = np.tile(np.arange(3), 60)
    level = np.repeat((0.1 * print_)[:, None], 3, 1)
    kept = RNG(0).random(180) < 0.6
    common, offsets = common_level(
        frame[kept], print_[kept], level[kept], np.ones(kept.sum())
    )
    assert np.ptp(common) < 1e-3
    assert np.diff(offsets[:, 0]) == pytest.approx([0.1, 0.1], abs=1e-3)


def test_frames_without_a_reading_have_what_lies_between() -> None:
    times = np.arange(30) / FPS
    frame = np.array([*range(10), *range(20, 30)])
    ones, zeros = np.ones(20), np.zeros(20, int)
    level = np.zeros((20, 3))
    unknown = np.full(30, np.nan)
    rests = np.zeros(30)
    found = brightness(times, frame, zeros, level, ones, zeros == 0, unknown, rests)
    assert found.shape == (30, 3) and np.abs(found).max() < 1e-9
    one = brightness(
        times,
        frame[:1],
        zeros[:1],
        level[:1] + 0.3,
        ones[:1],
        zeros[:1] == 0,
        unknown,
        rests,
    )
    assert one == pytest.approx(np.full((30, 3), 0.3))


def test_the_background_says_how_the_exposure_changed() -> None:
    ground = cv2.resize(
        RNG(3).uniform(60, 140, (24, 40)).astype(np.float32),
        (400, 240),
        interpolation=cv2.INTER_CUBIC,
    )
    first = np.rint(ground[10:190, 20:340]).astype(np.uint8)
    shifted = ground[13:193, 25:345]
    for stops in (0.0, 0.2, -0.3):
        later = np.clip(np.rint(shifted * 2 ** (stops / 2.2)), 0, 255).astype(
            np.uint8
        )
        found = background_change(small_luma(first), small_luma(later))
        assert found == pytest.approx(stops * np.log(2), abs=0.01)


def test_a_background_of_nothing_says_nothing() -> None:
    black = np.zeros(WITNESS_PX[::-1], np.float32)
    assert np.isnan(background_change(black, black))


def at(level: np.ndarray, noise: float) -> list[int]:
    level = level + noise * RNG(0).normal(size=len(level))
    return (
        (np.ceil(steps(np.arange(len(level)), level[:, None] * np.ones(3))))
        .astype(int)
        .tolist()
    )


@pytest.mark.parametrize(("low", "high"), [(0.1, 0.8), (0.5, 0.6)])
def test_light_switched_off_and_on_steps_at_its_frames(
    low: float, high: float
) -> None:
    assert at(np.log(np.repeat([high, low, high], [20, 25, 17])), 0.004) == [20, 45]


def test_what_is_no_step() -> None:
    times = np.arange(150) / FPS
    assert at(np.zeros(150), 0.004) == []
    assert at(0.4 * np.sin(2 * np.pi * times / 5), 0.004) == []  # slow
    assert at(np.log(2) * np.abs(times - 2.5), 0.004) == []  # an exposure's ramp
    flash = np.zeros(30)
    flash[12] = 0.5  # one frame that disagrees
    assert at(flash, 0.004) == []
    assert at(np.zeros(3), 0.0) == []
