"""Stage dof with measured depth of the real scene."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import Rect
from arfx.papers.s2_dof import PrintedDof
from arfx.stages.dof import Dof
from arfx.stages.dof.params import DofParams
from tests.unit.stages.dof_scenes import Shot, blurred, shot, texture, with_layers

LEVELS = ("draft", "standard")
SIZE = (240, 180)


def measured(depth: np.ndarray, plate: np.ndarray) -> Shot:
    """A real scene of that depth, m, without an object."""
    at = shot(width=SIZE[0], height=SIZE[1])
    none = np.zeros(depth.shape, np.float32)
    layers = {
        "plate": plate,
        "image": plate,
        "coverage": none,
        "virtual": np.zeros_like(plate),
        "shadow": np.ones_like(plate),
    }
    bare = with_layers(at, real_depth=depth.astype(np.float32), **layers)
    known = RealDepth.of(0, 1.0, "", tile_ranges(depth, SIZE))
    return Shot(
        at.scene,
        at.facts.with_(model_box=Rect(0, 0, 0, 0), real_depth=known),
        bare.layers,
    )


def two_walls(near_m: float, far_m: float) -> np.ndarray:
    depth = np.full((SIZE[1], SIZE[0]), far_m)
    depth[:, 100:150] = near_m
    return depth


def dark_far_bright_near() -> np.ndarray:
    plate = np.full((SIZE[1], SIZE[0], 3), 0.05, np.float32)
    plate[:, 100:150] = 0.8
    return plate


def test_tiles_hold_what_the_map_holds() -> None:
    g = np.random.default_rng(0)
    depth = g.uniform(0.5, 4, (180, 240))
    depth[150, 200] = 0
    known = RealDepth.of(3, 0.5, "x", tile_ranges(depth, SIZE))
    tiles = RealDepth.from_json(known.to_json()).tiles
    assert tiles.dtype == np.float32 and np.array_equal(tiles, known.tiles)
    assert tiles.shape == (2, 3, 4)
    assert (
        tiles[0, 0, 0] <= 1 / depth[:64, :64].max()
        and tiles[1, 0, 0] >= 1 / depth[:64, :64].min()
    )
    assert tiles[1, 2, 3] >= 1 / depth[depth > 0].min(), (
        "a tile with a hole may be filled from anywhere"
    )
    with pytest.raises(ValueError, match="no pixel"):
        tile_ranges(np.zeros((4, 4)), SIZE)


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_a_blurred_wall_does_not_flow_into_what_is_sharp_before_it(
    level: str,
) -> None:
    at = measured(two_walls(1.0, 4.0), dark_far_bright_near())
    out = blurred(at, level, aperture_px=20.0, focus="1m")
    np.testing.assert_allclose(out[:, 100:150], 0.8, atol=1e-5)
    np.testing.assert_allclose(
        out[20:-20, :99], 0.05, atol=1e-3
    )  # nor the bright one into it


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_what_is_blurred_before_a_sharp_wall_has_no_hard_edge(level: str) -> None:
    at = measured(two_walls(1.0, 4.0), dark_far_bright_near())
    row = blurred(at, level, aperture_px=8.0, focus="4m")[90, :, 0]  # 12 px radius
    assert np.abs(np.diff(row[80:120])).max() < 0.12, "of a step of 0.75"
    assert row[100] == pytest.approx(0.42, abs=0.08) and row[125] == pytest.approx(
        0.8, abs=0.01
    )
    assert row[84] == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("focus", ["1m", "2m", "4m"])
def test_levels_agree_with_the_reference(focus: str) -> None:
    y, x = np.indices((SIZE[1], SIZE[0]))
    depth = np.where(
        (x - 120) ** 2 + (y - 80) ** 2 < 45**2, 1.2, 1.5 + 0.015 * (180 - y)
    )
    at = measured(depth, texture(SIZE[1], SIZE[0]))
    truth = blurred(at, "reference", aperture_px=10.0, focus=focus)
    for level, least in zip(LEVELS, (30, 36), strict=True):
        made = blurred(at, level, aperture_px=10.0, focus=focus)
        error = np.abs(np.sqrt(np.clip(made, 0, 1)) - np.sqrt(np.clip(truth, 0, 1)))
        assert -10 * np.log10((error**2).mean()) > least, level


def test_an_object_before_measured_depth() -> None:
    at, wall = shot(width=SIZE[0], height=SIZE[1]), np.full((SIZE[1], SIZE[0]), 3.0)
    known = RealDepth.of(0, 1.0, "", tile_ranges(wall, SIZE))
    before = with_layers(at, real_depth=wall.astype(np.float32)).layers
    at = Shot(at.scene, at.facts.with_(real_depth=known), before)
    standard, reference = (
        blurred(at, level, aperture_px=12.0, focus="2m")
        for level in ("standard", "reference")
    )
    assert np.abs(standard - reference).mean() < 0.004


def test_demand_is_what_the_depth_calls_for() -> None:
    at = measured(two_walls(1.0, 4.0), dark_far_bright_near())
    frame = at.scene.camera.rect

    def asked(**params: object) -> Rect:
        return Dof(DofParams(**params)).demand(at.facts, at.scene, frame).rect  # type: ignore[arg-type]

    assert asked(aperture_px=0.2, focus="4m").empty and asked(fnumber=1e9).empty
    assert asked(aperture_px=20.0, focus="4m") == Rect(
        64 - 25, 0, 192 + 25, 180
    )  # bound: a tenth of the width
    assert asked(aperture_px=20.0, focus="1m") == frame


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0, 1e6, 1e-9])
def test_depths_that_are_none(value: float) -> None:
    depth = two_walls(1.0, 4.0)
    at = measured(depth, texture(SIZE[1], SIZE[0]))
    depth[::2, ::3] = value
    hard = with_layers(at, real_depth=depth.astype(np.float32))
    for level in (*LEVELS, "reference"):
        out = blurred(hard, level, aperture_px=6.0, focus="1.5m")
        assert np.isfinite(out).all() and out.min() >= -1e-5 and out.max() <= 1.0
    assert np.isfinite(
        blurred(hard, "standard", made=PrintedDof, aperture_px=6.0, focus="1.5m")
    ).all()


def test_the_printed_formula_reads_it() -> None:
    at = measured(two_walls(1.0, 4.0), texture(SIZE[1], SIZE[0]))
    change = np.abs(
        blurred(at, "standard", made=PrintedDof, aperture_px=20.0, focus="1m")
        - at.layers[Layer.IMAGE]
    ).max(-1)
    assert change[:, 105:145].max() == 0 and change[:, :95].mean() > 0.01
