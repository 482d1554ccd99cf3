"""The marker as a light meter, on pictures rendered here: where the samples lie, what is
dropped, what variance is claimed.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.light.patches import (
    WHITE,
    Meter,
    Patches,
    read_print,
    stack,
    standing,
)
from arfx.analyse.light.shadow import edge_clue, quarters
from arfx.analyse.markers.detect import MarkerDetector
from arfx.core.colour import SRGB
from arfx.core.marker_codes import dictionary, marker_cells

INK, PAPER = 0.05, 0.88
QUAD = np.array([[70.3, 52.1], [331.7, 75.4], [318.2, 329.9], [48.6, 301.5]])


def measure(
    linear: np.ndarray,
    origin: tuple[int, int],
    quad: np.ndarray,
    cells: np.ndarray,
    inverted: bool = False,
    blur_px: float = 0.7,
) -> Patches:
    meter = Meter(cells.astype(np.int8))
    return read_print(
        linear, np.asarray(quad, float) - origin, meter, inverted, blur_px
    )


def rendered(
    family: str = "36h11", number: int = 3, quad: np.ndarray = QUAD, size: tuple[int, int] = (380, 400),
    inverted: bool = False, blur: float = 0.7, rgb: tuple[float, float, float] = (0.5, 0.4, 0.3), bias: float = 0.01,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 linear: print of OpenCV's own picture of the marker, one cell of
    quiet zone, 4 x 4 samples a pixel.
    """
    print_ = cv2.aruco.generateImageMarker(dictionary(family), number, 800) > 127
    n = len(marker_cells(family, number))
    ss = 4
    h, w = size
    x, y = np.meshgrid(
        (np.arange(w * ss) + 0.5) / ss - 0.5, (np.arange(h * ss) + 0.5) / ss - 0.5
    )
    unit = cv2.getPerspectiveTransform(
        quad.astype(np.float32),
        np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32),
    )
    p = np.stack([x, y, np.ones_like(x)], -1) @ unit.T
    u, v = p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]
    inside = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    quiet = (np.abs(u - 0.5) < 0.5 + 1 / n) & (np.abs(v - 0.5) < 0.5 + 1 / n)
    bright = print_[
        np.clip((v * 800).astype(int), 0, 799), np.clip((u * 800).astype(int), 0, 799)
    ]
    paper = np.where(inside, bright, True) ^ inverted
    albedo = np.where(quiet, np.where(paper, PAPER, INK), 0.35)
    fine = albedo.reshape(h, ss, w, ss).mean((1, 3))
    fine = cv2.GaussianBlur(fine, (0, 0), blur) if blur > 0 else fine
    return (fine[..., None] * np.array(rgb) + bias).astype(np.float32)


def expected(
    rgb: tuple[float, float, float] = (0.5, 0.4, 0.3), bias: float = 0.01
) -> np.ndarray:
    return np.where(WHITE[:, None], PAPER, INK) * np.array(rgb) + bias


@pytest.mark.parametrize(
    ("family", "number"),
    [("36h11", 3), ("36h11", 586), ("4X4_50", 7), ("16h5", 2), ("ORIGINAL", 99)],
)
def test_cells_are_where_the_detector_says(family: str, number: int) -> None:
    image = rendered(family, number)
    (found,) = MarkerDetector([family]).search(
        np.round(SRGB.encode(image[..., 1]) * 255).astype(np.uint8)
    )
    assert found.id == number
    # its first corner is the top left one (it finds the inner border of a wide rim, 12 px
    # inside the edge)
    assert np.abs(found.quad_px - QUAD).max() < 15
    got = measure(image, (0, 0), QUAD, marker_cells(family, number))
    assert np.abs(got.mean - expected())[got.count > 0].max() < 2e-5
    assert got.count[WHITE].sum() > 0 and got.count[~WHITE].sum() > 0
    turned = measure(image, (0, 0), np.roll(QUAD, 1, 0), marker_cells(family, number))
    assert (
        np.abs(turned.mean - expected())[turned.count > 0].max() > 0.05
    )  # a quarter turn is noticed


def test_cells_have_a_black_border_and_cannot_be_changed() -> None:
    c = marker_cells("36h11", 3)
    assert c.shape == (8, 8) and c.dtype == bool
    assert (
        not (c[0].any() or c[-1].any() or c[:, 0].any() or c[:, -1].any()) and c.any()
    )
    with pytest.raises(ValueError, match="read-only"):
        c[0, 0] = True


