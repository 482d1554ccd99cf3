"""Jia, Tang 2013 as printed: numbers of the edge measure, cones in a depth buffer, toon,
and cells named by a colour.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.light import DirectionalLight, Light
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, View
from arfx.papers.s3_watercolor import (
    LEAST,
    PrintedWatercolor,
    PrintedWatercolorParams,
    at_sites,
    cones,
    depth_buffer,
    eq1_sites,
    eq4_edges,
    named_by_colour,
    toon,
)
from arfx.stages.watercolor.labels import label
from tests.reference.labels import nearest_two
from tests.scenes import camera, facts, layers_of, scene

FRAME = Rect.of(200, 150)
SCENE = scene(camera(160, 120))
SEEN = facts(SCENE)
BLACK, WHITE, RED, GREEN = (0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 0)


def seen(
    f: FrameFacts, params: PrintedWatercolorParams | None = None, **more: np.ndarray
) -> tuple[PrintedWatercolor, View]:
    """A grey frame of SCENE; more : layers by name."""
    rect, stage = (
        SCENE.camera.rect,
        PrintedWatercolor(params or PrintedWatercolorParams()),
    )
    made: dict[Layer, Any] = {Layer.IMAGE: np.full((120, 160, 3), 0.5, np.float32)}
    layers: Layers = layers_of(
        rect, {**made, **{Layer(k): v.astype(np.float32) for k, v in more.items()}}
    )
    return stage, ReadyStage.of(stage, SCENE, "standard").view(layers, f)


def painted(
    f: FrameFacts, params: PrintedWatercolorParams, **more: np.ndarray
) -> np.ndarray:
    stage, view = seen(f, params, **more)
    return stage.run(view, None)[Layer.IMAGE]


@pytest.mark.parametrize(
    "wrong", [{"line_threshold": 3}, {"m": -1}, {"n": 5000}, {"near_m": -0.1}]
)
def test_settings_have_bounds(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=f"{next(iter(wrong))}\n.*should be"):
        PrintedWatercolorParams(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("left", "right", "of_yuv", "of_rgb", "both"),
    [
        (BLACK, WHITE, 0.5, 1.0, 0.75),
        (BLACK, RED, 0.34, 0.3333, 0.3367),
        (RED, GREEN, 0.4619, 0.6667, 0.5643),
    ],
)
def test_printed_numbers(
    left: tuple, right: tuple, of_yuv: float, of_rgb: float, both: float
) -> None:
    picture = np.array([[left, right]] * 2, np.float64)
    for beta, wanted in ((1.0, of_yuv), (0.0, of_rgb), (0.5, both)):
        made = eq4_edges(picture, 0.5, beta)
        assert made[0, 0] == pytest.approx(wanted, abs=1e-4) and made[0, 1] == 0


def test_integer_labels_keep_cells_apart_that_colour_merges() -> None:
    sites = eq1_sites(FRAME, 8, 10, 1)
    found = label(sites, FRAME).first
    assert len(np.unique(found)) == len(sites)
    _, count = named_by_colour(
        np.full((150, 200, 3), 0.5, np.float32), found, sites, FRAME
    )
    assert count == 1


def test_there_are_m_x_n_cells_or_as_many_as_their_size_gives() -> None:
    image = np.random.default_rng(0).random((120, 160, 3))
    for of_cells, count in (
        ({"m": 3, "n": 4}, 12),
        ({"cell_px": 40}, 12),
        ({"m": 5, "cell_px": 40}, 20),
    ):
        params = PrintedWatercolorParams(
            toon=False, near_m=0, line_threshold=2, **of_cells
        )
        assert (
            len(
                np.unique(
                    painted(FrameFacts(0, 0.0), params, image=image).reshape(-1, 3),
                    axis=0,
                )
            )
            == count
        )


@pytest.mark.parametrize("seed", range(3))
def test_cones_win_where_their_sites_are_nearest_in_their_own_size(seed: int) -> None:
    """Against every pair of site and pixel: no hole, none cut short. Cones of one size are
    the nearest site's cells.
    """
    g, m, n = np.random.default_rng(seed), 7, 9
    rect = Rect(-5, 11, -5 + 90, 11 + 60)
    sites = eq1_sites(rect, m, n, seed)
    size = g.uniform(0.05 if seed else 0.9, 1, m * n)
    py, px = np.mgrid[rect.y0 : rect.y1, rect.x0 : rect.x1]
    away = np.hypot(px[..., None] - sites.x / 8, py[..., None] - sites.y / 8) / size
    np.testing.assert_array_equal(cones(sites, size, rect, m, n), away.argmin(-1))
    np.testing.assert_array_equal(
        cones(sites, np.full(m * n, 0.7), rect, m, n), nearest_two(sites, rect)[0]
    )


def mean_areas(depth: np.ndarray, where: np.ndarray) -> list[float]:
    """Of the cells whose sites lie in `where`, and of the others, px."""
    m, n, areas = 30, 40, ([], [])
    for key in range(8):
        sites = eq1_sites(FRAME, m, n, key)
        area = np.bincount(
            cones(sites, at_sites(depth, sites, FRAME), FRAME, m, n).ravel(),
            minlength=m * n,
        )
        inside = at_sites(where, sites, FRAME)
        areas[0].extend(area[inside])
        areas[1].extend(area[~inside])
    return [float(np.mean(a)) for a in areas]


def test_cells_of_a_near_thing_are_smaller_but_not_those_of_a_near_region() -> None:
    """What the method does, and what it cannot: m x n sites are spread evenly
    (docs/methods/watercolor.md#errata).
    """
    y, x = np.mgrid[:150, :200]
    thing = np.hypot(x - 100, y - 75) < 12  # five cells wide
    near, far = mean_areas(np.where(thing, 0.6, 0.95), thing)
    assert near < 0.85 * far
    rows = np.linspace(1, 0.6, 150)[:, None] * np.ones((1, 200))
    near, far = mean_areas(rows, y > 75)
    assert near == pytest.approx(far, rel=0.03)


def test_the_depth_buffer_holds_the_plane_the_object_and_what_was_measured() -> None:
    inside = np.zeros((120, 160))
    inside[40:60, 50:80] = 1
    own = {"coverage": inside, "depth": np.where(inside > 0, 0.25, np.inf)}
    assert (depth_buffer(seen(FrameFacts(0, 0.0))[1], 0.1) == 1).all()
    buffer = depth_buffer(seen(SEEN, **own)[1], 0.1)
    np.testing.assert_allclose(buffer[40:60, 50:80], 1 - 0.1 / 0.25, rtol=1e-6)
    pixel = SCENE.camera.project(SEEN.pose.apply(np.array([[0.06, -0.11, 0.0]])))[
        0
    ].round()  # of the marker's plane
    ray = SCENE.camera.directions(pixel[None])[0]
    normal = SEEN.pose.rotation[:, 2]
    depth = ray[2] * (normal @ SEEN.pose.translation_m) / (normal @ ray)
    assert (
        buffer[int(pixel[1]), int(pixel[0])]
        == pytest.approx(1 - 0.1 / depth, abs=1e-5)
        and depth < 0.5
    )
    real = np.full((120, 160), 2.0)
    real[:, :80], real[0, 0] = 0.5, 0.05
    f = SEEN.with_(real_depth=RealDepth.of(0, 1.0, "", tile_ranges(real, (160, 120))))
    buffer = depth_buffer(seen(f, real_depth=real, **own)[1], 0.1)
    assert (
        buffer[50, 60] == pytest.approx(0.6)
        and buffer[90, 60] == pytest.approx(0.8)
        and buffer[90, 90] == pytest.approx(0.95)
    )
    assert buffer[0, 0] == np.float32(LEAST), "before the near clip plane"


def test_depth_of_each_kind_changes_the_cells() -> None:
    image = np.random.default_rng(0).random((120, 160, 3))
    inside = np.zeros((120, 160))
    inside[30:90, 50:110] = 1
    real = np.where(inside > 0, 0.15, 3.0)
    f = SEEN.with_(real_depth=RealDepth.of(0, 1.0, "", tile_ranges(real, (160, 120))))
    plain = PrintedWatercolorParams(toon=False, near_m=0, line_threshold=2)
    deep = PrintedWatercolorParams(toon=False, line_threshold=2)
    absent = FrameFacts(SEEN.index, SEEN.time_s)
    alike = painted(absent, plain, image=image)
    assert np.array_equal(alike, painted(absent, deep, image=image)), (
        "nothing is known of the depth"
    )
    object_ = {"coverage": inside, "depth": np.where(inside > 0, 0.2, np.inf)}
    for given, more in ((SEEN, {}), (f, {"real_depth": real}), (absent, object_)):
        assert not np.array_equal(alike, painted(given, deep, image=image, **more))
        assert np.array_equal(alike, painted(given, plain, image=image, **more))


def test_toon_keeps_the_models_colour_or_two_fifths_or_a_tenth_of_it_whatever_the_light() -> (
    None
):
    angle = np.linspace(0, np.pi, 41)
    normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)[None]
    colour = np.full((1, 41, 3), (0.8, 0.5, 0.2))
    made = toon(
        colour, 3 * normal, np.array([0, 0, 2.0]), (0.5, 0.2), (1.0, 0.4, 0.1)
    )
    wanted = np.where(np.cos(angle) > 0.5, 1, np.where(np.cos(angle) > 0.2, 0.4, 0.1))
    np.testing.assert_allclose(made, wanted[None, :, None] * colour)

    y, x = np.mgrid[0:120, 0:160]
    nx, ny = (x - 80) / 30, (y - 60) / 30
    inside = nx**2 + ny**2 < 1
    normals = np.where(
        inside[..., None],
        np.stack([nx, ny, np.sqrt(np.clip(1 - nx**2 - ny**2, 0, 1))], -1),
        0,
    )
    parts = {
        "coverage": inside, "normal": normals, "albedo": np.where(inside, 0.4, 0)[..., None].repeat(3, -1),
        "virtual": np.where(inside, 0.5, 0)[..., None].repeat(3, -1),
    }  # fmt: skip
    for strength in (0.2, 3.0):
        f = SEEN.with_(
            light=Light(
                (0.3, 0.3, 0.3), (DirectionalLight((1, 0, 0), (strength,) * 3),)
            )
        )
        stage, view = seen(f, **parts)
        coded = stage.frame(view)
        found = np.unique(coded[inside].round(5))
        np.testing.assert_allclose(
            found, SRGB.encode(np.array(0.4)) * np.array([0.1, 0.4, 1]), atol=1e-4
        )
        np.testing.assert_allclose(
            coded[~inside], SRGB.encode(np.array(0.5)), atol=1e-6
        )
        assert coded[60, 105, 0] > coded[60, 90, 0] > coded[60, 60, 0]
