"""Sites, labels and means: exact against brute force, dense as asked, the same from frame
to frame.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.rect import Rect
from arfx.papers.s3_watercolor import eq1_sites
from arfx.stages.watercolor.cells import (
    adjust_tone,
    mean_colours,
    neighbours,
    smooth_washes,
)
from arfx.stages.watercolor.field import detail_factor
from arfx.stages.watercolor.label_kernels import SOLID
from arfx.stages.watercolor.labels import (
    STILL,
    Wobble,
    label,
    make_wobble,
    sort_sites,
)
from arfx.stages.watercolor.sites import (
    STEPS,
    SiteField,
    Sites,
    make_sites,
    still_field,
)
from tests.reference.labels import displacement, nearest_two

FRAME = Rect.of(200, 150)


def random_wobble(g: np.random.Generator, reach: int) -> Wobble:
    wobble = make_wobble(g.integers(-reach, reach + 1, (2, 64, 64)).astype(float))
    return wobble._replace(x=int(g.integers(-99, 99)), y=int(g.integers(-99, 99)))


def random_sites(case: int) -> tuple[Sites, Rect, Wobble, float]:
    """Few and many, on one spot, growing, far outside the picture; pictures down to one row
    or column.
    """
    g = np.random.default_rng(case)
    w, h = (int(v) for v in g.integers(1, 160, 2))
    if case % 7 == 6:
        h = 1
    rect = Rect(-9, 13, -9 + w, 13 + h)
    n = int((1, 2, 5, 50, 400, 3000)[case % 6])
    x, y = (
        np.round(g.uniform(a - 20, a + b + 20, n) * STEPS).astype(np.float32)
        for a, b in ((rect.x0, w), (rect.y0, h))
    )
    if case % 3 == 0:
        x[n // 2 :], y[n // 2 :] = x[0], y[0]
    weight = -np.round(g.random(n) * (g.random(n) < 0.3) * 4000 * (case % 2)).astype(
        np.float32
    )
    wobble = random_wobble(g, 12) if case % 4 else STILL
    return (
        Sites(x, y, weight, np.arange(n), x, y),
        rect,
        wobble,
        (0.0, 2.0, 1.3)[case % 3],
    )


@pytest.mark.parametrize("case", range(20))
def test_labels_are_those_of_brute_force(case: int) -> None:
    unsorted, rect, wobble, blend = random_sites(case)
    sites = sort_sites(unsorted, rect, wobble)
    found = label(sites, rect, wobble, blend)
    first, second, farther = nearest_two(sites, rect, displacement(wobble, rect))
    assert np.array_equal(found.first, first)
    assert np.array_equal(
        unsorted.key[label(unsorted, rect, wobble, blend).first], sites.key[first]
    )
    if blend:
        near = found.inside < SOLID
        assert np.array_equal(found.second[near], second[near])
        assert np.array_equal(found.second[~near], first[~near])
        assert (
            np.abs(found.inside - np.minimum(farther / (2 * blend), 1) * SOLID).max()
            <= 1.01
        )


def detailed(f: SiteField, g: np.random.Generator) -> SiteField:
    """With cells by detail, from none to all of it from one node to the next."""
    return SiteField(
        f.x0, f.y0, f.u, f.v, f.size * detail_factor(g.integers(0, 256, f.size.shape))
    )


@pytest.mark.parametrize("case", range(20))
def test_labels_of_cells_by_detail_are_those_of_brute_force(case: int) -> None:
    """As the stage makes them: sites of a turned and scaled field whose cells are of many
    sizes, in order.
    """
    g = np.random.default_rng(100 + case)
    w, h = (int(v) for v in g.integers(1, 90, 2))
    f = detailed(still_field(w, h, float(g.choice([2, 7, 25])), 48), g)
    angle, zoom = g.uniform(0, 6.3), 2 ** g.uniform(-2, 2)
    c, s = np.cos(angle) / zoom, np.sin(angle) / zoom
    rect, wobble = Rect.of(w, h), random_wobble(g, 12) if case % 2 else STILL
    made = make_sites(
        SiteField(f.x0, f.y0, c * f.u - s * f.v, s * f.u + c * f.v, f.size),
        case,
        10**5,
        7.0,
    )
    sites, blend = sort_sites(made, rect, wobble), (0.0, 1.5)[case // 2 % 2]
    found = label(sites, rect, wobble, blend)
    first, second, _ = nearest_two(sites, rect, displacement(wobble, rect))
    assert len(np.unique(sites.weight)) > 1 and np.array_equal(found.first, first)
    if blend:
        assert np.array_equal(
            found.second, np.where(found.inside < SOLID, second, first)
        )


def test_cells_wider_than_float32_tells_apart() -> None:
    x, y = np.array([0, 7999, 8000], np.float32) * STEPS, np.zeros(3, np.float32)
    sites, rect = (
        Sites(x, y, np.zeros(3, np.float32), np.arange(3), x, y),
        Rect(3990, 0, 4010, 3),
    )
    first, second, farther = nearest_two(sites, rect)
    assert np.array_equal(label(sites, rect).first, first)
    found = label(sites, rect, blend_px=3.0)
    near = found.inside < SOLID
    assert np.array_equal(found.first, first) and np.array_equal(
        found.second[near], second[near]
    )
    assert (
        near.any()
        and not near.all()
        and np.array_equal(near, np.floor(farther / 6 * SOLID) < SOLID)
    )


def test_no_sites() -> None:
    none = Sites(
        *(np.zeros(0, np.float32) for _ in range(3)),
        np.zeros(0, np.int64),
        *(np.zeros(0, np.float32) for _ in range(2)),
    )
    found = label(none, FRAME)
    assert found.count == 1 and not found.first.any()


def test_every_site_lies_in_its_cell_and_no_pixel_is_far_from_its_site() -> None:
    sites = eq1_sites(FRAME, 15, 20, 4)
    found = label(sites, FRAME).first
    x, y = (
        np.round(sites.x / STEPS).astype(int),
        np.round(sites.y / STEPS).astype(int),
    )
    inside = (x >= 0) & (y >= 0) & (x < 200) & (y < 150)
    own = found[y[inside], x[inside]]
    d = np.hypot(sites.x[own] / STEPS - x[inside], sites.y[own] / STEPS - y[inside])
    assert (
        inside.sum() > 290 and (d <= np.sqrt(0.5) + 0.1).all()
    )  # itself, or one as near to that pixel
    py, px = np.mgrid[:150, :200]
    away = np.hypot(px - sites.x[found] / STEPS, py - sites.y[found] / STEPS)
    assert away.max() <= np.hypot(10, 10)


def test_a_cell_has_the_exact_mean_of_its_pixels() -> None:
    image = np.random.default_rng(0).random((150, 200, 3), np.float32)
    found = label(make_sites(still_field(200, 150, 7, 0), 1, 10**5), FRAME)
    cells = [image[found.first == k] for k in range(found.count)]
    every = [
        cell.mean(0, dtype=float) if len(cell) else np.zeros(3) for cell in cells
    ]
    mean, area = mean_colours(image, [found.first], found.count)
    np.testing.assert_allclose(mean, every, atol=1e-7)
    assert area.tolist() == [len(cell) for cell in cells]
    other = np.roll(found.first, 3)
    both, mean_area = mean_colours(image, [found.first, other], found.count)
    pixels = [
        np.concatenate([image[found.first == k], image[other == k]])
        for k in range(found.count)
    ]
    np.testing.assert_allclose(
        both,
        [p.mean(0, dtype=float) if len(p) else np.zeros(3) for p in pixels],
        atol=1e-7,
    )
    assert mean_area.tolist() == [len(p) / 2 for p in pixels]


@pytest.mark.parametrize("factor", [4.0, 2.3, 1.0, 0.7, 0.25])
@pytest.mark.parametrize("roll_deg", [0.0, 33.0])
def test_density_stays_within_a_factor_of_two_under_zoom(
    factor: float, roll_deg: float
) -> None:
    """The thing painted is magnified by `factor` and rolled: as many cells as before,
    everywhere.
    """
    f = still_field(320, 240, 8, 64)
    c, s = (
        np.cos(np.radians(roll_deg)) / factor,
        np.sin(np.radians(roll_deg)) / factor,
    )
    sites = make_sites(
        SiteField(f.x0, f.y0, c * f.u - s * f.v, s * f.u + c * f.v, f.size), 2, 10**6
    )
    full = sites.weight > -((0.7 * 8 * STEPS) ** 2)
    x, y = sites.x[full] / STEPS, sites.y[full] / STEPS
    count, *_ = np.histogram2d(y, x, [np.arange(0, 241, 80), np.arange(0, 321, 80)])
    assert (count > 0.5 * 100).all() and (count < 2 * 100).all()


@pytest.mark.parametrize("factor", [4.0, 1.0, 0.25])
def test_density_follows_its_target_under_zoom_where_cells_go_by_detail(
    factor: float,
) -> None:
    """Within a factor of two of one cell per size^2, everywhere; sizes fall by 2.3 from
    left to right.
    """
    f = still_field(320, 240, 8, 64)
    seen = np.linspace(0, 100, f.size.shape[1]) * np.ones(f.size.shape)
    size = f.size * detail_factor(seen)
    sites = make_sites(
        SiteField(f.x0, f.y0, f.u / factor, f.v / factor, size), 2, 10**6
    )
    full = sites.weight > -((0.7 * 8 * STEPS) ** 2)
    count, *_ = np.histogram2d(
        sites.y[full] / STEPS,
        sites.x[full] / STEPS,
        [np.arange(0, 241, 80), np.arange(0, 321, 80)],
    )
    across = np.exp2(
        np.interp(
            np.arange(320), f.x0 + 32 * np.arange(f.size.shape[1]), np.log2(size[0])
        )
    )
    target = 80 * (1 / across**2).reshape(4, 80).sum(1)
    assert (
        target[-1] > 2.5 * target[0]
        and (count > 0.5 * target).all()
        and (count < 2 * target).all()
    ), count / target


def test_sites_appear_from_nothing_and_never_move() -> None:
    """In 60 steps of a slow zoom each site stays where it is in the thing painted, and no
    cell is born or dies large.
    """
    f = still_field(160, 120, 8, 64)
    rect = Rect.of(160, 120)
    places: dict[int, tuple[float, float]] = {}
    before: dict[int, int] = {}
    worst = 0
    for step in range(60):
        k = 2.0 ** (-step / 40)
        sites = make_sites(SiteField(f.x0, f.y0, f.u * k, f.v * k, f.size), 3, 10**5)
        found = label(sites, rect)
        area = np.bincount(found.first.ravel(), minlength=len(sites))
        now = {}
        for key, u, v, a in zip(
            sites.key.tolist(),
            sites.u.tolist(),
            sites.v.tolist(),
            area.tolist(),
            strict=True,
        ):
            assert places.setdefault(key, (u, v)) == (u, v)
            now[key] = a
        if step:
            middle = {
                k_ for k_, p in places.items() if p[0] * 1 / k < 120 and p[1] / k < 90
            }  # away from the border
            worst = max(
                [
                    worst,
                    *(now[k_] for k_ in now.keys() - before.keys() if k_ in middle),
                ]
            )
            worst = max(
                [
                    worst,
                    *(
                        before[k_]
                        for k_ in before.keys() - now.keys()
                        if k_ in middle
                    ),
                ]
            )
        before = now
    assert worst <= 0.3 * 64


def test_more_cells_than_pixels_and_one_cell() -> None:
    tiny = make_sites(still_field(12, 9, 0.5, 4), 0, 500, 0.5)
    assert 0 < len(tiny) <= 500
    found = label(tiny, Rect.of(12, 9))
    assert np.array_equal(found.first, nearest_two(tiny, Rect.of(12, 9))[0])
    one = eq1_sites(Rect.of(30, 20), 1, 1, 0)
    assert len(one) == 1 and not label(one, Rect.of(30, 20)).first.any()


def test_washes_join_alike_cells_only() -> None:
    x, one = 80 * np.arange(6, dtype=np.float32), np.ones(6, np.float32)
    near, share = neighbours(x, 0 * x, 80 * one)
    assert set(near[2][share[2] > 0]) == {1, 3} and share[2].max() > 0.2
    colours = np.array(
        [[0.5], [0.52], [0.5], [0.05], [0.052], [0.05]], np.float32
    ).repeat(3, 1)
    out = smooth_washes(colours, near, share, one, 0.05, 20) ** 2
    assert np.ptp(out[:3]) < 0.4 * 0.02 and np.ptp(out[3:]) < 0.002
    assert out[2, 0] - out[3, 0] > 0.95 * 0.45
    colours[1] = 0  # a cell without a pixel has no colour to give
    empty = smooth_washes(
        colours, near, share, np.array([9, 0, 9, 9, 9, 9], np.float32), 5.0, 10
    )
    assert empty[0, 0] == pytest.approx(np.sqrt(0.5), abs=1e-6)


def test_neighbours_are_those_of_all_pairs_wherever_the_picture_moves() -> None:
    g = np.random.default_rng(2)
    x, y = (np.round(g.uniform(0, 3200, 900)).astype(np.float32) for _ in range(2))
    size = g.uniform(40, 110, 900).astype(np.float32)
    near, share = neighbours(x, y, size)
    moved = neighbours(x + 371, y - 119, size)[0]
    for k in range(0, 900, 37):
        r = 1.4 * np.minimum(size, size[k])
        s = np.clip(1 - ((x - x[k]) ** 2 + (y - y[k]) ** 2) / r**2, 0, None) ** 2
        s[k] = 0
        best = np.sort(s)[::-1][: near.shape[1]]
        np.testing.assert_allclose(np.sort(share[k])[::-1], best, atol=1e-5)
        assert set(near[k]) == set(moved[k])


def test_what_rounding_made_whiter_than_white_is_white() -> None:
    assert (
        adjust_tone(
            np.full((2, 3), np.nextafter(np.float32(1), np.float32(2))),
            0.25,
            1.15,
            0.12,
        )
        == 1
    ).all()