def test_inverted_print() -> None:
    got = measure(
        rendered(inverted=True), (0, 0), QUAD, marker_cells("36h11", 3), inverted=True
    )
    assert np.abs(got.mean - expected()).max() < 2e-5


def test_a_part_of_the_frame_gives_what_the_whole_gives() -> None:
    image = rendered()
    whole = measure(image, (0, 0), QUAD, marker_cells("36h11", 3))
    part = measure(image[40:345, 35:350], (35, 40), QUAD, marker_cells("36h11", 3))
    assert (
        np.array_equal(whole.mean, part.mean)
        or np.abs(whole.mean - part.mean).max() < 1e-9
    )
    assert np.array_equal(whole.count, part.count)


def test_what_is_outside_the_rectangle_is_left_out() -> None:
    image = rendered()
    left = measure(image[:, :190], (0, 0), QUAD, marker_cells("36h11", 3))
    full = measure(image, (0, 0), QUAD, marker_cells("36h11", 3))
    assert left.count.sum() < full.count.sum()
    assert np.abs(left.mean - expected())[left.count > 0].max() < 2e-5
    none = measure(image, (5000, 0), QUAD, marker_cells("36h11", 3))
    assert not none.count.any() and not none.mean.any()


@pytest.mark.parametrize("side_px", [24, 40, 60, 120, 270])
@pytest.mark.parametrize("blur", [0.0, 0.7, 1.5])
def test_error_stays_within_the_stated_deviation_with_noise_and_8_bits(
    side_px: float, blur: float
) -> None:
    quad = np.array([[0, 0], [1, 0.04], [0.97, 1], [-0.05, 0.93]]) * side_px + 30.37
    image = rendered(
        quad=quad, size=(int(side_px) + 60, int(side_px) + 70), blur=blur
    )
    z, rng = [], np.random.default_rng(0)
    for _ in range(25):
        coded = SRGB.encode(image) * 255 + rng.normal(0, 2, image.shape)
        noisy = SRGB.decode(np.clip(np.round(coded), 0, 255) / 255).astype(np.float32)
        got = measure(noisy, (0, 0), quad, marker_cells("36h11", 3), blur_px=blur)
        seen = got.count > 0
        # noise in coded values is skewed in linear light: 1.1 sigma^2 L^-.2 / 255^2 and
        # less, below 1e-4
        z.append(
            (
                (got.mean - expected())[seen] / np.sqrt(got.variance[seen] + 1e-8)
            ).ravel()
        )
    spread = float(np.sqrt(np.mean(np.concatenate(z) ** 2)))
    assert spread < 1.9, spread
    if blur < 1 and side_px >= 60:
        assert spread > 0.3, spread  # nor is the deviation overstated beyond use


def test_clipped_samples_are_dropped_and_counted() -> None:
    image = rendered(rgb=(1.0, 0.8, 0.7))
    bright = np.minimum(image * 1.0, 1).astype(np.float32)
    bright[:170] = np.minimum(
        bright[:170] * 1.6, 1
    )  # the upper part is overexposed: its paper is clipped
    got = measure(bright, (0, 0), QUAD, marker_cells("36h11", 3))
    assert got.clipped[WHITE][:2].min() > 0.5 and got.clipped[~WHITE].max() == 0
    low = got.clipped[WHITE][2:]
    assert low.max() < 0.1
    assert np.abs(got.mean[6:] - expected((1.0, 0.8, 0.7))[6:]).max() < 2e-3
    black = measure(np.zeros_like(image), (0, 0), QUAD, marker_cells("36h11", 3))
    assert (
        not black.count.any()
        and (black.clipped == 1).all()
        and np.isfinite(black.variance).all()
    )


def test_noise_cut_off_at_black_is_in_the_variance() -> None:
    image = rendered(
        rgb=(0.4, 0.4, 0.4), bias=-0.013
    )  # ink at 0.007, and noise of 0.004 that is cut at 0
    noisy = np.clip(
        image + np.random.default_rng(1).normal(0, 0.004, image.shape), 0, 1
    ).astype(np.float32)
    got = measure(noisy, (0, 0), QUAD, marker_cells("36h11", 3))
    off = (got.mean - 0.007)[~WHITE]
    assert (
        got.clipped[~WHITE].min() > 0.2 and off.min() > 1e-4
    )  # what remains is too bright ...
    assert (np.abs(off) < 3 * np.sqrt(got.variance[~WHITE])).all()  # ... and says so


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_highlight_on_part_of_a_patch_is_dropped(share: float) -> None:
    image = rendered()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    side = 255 * np.sqrt(share / np.pi) / 2
    spot = np.hypot(x - 110, y - 122) < side  # inside the top left quarter
    lit = image + 0.25 * spot[..., None].astype(np.float32)
    noisy = (lit + np.random.default_rng(0).normal(0, 0.003, image.shape)).astype(
        np.float32
    )
    got = measure(noisy, (0, 0), QUAD, marker_cells("36h11", 3))
    assert np.abs(got.mean - expected()).max() < 1.5e-3
    inside = np.abs(np.where(spot[..., None], lit, image) - image).max()
    assert inside > 0.2  # the naive mean would be off by share * .25
    naive = measure(lit, (0, 0), QUAD, marker_cells("36h11", 3)).mean
    assert np.abs(naive - expected()).max() < 1e-3


