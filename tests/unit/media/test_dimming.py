"""Less light straight in the stored samples: the same as through linear light, to the rounding."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.colour import Transfer
from arfx.core.rect import EMPTY, Rect
from arfx.errors import RenderError
from arfx.media.frame import Frame
from arfx.media.planes import planes_of
from tests.unit.media.test_frame import TURNS, frame

OPACITY = 0.8
NO_BIAS = np.zeros(3)


def samples(f: Frame) -> list[np.ndarray]:
    """Planes without what lies beyond the picture, in steps of 8 bits."""
    form = f.format
    chroma = (-(-form.height >> form.layout.sub_y), -(-form.width >> form.layout.sub_x))
    sizes = [
        (form.height, form.width),
        *[chroma if form.layout.kind == "yuv" else (form.height, form.width)] * 2,
    ]
    planes = planes_of(f.picture, form.layout)
    return [
        p[:h, :w].astype(float) / (1 << (form.layout.depth - 8))
        for p, (h, w) in zip(planes, sizes, strict=False)
    ]


def shares(rect: Rect, grey: bool) -> np.ndarray:
    """From nothing taken at the left to nearly all at the right."""
    x = (
        np.linspace(1, 0.03, rect.width, dtype=np.float32)
        * np.linspace(1, 0.9, rect.height, dtype=np.float32)[:, None]
    )
    return x[..., None] if grey else np.stack([x, x**1.2, x**0.7], -1)


def through_linear(
    f: Frame, rect: Rect, left: np.ndarray, bias: np.ndarray, hole: Rect
) -> Frame:
    before = f.linear(rect)
    after = before + np.float32(OPACITY) * (left - 1) * (before - bias.astype(np.float32))
    if not hole.empty:
        after[hole.slices_in(rect)] = before[hole.slices_in(rect)]
    return f.edited(rect, before, after)


@pytest.mark.parametrize("transfer", ["srgb", "bt709", "bt1886", "gamma:2.2"])
@pytest.mark.parametrize(
    "name",
    ["yuv420p", "yuvj420p", "yuv422p", "yuv444p", "yuv411p", "yuv420p10le", "gray", "gbrp"],
)
@pytest.mark.parametrize("bias", [0.0, -0.02, 0.015])
def test_it_is_what_linear_light_gives(name: str, transfer: str, bias: float) -> None:
    f = frame(name, 61, 45, smooth=True, transfer=Transfer(transfer))
    rect, hole = Rect(3, 2, 61, 43), Rect(20, 11, 41, 30)
    for grey in (True, False):
        left = shares(rect, grey)
        full = np.full(3, bias)
        got, want = (
            f.dimmed(rect, left, OPACITY, full, hole),
            through_linear(f, rect, left, full, hole),
        )
        for a, b in zip(samples(got), samples(want), strict=True):
            assert np.abs(a - b).max() <= 1, "a step of rounding"
            assert np.abs(a - b).mean() < 0.05
        assert np.abs(samples(got)[0] - samples(f)[0]).max() > 20, "and that is a change"


@pytest.mark.parametrize("seed", range(3))
def test_any_legal_colour_is_off_by_little(seed: int) -> None:
    """Random luma and chroma: most lie out of gamut, many below black."""
    f = frame("yuv444p", 64, 64, seed)
    left = shares(f.rect, False)
    got, want = (
        f.dimmed(f.rect, left, OPACITY, NO_BIAS, EMPTY),
        through_linear(f, f.rect, left, NO_BIAS, EMPTY),
    )
    apart = np.abs(np.stack(samples(got)) - np.stack(samples(want)))
    assert apart.max() <= 2 and apart.mean() < 0.02


def test_where_nothing_is_taken_every_bit_stays() -> None:
    f = frame("yuv420p", 40, 30)
    left = np.ones((30, 40, 3), np.float32)
    left[10:20, 12:24] = 0.5
    for bias in (NO_BIAS, np.full(3, 0.01)):
        changed = [
            a != b
            for a, b in zip(
                samples(f.dimmed(f.rect, left, 1.0, bias, EMPTY)), samples(f), strict=True
            )
        ]
        assert changed[0][10:20, 12:24].any()
        changed[0][10:20, 12:24] = False
        for c in changed[1:]:
            c[4:11, 5:13] = False  # chroma that the changed luma has a share in
        assert not any(c.any() for c in changed)
        whole = f.dimmed(f.rect, np.ones((30, 40, 1), np.float32), 1.0, bias, EMPTY)
        assert all(
            np.array_equal(a, b) for a, b in zip(samples(whole), samples(f), strict=True)
        )


def test_a_frame_of_our_own_is_edited_in_place_to_the_same_samples() -> None:
    f, rect = frame("yuv420p", 61, 45, smooth=True), Rect(7, 4, 50, 40)
    before = f.linear(rect)
    made = [
        f.dimmed(f.rect, shares(f.rect, True), OPACITY, NO_BIAS, rect) for _ in range(2)
    ]
    apart, own = (
        made[0].edited(rect, before, before * 0.5),
        made[1].edited(rect, before, before * 0.5, in_place=True),
    )
    assert own.picture is made[1].picture and apart.picture is not made[0].picture
    assert all(
        np.array_equal(a, b) for a, b in zip(samples(apart), samples(own), strict=True)
    )


@pytest.mark.parametrize("turn", TURNS)
def test_the_shares_are_upright(turn: object) -> None:
    f = frame("yuv420p", 38, 30, smooth=True, turn=turn)  # type: ignore[arg-type]
    rect, hole = Rect(2, 3, f.rect.width - 1, f.rect.height - 4), Rect(8, 9, 20, 16)
    left = shares(rect, False)
    got, want = (
        f.dimmed(rect, left, OPACITY, NO_BIAS, hole),
        through_linear(f, rect, left, NO_BIAS, hole),
    )
    for a, b in zip(samples(got), samples(want), strict=True):
        assert np.abs(a - b).max() <= 1


@pytest.mark.parametrize("name", ["yuv420p", "yuv411p", "yuv444p"])
@pytest.mark.parametrize(
    ("first", "last"), [(0, 9), (70, 75), (130, 301), (0, 301), (299, 301)]
)
@pytest.mark.parametrize("hole", [EMPTY, Rect(60, 3, 150, 9), Rect(0, 0, 301, 5)])
def test_only_what_lies_between_the_first_and_the_last_dark_pixel_changes(
    name: str, first: int, last: int, hole: Rect
) -> None:
    """Lines are longer than the blocks in which they are searched; a hole may cut what is
    dark in two, or cover it.
    """
    f = frame(name, 301, 12, smooth=True)
    for grey in (True, False):
        left = np.ones((12, 301, 1 if grey else 3), np.float32)
        left[2:11, first:last] = shares(Rect(first, 2, last, 11), grey) * np.float32(0.6)
        for bias in (NO_BIAS, np.full(3, 0.01)):
            got, want = (
                f.dimmed(f.rect, left, OPACITY, bias, hole),
                through_linear(f, f.rect, left, bias, hole),
            )
            for a, b in zip(samples(got), samples(want), strict=True):
                assert np.abs(a - b).max() <= 1
            left_alone = np.ones((12, 301), bool)
            left_alone[2:11, first:last] = False
            left_alone[hole.y0 : hole.y1, hole.x0 : hole.x1] = True
            assert np.array_equal(samples(got)[0][left_alone], samples(f)[0][left_alone])


def test_more_light_than_there_was_is_kept_below_white() -> None:
    f = frame("yuv420p", 40, 30, smooth=True)
    left = np.full((30, 40, 1), 9.0, np.float32)
    got, want = (
        f.dimmed(f.rect, left, 1.0, NO_BIAS, EMPTY),
        f.edited(f.rect, f.linear(f.rect), f.linear(f.rect) * left),
    )
    for a, b in zip(samples(got), samples(want), strict=True):
        assert np.abs(a - b).max() <= 1


def test_shares_of_another_size_are_refused() -> None:
    f = frame("yuv420p")
    with pytest.raises(RenderError, match="shares of light"):
        f.dimmed(Rect(0, 0, 10, 10), np.ones((9, 10, 3), np.float32), 1.0, NO_BIAS, EMPTY)
