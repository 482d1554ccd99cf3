from __future__ import annotations

import numpy as np
import pytest

from arfx.core.noise import noise, noise_key
from arfx.core.rect import Rect

RECT = Rect(-20, 5, 620, 485)
KEY = noise_key(7, 3, "film_grain")


def test_a_pixel_has_its_number_whatever_rectangle_is_asked_for() -> None:
    part = Rect(100, 50, 220, 140)
    assert np.array_equal(noise(part, KEY), noise(RECT, KEY)[part.slices_in(RECT)])


def test_numbers_are_even_over_their_range() -> None:
    n = noise(RECT, KEY)
    assert n.dtype == np.float32 and n.min() >= 0 and n.max() < 1
    share, _ = np.histogram(n, 16, (0, 1))
    assert np.abs(share / n.size * 16 - 1).max() < 0.03
    assert n.mean() == pytest.approx(0.5, abs=2e-3) and n.var() == pytest.approx(
        1 / 12, abs=1e-3
    )


@pytest.mark.parametrize(
    "other", ["right", "below", "channel", "frame", "stage", "seed"]
)
def test_neighbours_channels_frames_stages_and_seeds_are_independent(
    other: str,
) -> None:
    n = noise(RECT, KEY)
    second = {
        "right": np.roll(n, 1, 1), "below": np.roll(n, 1, 0), "channel": noise(RECT, KEY, 1),
        "frame": noise(RECT, noise_key(7, 4, "film_grain")), "stage": noise(RECT, noise_key(7, 3, "dust")),
        "seed": noise(RECT, noise_key(8, 3, "film_grain")),
    }[other]  # fmt: skip
    assert abs(np.corrcoef(n.ravel(), second.ravel())[0, 1]) < 6e-3
