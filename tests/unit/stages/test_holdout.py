"""Stage holdout: the plane's shadow stays off real things that are not the plane."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.layers import Layer
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage
from arfx.stages import stages_with
from arfx.stages.holdout import Holdout, HoldoutParams, plane_dioptres
from arfx.stages.viewing import direction_grid
from tests.contract import stage_laws as laws
from tests.unit.stages.dof_scenes import Shot, shot, with_layers

SIZE = (320, 240)
THING = np.s_[90:150, 120:200]  # of another colour than the plane
CLEAR = np.s_[98:142, 128:192]  # of it, away from its edge
DARK = 0.4  # of the light is left everywhere


def plane_m() -> np.ndarray:
    """(h, w) distance of the plane along the axis."""
    at = shot(width=SIZE[0], height=SIZE[1])
    pose = at.facts.camera_from_world
    assert pose is not None
    dioptres = plane_dioptres(
        direction_grid(at.scene.camera),
        pose @ at.scene.world_from_anchor,
        at.scene.camera.rect,
    )
    return np.where(dioptres > 0, 1 / np.maximum(dioptres, 1e-6), np.inf)


def with_thing(
    thing_m: float | np.ndarray,
    noise: float = 0.0,
    told: float = 0.0,
    off_px: int = 0,
) -> Shot:
    """A shadow over the whole plane and a thing on it.

    told : the noise that the facts state;  off_px : of the map's edges
    """
    at = shot(width=SIZE[0], height=SIZE[1])
    plate = np.full((SIZE[1], SIZE[0], 3), (0.4, 0.3, 0.2), np.float32)
    plate[THING] = (0.1, 0.25, 0.4)
    real = plane_m()
    rows, columns = THING
    real[rows, columns.start + off_px : columns.stop + off_px] = thing_m
    real *= 1 + noise * np.random.default_rng(0).standard_normal(real.shape)
    known = RealDepth.of(0, 1.0, "", tile_ranges(real, SIZE), told)
    shadow = np.broadcast_to(np.float32(DARK), (SIZE[1], SIZE[0], 3))
    return Shot(
        at.scene, at.facts.with_(real_depth=known),
        with_layers(at, plate=plate, real_depth=real.astype(np.float32), shadow=shadow).layers,
    )  # fmt: skip


def left(at: Shot, rect: Rect | None = None, **params: float) -> np.ndarray:
    """(h, w) SHADOW of the frame or of a part."""
    stage = Holdout(HoldoutParams(**params))
    layers = at.layers if rect is None else at.layers.crop(rect)
    made = laws.run(ReadyStage.of(stage, at.scene, "standard"), layers, at.facts)
    return made[Layer.SHADOW][..., 0]


@pytest.mark.parametrize("thing_m", [0.3, 2.0, 1e6, 1e-3])
def test_what_is_nearer_or_farther_than_the_plane_keeps_its_light(
    thing_m: float,
) -> None:
    shadow = left(with_thing(thing_m))
    assert shadow[CLEAR].min() > 0.999
    away = np.ones(shadow.shape, bool)
    away[76:164, 106:214] = False
    np.testing.assert_array_equal(shadow[away], np.float32(DARK))


def test_the_edge_is_the_pictures_not_the_depth_maps() -> None:
    """Two pixels off, the step goes back to where the picture has it; the map's own edge is
    a slope.
    """
    step = np.diff(left(with_thing(0.3, off_px=2))[100:140].mean(0))
    edge, end = THING[1].start, THING[1].stop
    assert step[edge - 1] > 0.3 and step[end - 1] < -0.3
    assert np.abs(np.delete(step, [edge - 1, end - 1])).max() < 0.06


def test_the_depths_own_noise_is_no_thing() -> None:
    """The plane keeps its shadow under the noise that the facts state; a thing twice as far
    off as that takes none.
    """
    noisy = left(with_thing(0.2, noise=0.02, told=0.02))
    away = np.ones(noisy.shape, bool)
    away[76:164, 106:214] = False
    assert (
        noisy[away].mean() == pytest.approx(DARK, abs=0.003)
        and noisy[away].max() < 0.6
    )
    assert noisy[CLEAR].min() > 0.95
    assert left(with_thing(0.2, noise=0.02, told=0.0))[away].mean() > DARK + 0.1, (
        "stated as exact, it is full of holes"
    )


def test_the_tolerance_is_soft() -> None:
    for off, kept in ((0.02, 1.0), (0.045, 0.5), (0.07, 0.0)):
        at = with_thing(0.3)
        real = (plane_m() * (1 - off)).astype(np.float32)
        shadow = left(with_layers(at, real_depth=real), tolerance=0.03)
        assert (1 - shadow).mean() == pytest.approx((1 - DARK) * kept, abs=0.03)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_depths_that_are_none_change_nothing(value: float) -> None:
    at = with_layers(
        with_thing(0.3), real_depth=np.full((SIZE[1], SIZE[0]), value, np.float32)
    )
    np.testing.assert_array_equal(left(at), np.float32(DARK))


def test_a_part_gives_what_the_whole_gives() -> None:
    at = with_thing(0.3, off_px=1, noise=0.01, told=0.01)
    stage, out = Holdout(), Rect(110, 85, 161, 131)
    need = stage.needs(out, at.facts, at.scene, "standard")
    assert need.area < at.scene.camera.rect.area / 4
    np.testing.assert_allclose(
        left(at, need)[out.slices_in(need)], left(at)[out.slices], rtol=0, atol=1e-5
    )


def test_without_depth_no_job_has_it() -> None:
    assert "holdout" not in stages_with(["lightmap", "gi"])
    assert "holdout" in stages_with(
        ["lightmap"], depth=True
    ) and "holdout" in stages_with([], depth=True)
    names = stages_with(["gi"], depth=True)
    assert names.index("lightmap") < names.index("holdout") < names.index("gi"), (
        "gi asks the depth itself"
    )
    at = shot(width=SIZE[0], height=SIZE[1])
    assert (
        "not known"
        in Holdout().demand(at.facts, at.scene, at.scene.camera.rect).reason
    )
    with pytest.raises(ValidationError, match="tolerance"):
        HoldoutParams(tolerance=0.0)