def test_non_finite_pixels_are_dropped() -> None:
    image = rendered()
    image[100:110, 100:140] = np.nan
    image[200:204, 200:204] = np.inf
    got = measure(image, (0, 0), QUAD, marker_cells("36h11", 3))
    assert np.isfinite(got.mean).all() and np.isfinite(got.variance).all()
    assert np.abs(got.mean - expected()).max() < 2e-5
    assert not measure(
        np.full_like(image, np.nan), (0, 0), QUAD, marker_cells("36h11", 3)
    ).count.any()


@pytest.mark.parametrize(
    "quad",
    [
        np.full((4, 2), np.nan),
        np.zeros((4, 2)),
        QUAD[[0, 2, 1, 3]],
        np.array([[0, 0], [10, 0], [20, 0], [30, 0.0]]),
        QUAD * 1e9,
    ],
)
def test_impossible_corners_measure_nothing(quad: np.ndarray) -> None:
    got = measure(rendered(), (0, 0), quad, marker_cells("36h11", 3))
    assert (
        np.isfinite(got.mean).all()
        and np.isfinite(got.variance).all()
        and not got.count.any()
    )


def test_blur_leads_away_from_the_edges() -> None:
    image = rendered(blur=3.5)  # cells of 33 px
    near = measure(image, (0, 0), QUAD, marker_cells("36h11", 3), blur_px=0.1)
    far = measure(image, (0, 0), QUAD, marker_cells("36h11", 3), blur_px=3.5)
    assert (
        np.abs(far.mean - expected()).max()
        < 0.5 * np.abs(near.mean - expected()).max()
    )
    assert (np.abs(far.mean - expected()) < 3 * np.sqrt(far.variance)).all()


def test_stack() -> None:
    p = measure(rendered(), (0, 0), QUAD, marker_cells("36h11", 3))
    unseen = Patches(p.mean, p.variance, 0 * p.count, p.clipped, np.full((8, 3), 0.5))
    intensity, variance, clipped, albedo = stack([p, unseen], INK, PAPER)
    assert np.array_equal(intensity[0], p.mean)
    assert np.isnan(intensity[1]).all() and np.isnan(variance[1]).all()
    assert clipped.shape == (2, 8)
    assert (albedo[0] == np.where(WHITE, PAPER, INK)[:, None]).all()
    assert (albedo[1] == 0.5).all()
    assert [a.shape for a in stack([], INK, PAPER)] == [(0, 8, 3)] * 2 + [
        (0, 8),
        (0, 8, 3),
    ]


def test_a_shadow_on_a_part_of_a_print_is_told_and_a_darker_room_is_none() -> None:
    image = rendered()
    half = image.copy()
    half[:, 190:] *= 0.5
    assert measure(image, (0, 0), QUAD, marker_cells("36h11", 3)).cells is None
    assert measure(image / 2, (0, 0), QUAD, marker_cells("36h11", 3)).cells is None
    seen = measure(half, (0, 0), QUAD, marker_cells("36h11", 3))
    assert seen.cells is not None
    (top_left, top_right), (bottom_left, bottom_right) = quarters(seen.cells)
    assert top_right < 0.6 * top_left and bottom_right < 0.6 * bottom_left
    for x, left in ((-0.8, 1.0), (0.0, 0.75), (0.8, 0.5)):
        stood = standing(seen, np.array([x, 0.0]))
        off = stood.mean[WHITE] - left * seen.mean[4]
        assert np.abs(off).max() < 0.02
    clue = edge_clue([seen.cells], np.array([[-0.05, 0.05, 0], [0.05, -0.05, 0]]))
    assert clue is not None and clue["verdict"] == "likely"
    assert abs(clue["azimuth_deg"]) < 20 and clue["size_deg"] < 20
    assert edge_clue([], QUAD) is None
